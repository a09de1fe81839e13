// What a pointer does to the drawing: the tools, the same in space and on a layer.

import { box, flipped, key, line, plus, same, turned } from "./cells.js";

/** @typedef {import("./cells.js").Cell} Cell */
/** @typedef {import("./space.js").Hit} Hit */

/** Name, key and meaning of each tool. */
export const TOOLS = [
  ["add", "1", "click a face or the floor: a cube; drag: a row or a rectangle of cubes"],
  ["remove", "2", "click a cube: it goes away; drag: all of a row or rectangle (also with Alt, or the right button)"],
  ["module", "3", "as `add`, with the two cells of a module, which are pinned; away: both"],
  ["line", "4", "drag: a line of cubes, as thick as chosen"],
  ["box", "5", "drag: a block, as high as the thickness"],
  ["select", "6", "click or drag: choose cubes, for moving, copying, turning"],
  ["pin", "0", "click a module: it stays as it is, or no longer; drag from a cube to the next: these two are one module"],
];

export class Tools {
  /** @param {import("./structure.js").Structure} structure @param {() => void} onLook */
  constructor(structure, onLook) {
    [this.structure, this.onLook] = [structure, onLook];
    this.tool = "add";
    this.thickness = 1;
    /** @type {{ hit: Hit, from: Cell, to: Cell, tool: string, whole?: boolean } | null} `whole` if modules go away as a whole */
    this.stroke = null;
    /** @type {Cell[]} copied cells, and the pins among them */
    this.copied = [];
    /** @type {import("./structure.js").Pin[]} */
    this.copiedPins = [];
    /** @type {(c: Cell) => Cell | null} the other cell of the module that is shown */
    this.partner = () => null;
  }

  /** The cell that a tool acts on. @param {Hit} hit @param {string} tool @returns {Cell} */
  target(hit, tool) {
    const inner = ["remove", "select", "pin"].includes(tool) && hit.onCube;
    return inner ? plus(hit.at, /** @type {Cell} */ (hit.face.map((v) => -v))) : hit.at;
  }

  /** Begins a stroke. @param {Hit} hit @param {boolean} away */
  begin(hit, away) {
    const tool = away ? "remove" : this.tool;
    const at = this.target(hit, tool);
    // The stroke goes on in the layer of its first cell, along the face that was clicked.
    this.stroke = { hit: { ...hit, at, lift: at === hit.at ? -0.5 : 0.5 }, from: at, to: at, tool, whole: away && this.tool === "module" };
    this.onLook();
  }
  /** @param {Cell | null} to */
  go(to) {
    if (!this.stroke || !to) return;
    this.stroke.to = to;
    this.onLook();
  }
  cancel() {
    this.stroke = null;
    this.onLook();
  }

  /** What a stroke adds, removes and selects, and the pins that it puts and takes. */
  effect(stroke = this.stroke) {
    const none = { add: [], remove: [], select: [], pin: [], unpin: [] };
    if (!stroke) return none;
    const { from, to, tool, hit } = stroke;
    const deep = (c, n) => /** @type {Cell} */ (c.map((v, i) => v + n * hit.face[i]));
    switch (tool) {
      case "remove": {
        const cells = box(from, to).filter((c) => this.structure.has(c));
        const others = stroke.whole ? cells.map((c) => this.partner(c)).filter((c) => c !== null) : [];
        return { ...none, remove: [...cells, ...others] };
      }
      case "module": {
        const pairs = box(from, to).map((c) => [c, deep(c, 1)]);
        return { ...none, add: pairs.flat(), pin: pairs };
      }
      case "pin": {
        const [a, b] = [from, same(from, to) ? this.partner(from) : to];
        if (!b || ![a, b].every((c) => this.structure.has(c))) return none;
        const held = this.structure.pinnedTo(a);
        const isPinned = held !== null && same(held, b);
        return { ...none, select: [a, b], ...(isPinned ? { unpin: [[a, b]] } : { pin: [[a, b]] }) };
      }
      case "line": return { ...none, add: line(from, to, this.thickness) };
      case "box": return { ...none, add: box(from, deep(to, this.thickness - 1)) };
      case "select": return { ...none, select: box(from, to).filter((c) => this.structure.has(c)) };
      default: return { ...none, add: box(from, to) };
    }
  }

