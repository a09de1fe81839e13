// One layer of the drawing from above, with a ghost of the layer below. Every layer can be edited at any time.

import { bounds, key } from "./cells.js";

/** @typedef {import("./cells.js").Cell} Cell */

/** Names of the colours in the style sheet. */
const COLOURS = ["grid", "below", "selected", "left", "cube", "along-x", "along-y", "along-z", "edge", "add", "remove", "cursor"];

export class Layer {
  /** @param {HTMLCanvasElement} canvas @param {import("./structure.js").Structure} structure @param {import("./tools.js").Tools} tools */
  constructor(canvas, structure, tools) {
    [this.canvas, this.structure, this.tools] = [canvas, structure, tools];
    /** @type {Map<number, Cell>} the partner of each cell */
    this.partner = new Map();
    this.left = new Set();
    this.asked = false;
    /** True while nothing is drawn. */
    this.held = false;
    new ResizeObserver(() => this.ask()).observe(canvas);
    for (const name of ["change", "look"]) structure.addEventListener(name, () => this.ask());
    const at = (event) => {
      const frame = canvas.getBoundingClientRect();
      const { x0, y1, edge } = this.view();
      return /** @type {Cell} */ ([x0 + Math.floor((event.clientX - frame.left) / edge), y1 - Math.floor((event.clientY - frame.top) / edge), structure.cursor[2]]);
    };
    canvas.addEventListener("pointerdown", (event) => {
      const c = at(event);
      canvas.setPointerCapture(event.pointerId);
      // A click on a filled cell empties it, so that no tool has to be changed.
      const filled = structure.has(c) && !["select", "pin"].includes(tools.tool);
      tools.begin({ at: c, face: [0, 0, 1], onCube: false }, filled || event.altKey || event.button === 2);
    });
    canvas.addEventListener("pointermove", (event) => tools.stroke && canvas.hasPointerCapture(event.pointerId) && tools.go(at(event)));
    canvas.addEventListener("pointerup", (event) => canvas.hasPointerCapture(event.pointerId) && tools.end(event.shiftKey));
    canvas.addEventListener("pointercancel", () => tools.cancel());
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  }

  /** @param {[Cell, Cell][]} pairs @param {Cell[]} left */
  show(pairs, left) {
    this.partner = new Map(pairs.flatMap(([a, b]) => [[key(a), b], [key(b), a]]));
    this.left = new Set(left.map(key));
    this.ask();
  }

  /** The cells that are shown, and the edge of one in pixels. */
  view() {
    const { low, high } = this.structure.bounds() ?? { low: this.structure.cursor, high: this.structure.cursor };
    const b = bounds([low, high, this.structure.cursor]);
    const [x0, y0, x1, y1] = [b.low[0] - 2, b.low[1] - 2, b.high[0] + 2, b.high[1] + 2];
    const edge = Math.max(6, Math.min(34, this.canvas.clientWidth / (x1 - x0 + 1), this.canvas.clientHeight / (y1 - y0 + 1)));
    const [columns, rows] = [Math.floor(this.canvas.clientWidth / edge), Math.floor(this.canvas.clientHeight / edge)];
    return { x0: x0 - Math.floor((columns - (x1 - x0 + 1)) / 2), y1: y1 + Math.floor((rows - (y1 - y0 + 1)) / 2), edge, columns, rows };
  }

  /** Asks for a frame. */
  ask() {
    if (this.asked || this.held) return;
    this.asked = true;
    requestAnimationFrame(() => this.draw());
  }

  draw() {
    this.asked = false;
    const { canvas, structure } = this;
    if (!canvas.clientWidth) return;
    const ratio = Math.min(devicePixelRatio, 2);
    [canvas.width, canvas.height] = [canvas.clientWidth * ratio, canvas.clientHeight * ratio];
    // So it is drawn by the processor, which is faster for one so small than a graphics card that is simulated.
    const pen = canvas.getContext("2d", { willReadFrequently: true });
    const style = getComputedStyle(document.documentElement);
    const colours = new Map(COLOURS.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
    const of = (name) => colours.get(name);
    pen.scale(ratio, ratio);
    const { x0, y1, edge, columns, rows } = this.view();
    const z = structure.cursor[2];
    const marks = this.tools.effect();
    const [adds, removes] = [new Set(structure.images(marks.add).map(key)), new Set(structure.images(marks.remove).map(key))];
    const choice = new Set(marks.select.map(key));
    const square = (i, j, colour, inset) => {
      pen.fillStyle = colour;
      pen.fillRect(i * edge + inset, j * edge + inset, edge - 2 * inset, edge - 2 * inset);
    };
    for (let i = 0; i < columns; i++) {
      for (let j = 0; j < rows; j++) {
        const c = /** @type {Cell} */ ([x0 + i, y1 - j, z]);
        const k = key(c);
        pen.strokeStyle = of("grid");
        pen.strokeRect(i * edge + 0.5, j * edge + 0.5, edge, edge);
        if (z > 0 && structure.has([c[0], c[1], z - 1])) square(i, j, of("below"), edge * 0.3);
        if (structure.cells.has(k)) {
          const other = this.partner.get(k);
          const axis = other ? c.findIndex((v, n) => v !== other[n]) : -1;
          const colour = structure.selected.has(k) || choice.has(k) ? of("selected") : this.left.has(k) ? of("left") : axis < 0 ? of("cube") : of(["along-x", "along-y", "along-z"][axis]);
          square(i, j, colour, 1);
          if (other && axis < 2) {
            // Two cells of a module run into each other.
            const [dx, dy] = [other[0] - c[0], c[1] - other[1]];
            pen.fillRect(i * edge + 1 + Math.max(0, dx) * (edge - 2), j * edge + 1 + Math.max(0, dy) * (edge - 2), dx ? 2 * Math.abs(dx) : edge - 2, dy ? 2 * Math.abs(dy) : edge - 2);
          }
          if (structure.pins.has(k)) {
            // A pinned module has a rhomb on each cell.
            const [x, y, r] = [(i + 0.5) * edge, (j + 0.5) * edge, edge * 0.26];
            pen.fillStyle = of("edge");
            pen.beginPath();
            for (const [dx, dy] of [[0, -r], [r, 0], [0, r], [-r, 0]]) pen.lineTo(x + dx, y + dy);
            pen.fill();
          } else if (axis === 2) {
            pen.fillStyle = of("edge");
            pen.beginPath();
            pen.arc((i + 0.5) * edge, (j + 0.5) * edge, edge * 0.12, 0, 7);
            pen.fill();
          }
        }
        if (adds.has(k)) square(i, j, of("add"), edge * 0.18);
        if (removes.has(k)) square(i, j, of("remove"), edge * 0.18);
        if (c[0] === structure.cursor[0] && c[1] === structure.cursor[1]) {
          pen.strokeStyle = of("cursor");
          pen.lineWidth = 2;
          pen.strokeRect(i * edge + 1, j * edge + 1, edge - 1, edge - 1);
          pen.lineWidth = 1;
        }
      }
    }
  }
}
