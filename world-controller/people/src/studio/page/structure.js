// The drawing: a set of cells and of pins with its history as set differences, the cursor, the selection and the mirrors.

import { BESIDE, bounds, cell, inRange, key, mirrored } from "./cells.js";

/** @typedef {import("./cells.js").Cell} Cell */
/** @typedef {[Cell, Cell]} Pin two cells that are one module */
/** @typedef {"off" | "through" | "between"} Mirror whether a mirror goes through cells or between them */

/** Fires `change` with { add, remove, pins } after every change of cells or pins (`pins` is true if pins have changed), and `look` if cursor, selection or mirrors change. */
export class Structure extends EventTarget {
  constructor() {
    super();
    /** @type {Set<number>} */
    this.cells = new Set();
    /** @type {Map<number, number>} what a pin joins each cell with */
    this.pins = new Map();
    /** @type {{ add: number[], remove: number[], pin: number[][], unpin: number[][] }[]} */
    this.past = [];
    this.future = [];
    /** @type {Cell} */
    this.cursor = [0, 0, 0];
    /** @type {Set<number>} */
    this.selected = new Set();
    /** @type {Mirror[]} of the axes x and y */
    this.mirror = ["off", "off"];
    /** Twice the coordinates of the mirrors. */
    this.middle = [0, 0];
    this.name = "drawing";
    /** @type {ReturnType<typeof bounds> | undefined} the corners of all cells, until these change */
    this.corners = undefined;
  }

  /** @returns {Cell[]} */
  list() {
    return [...this.cells].map(cell);
  }
  /** The corners of the drawing; null if it is empty. */
  bounds() {
    if (this.corners === undefined) this.corners = bounds(this.list());
    return this.corners;
  }
  /** @param {Cell} c */
  has(c) {
    return this.cells.has(key(c));
  }

  /** @returns {Pin[]} */
  pinList() {
    return [...this.pins].filter(([a, b]) => a < b).map(([a, b]) => /** @type {Pin} */ ([cell(a), cell(b)]));
  }
  /** What a pin joins a cell with. @param {Cell} c @returns {Cell | null} */
  pinnedTo(c) {
    const other = this.pins.get(key(c));
    return other === undefined ? null : cell(other);
  }

  /** Adds and removes cells and pins with their images in the mirrors, as one step of the history. A cell that goes away
   * takes its pin along; a new pin takes the place of others of its cells.
   * @param {Cell[]} add @param {Cell[]} remove @param {boolean} plain without mirrors @param {Pin[]} pin @param {Pin[]} unpin */
  change(add, remove = [], plain = false, pin = [], unpin = []) {
    const all = (cells) => (plain ? cells : this.images(cells)).filter(inRange).map(key);
    const wanted = new Set(all(add));
    const step = {
      add: [...wanted].filter((k) => !this.cells.has(k)),
      remove: [...new Set(all(remove))].filter((k) => this.cells.has(k) && !wanted.has(k)),
      ...this.pinChange(pin, unpin, wanted, new Set(all(remove)), plain),
    };
    if (!step.add.length && !step.remove.length && !step.pin.length && !step.unpin.length) return false;
    this.past.push(step);
    this.future = [];
    this.apply(step);
    return true;
  }

  /** The pins that a step puts and takes. Of two new ones with a cell in common, such as images in a mirror, the first counts.
   * @param {Pin[]} pin @param {Pin[]} unpin @param {Set<number>} filled @param {Set<number>} emptied @param {boolean} plain */
  pinChange(pin, unpin, filled, emptied, plain) {
    const all = (pins) => {
      const [first, second] = [0, 1].map((i) => pins.map((p) => p[i])).map((cells) => (plain ? cells : this.images(cells)));
      return first.map((c, i) => [c, second[i]]).filter((p) => p.every(inRange)).map((p) => p.map(key));
    };
    const put = new Map();
    for (const [a, b] of all(pin)) {
      const isThere = [a, b].every((k) => filled.has(k) || (this.cells.has(k) && !emptied.has(k)));
      if (isThere && BESIDE.includes(b - a) && !put.has(a) && !put.has(b)) put.set(a, b).set(b, a);
    }
    const gone = new Set(all(unpin).flat().filter((k) => !put.has(k)));
    const isKept = (a, b) => put.get(a) === b || ![a, b].some((k) => put.has(k) || gone.has(k) || (emptied.has(k) && !filled.has(k)));
    const once = (pins, wanted) => [...pins].filter(([a, b]) => a < b && wanted(a, b));
    return { pin: once(put, (a, b) => this.pins.get(a) !== b), unpin: once(this.pins, (a, b) => !isKept(a, b)) };
  }

  apply({ add, remove, pin, unpin }) {
    for (const pair of unpin) for (const k of pair) this.pins.delete(k);
    for (const k of remove) {
      this.cells.delete(k);
      this.selected.delete(k);
    }
    for (const k of add) this.cells.add(k);
    for (const [a, b] of pin) this.pins.set(a, b).set(b, a);
    this.corners = undefined;
    const pins = pin.length + unpin.length > 0;
    this.dispatchEvent(new CustomEvent("change", { detail: { add, remove, pins } }));
  }

  undo() {
    const step = this.past.pop();
    if (!step) return;
    this.future.push(step);
    this.apply({ add: step.remove, remove: step.add, pin: step.unpin, unpin: step.pin });
  }
  redo() {
    const step = this.future.pop();
    if (!step) return;
    this.past.push(step);
    this.apply(step);
  }

  /** Replaces the whole drawing, as one step. @param {Cell[]} cells @param {string} name @param {Pin[]} pins */
  open(cells, name, pins = []) {
    const wanted = new Set(cells.map(key));
    this.name = name;
    this.mirror = ["off", "off"];
    this.selected.clear();
    this.change(cells, this.list().filter((c) => !wanted.has(key(c))), true, pins, this.pinList());
    const b = bounds(cells);
    this.move(b ? [Math.round((b.low[0] + b.high[0]) / 2), b.low[1], b.high[2]] : [0, 0, 0]);
  }

  /** The cells with their images in the mirrors that are on. @param {Cell[]} cells @returns {Cell[]} */
  images(cells) {
    let all = cells;
    for (const axis of /** @type {(0 | 1)[]} */ ([0, 1])) {
      if (this.mirror[axis] !== "off") all = all.concat(all.map((c) => mirrored(c, axis, this.middle[axis])));
    }
    return all;
  }

  /** Off, through the middle cells, between the middle cells, and off again. @param {0 | 1} axis */
  nextMirror(axis) {
    const kinds = /** @type {Mirror[]} */ (["off", "through", "between"]);
    const kind = kinds[(kinds.indexOf(this.mirror[axis]) + 1) % 3];
    const b = this.bounds() ?? bounds([this.cursor]);
    const sum = b.low[axis] + b.high[axis];
    // A mirror through cells has an even number, one between cells an odd one.
    const even = kind === "through";
    this.middle[axis] = sum % 2 === 0 ? (even ? sum : sum + 1) : even ? sum + 1 : sum;
    this.mirror[axis] = kind;
    this.look();
  }

  /** Moves the cursor. @param {Cell} to */
  move(to) {
    if (inRange(to)) this.cursor = to;
    this.look();
  }
  look() {
    this.dispatchEvent(new Event("look"));
  }
}
