// The drawings of the first page.

import { box } from "./cells.js";

/** @typedef {import("./cells.js").Cell} Cell */

/** @type {{ name: string, about: string, cells: Cell[] }[]} */
export const EXAMPLES = [
  {
    name: "chair",
    about: "four legs, a seat and a back",
    cells: [...[[0, 0], [2, 0], [0, 2], [2, 2]].flatMap(([x, y]) => box([x, y, 0], [x, y, 1])), ...box([0, 0, 2], [2, 2, 2]), ...box([0, 2, 3], [2, 2, 4])],
  },
  {
    name: "table",
    about: "a plate on four legs",
    cells: [...[[0, 0], [3, 0], [0, 2], [3, 2]].flatMap(([x, y]) => box([x, y, 0], [x, y, 1])), ...box([0, 0, 2], [3, 2, 2])],
  },
  {
    name: "stool",
    about: "a seat on one foot",
    cells: [...box([0, 0, 0], [2, 2, 0]), [1, 1, 1], ...box([0, 0, 2], [2, 2, 2])],
  },
  {
    name: "arch",
    about: "two pillars and a span",
    cells: [...box([0, 0, 0], [0, 1, 2]), ...box([4, 0, 0], [4, 1, 2]), ...box([0, 0, 3], [4, 1, 3])],
  },
  {
    name: "stairs",
    about: "three steps",
    cells: [...box([0, 0, 0], [1, 2, 0]), ...box([0, 1, 1], [1, 2, 1]), ...box([0, 2, 2], [1, 2, 2])],
  },
  {
    name: "wall",
    about: "with a window",
    cells: [...box([0, 0, 0], [4, 0, 0]), ...box([0, 0, 1], [1, 0, 1]), ...box([3, 0, 1], [4, 0, 1]), ...box([0, 0, 2], [4, 0, 2])],
  },
];

/**
 * A small picture of cells, seen from above the front right corner.
 * @param {Cell[]} cells @returns {SVGSVGElement}
 */
export function picture(cells) {
  const NS = "http://www.w3.org/2000/svg";
  const svg = /** @type {SVGSVGElement} */ (document.createElementNS(NS, "svg"));
  const at = ([x, y, z]) => [(x + y) * 0.87, (x - y) * 0.5 - z];
  const sides = [
    ["top", [[0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]]],
    ["left", [[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]]],
    ["right", [[1, 0, 0], [1, 1, 0], [1, 1, 1], [1, 0, 1]]],
  ];
  const drawn = [...cells].sort((a, b) => a[0] - a[1] + a[2] - (b[0] - b[1] + b[2]));
  let [x0, y0, x1, y1] = [Infinity, Infinity, -Infinity, -Infinity];
  for (const c of drawn) {
    for (const [name, corners] of sides) {
      const points = corners.map((k) => at(k.map((v, i) => v + c[i])));
      for (const [x, y] of points) [x0, y0, x1, y1] = [Math.min(x0, x), Math.min(y0, y), Math.max(x1, x), Math.max(y1, y)];
      const side = document.createElementNS(NS, "polygon");
      side.setAttribute("points", points.map((p) => p.map((v) => v.toFixed(2)).join()).join(" "));
      side.setAttribute("class", String(name));
      svg.append(side);
    }
  }
  svg.setAttribute("viewBox", `${x0 - 0.2} ${y0 - 0.2} ${x1 - x0 + 0.4} ${y1 - y0 + 0.4}`);
  svg.setAttribute("aria-hidden", "true");
  return svg;
}