  /** Ends a stroke. @param {boolean} more whether a selection grows */
  end(more = false) {
    const stroke = this.stroke;
    if (!stroke) return;
    this.stroke = null;
    const { add, remove, select, pin, unpin } = this.effect(stroke);
    if (stroke.tool === "select") this.select(select, more);
    else this.structure.change(add, remove, false, pin, unpin);
    this.structure.move(stroke.to);
    this.onLook();
  }

  /** Puts a cube at a cell; with the tool for modules, one with a cube on it, as a module. @param {Cell} c */
  put(c) {
    const above = plus(c, [0, 0, 1]);
    if (this.tool === "module") this.structure.change([c, above], [], false, [[c, above]]);
    else this.structure.change([c]);
  }

  /** Chooses cells; a single one that is chosen already is given up. @param {Cell[]} cells @param {boolean} more */
  select(cells, more) {
    const { selected } = this.structure;
    const only = cells.length === 1 && selected.has(key(cells[0]));
    if (!more) selected.clear();
    for (const c of cells) if (only) selected.delete(key(c)); else selected.add(key(c));
    this.structure.look();
  }

  /** The chosen cells. @returns {Cell[]} */
  chosen() {
    return this.structure.list().filter((c) => this.structure.selected.has(key(c)));
  }

  /** The pins with both cells among these. @param {Cell[]} cells */
  pinsWithin(cells) {
    const all = new Set(cells.map(key));
    return this.structure.pinList().filter((pin) => pin.every((c) => all.has(key(c))));
  }
  /** Pins with other cells in the place of these. @param {import("./structure.js").Pin[]} pins @param {Cell[]} before @param {Cell[]} after */
  movedPins(pins, before, after) {
    const to = new Map(before.map((c, i) => [key(c), after[i]]));
    return pins.map(([a, b]) => /** @type {import("./structure.js").Pin} */ ([to.get(key(a)), to.get(key(b))]));
  }

  /** Replaces the chosen cells by others in the same order, which are chosen then. Pins go with their cells.
   * @param {(cells: Cell[]) => Cell[]} move */
  replace(move) {
    const before = this.chosen();
    if (!before.length) return;
    const cells = move(before);
    const gone = new Set(before.map(key));
    const unpin = this.structure.pinList().filter((pin) => pin.some((c) => gone.has(key(c))));
    this.structure.change(cells, before, true, this.movedPins(this.pinsWithin(before), before, cells), unpin);
    this.choose(cells);
  }
  choose(cells) {
    this.structure.selected = new Set(cells.map(key).filter((k) => this.structure.cells.has(k)));
    this.structure.look();
  }

  /** @param {Cell} by */
  moveChosen(by) {
    this.replace((cells) => cells.map((c) => plus(c, by)));
  }
  turnChosen() {
    this.replace(turned);
  }
  /** @param {0 | 1} axis */
  flipChosen(axis) {
    this.replace((cells) => flipped(cells, axis));
  }
  removeChosen() {
    this.structure.change([], this.chosen(), true);
  }
  copy() {
    const cells = this.chosen();
    if (cells.length) [this.copied, this.copiedPins] = [cells, this.pinsWithin(cells)];
  }
  /** Puts the copied cells where the cursor is: their lowest corner at the cursor. */
  paste() {
    if (!this.copied.length) return;
    const low = this.copied.reduce((a, c) => /** @type {Cell} */ (a.map((v, i) => Math.min(v, c[i]))), this.copied[0]);
    const by = /** @type {Cell} */ (this.structure.cursor.map((v, i) => v - low[i]));
    const cells = this.copied.map((c) => plus(c, by));
    this.structure.change(cells, [], true, this.movedPins(this.copiedPins, this.copied, cells));
    this.choose(cells);
  }

  /** Pins two chosen cubes that share a face, or else the module at the cursor; gives up a pin that is there. */
  pin() {
    const chosen = this.chosen();
    const [from, to] = chosen.length === 2 ? chosen : [this.structure.cursor, this.structure.cursor];
    const { pin, unpin } = this.effect({ hit: { at: from, face: [0, 0, 1], onCube: true }, from, to, tool: "pin" });
    this.structure.change([], [], false, pin, unpin);
  }
}
