// The drawing: a set of cells with its history as set differences, the cursor, the selection and the mirrors.

import { bounds, cell, inRange, key, mirrored } from "./cells.js";

/** @typedef {import("./cells.js").Cell} Cell */
/** @typedef {"off" | "through" | "between"} Mirror whether a mirror goes through cells or between them */

/** Fires `change` with { add, remove } after every change of cells, and `look` if cursor, selection or mirrors change. */
export class Structure extends EventTarget {
  constructor() {
    super();
    /** @type {Set<number>} */
    this.cells = new Set();
    /** @type {{ add: number[], remove: number[] }[]} */
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

  /** Adds and removes cells with their images in the mirrors, as one step of the history.
   * @param {Cell[]} add @param {Cell[]} remove @param {boolean} plain without mirrors */
  change(add, remove = [], plain = false) {
    const all = (cells) => (plain ? cells : this.images(cells)).filter(inRange).map(key);
    const wanted = new Set(all(add));
    const step = {
      add: [...wanted].filter((k) => !this.cells.has(k)),
      remove: [...new Set(all(remove))].filter((k) => this.cells.has(k) && !wanted.has(k)),
    };
    if (!step.add.length && !step.remove.length) return false;
    this.past.push(step);
    this.future = [];
    this.apply(step);
    return true;
  }

  apply({ add, remove }) {
    for (const k of remove) {
      this.cells.delete(k);
      this.selected.delete(k);
    }
    for (const k of add) this.cells.add(k);
    this.corners = undefined;
    this.dispatchEvent(new CustomEvent("change", { detail: { add, remove } }));
  }

  undo() {
    const step = this.past.pop();
    if (!step) return;
    this.future.push(step);
    this.apply({ add: step.remove, remove: step.add });
  }
  redo() {
    const step = this.future.pop();
    if (!step) return;
    this.past.push(step);
    this.apply(step);
  }

  /** Replaces the whole drawing, as one step. @param {Cell[]} cells @param {string} name */
  open(cells, name) {
    const wanted = new Set(cells.map(key));
    this.name = name;
    this.mirror = ["off", "off"];
    this.selected.clear();
    this.change(cells, this.list().filter((c) => !wanted.has(key(c))), true);
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
