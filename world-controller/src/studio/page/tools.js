// What a pointer does to the drawing: the tools, the same in space and on a layer.

import { box, flipped, key, line, plus, turned } from "./cells.js";

/** @typedef {import("./cells.js").Cell} Cell */
/** @typedef {import("./space.js").Hit} Hit */

/** Name, key and meaning of each tool. */
export const TOOLS = [
  ["add", "1", "click a face or the floor: a cube; drag: a row or a rectangle of cubes"],
  ["remove", "2", "click a cube: it goes away; drag: all of a row or rectangle (also with Alt, or the right button)"],
  ["module", "3", "as `add`, with the two cells of a module"],
  ["line", "4", "drag: a line of cubes, as thick as chosen"],
  ["box", "5", "drag: a block, as high as the thickness"],
  ["select", "6", "click or drag: choose cubes, for moving, copying, turning"],
];

export class Tools {
  /** @param {import("./structure.js").Structure} structure @param {() => void} onLook */
  constructor(structure, onLook) {
    [this.structure, this.onLook] = [structure, onLook];
    this.tool = "add";
    this.thickness = 1;
    /** @type {{ hit: Hit, from: Cell, to: Cell, tool: string } | null} */
    this.stroke = null;
    /** @type {Cell[]} copied cells, from their lowest corner */
    this.copied = [];
  }

  /** The cell that a tool acts on. @param {Hit} hit @param {string} tool @returns {Cell} */
  target(hit, tool) {
    const inner = (tool === "remove" || tool === "select") && hit.onCube;
    return inner ? plus(hit.at, /** @type {Cell} */ (hit.face.map((v) => -v))) : hit.at;
  }

  /** Begins a stroke. @param {Hit} hit @param {boolean} away */
  begin(hit, away) {
    const tool = away ? "remove" : this.tool;
    const at = this.target(hit, tool);
    // The stroke goes on in the layer of its first cell, along the face that was clicked.
    this.stroke = { hit: { ...hit, at, lift: at === hit.at ? -0.5 : 0.5 }, from: at, to: at, tool };
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

  /** What a stroke adds, removes and selects. */
  effect(stroke = this.stroke) {
    const none = { add: [], remove: [], select: [] };
    if (!stroke) return none;
    const { from, to, tool, hit } = stroke;
    const deep = (c, n) => /** @type {Cell} */ (c.map((v, i) => v + n * hit.face[i]));
    switch (tool) {
      case "remove": return { ...none, remove: box(from, to).filter((c) => this.structure.has(c)) };
      case "module": return { ...none, add: box(from, to).flatMap((c) => [c, deep(c, 1)]) };
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
    const { add, remove, select } = this.effect(stroke);
    if (stroke.tool === "select") this.select(select, more);
    else this.structure.change(add, remove);
    this.structure.move(stroke.to);
    this.onLook();
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

  /** Replaces the chosen cells by others, which are chosen then. @param {Cell[]} cells */
  replace(cells) {
    const before = this.chosen();
    if (!before.length) return;
    this.structure.change(cells, before, true);
    this.choose(cells);
  }
  choose(cells) {
    this.structure.selected = new Set(cells.map(key).filter((k) => this.structure.cells.has(k)));
    this.structure.look();
  }

  /** @param {Cell} by */
  moveChosen(by) {
    this.replace(this.chosen().map((c) => plus(c, by)));
  }
  turnChosen() {
    this.replace(turned(this.chosen()));
  }
  /** @param {0 | 1} axis */
  flipChosen(axis) {
    this.replace(flipped(this.chosen(), axis));
  }
  removeChosen() {
    this.structure.change([], this.chosen(), true);
  }
  copy() {
    const cells = this.chosen();
    if (cells.length) this.copied = cells;
  }
  /** Puts the copied cells where the cursor is: their lowest corner at the cursor. */
  paste() {
    if (!this.copied.length) return;
    const low = this.copied.reduce((a, c) => /** @type {Cell} */ (a.map((v, i) => Math.min(v, c[i]))), this.copied[0]);
    const by = /** @type {Cell} */ (this.structure.cursor.map((v, i) => v - low[i]));
    const cells = this.copied.map((c) => plus(c, by));
    this.structure.change(cells, [], true);
    this.choose(cells);
  }
}
