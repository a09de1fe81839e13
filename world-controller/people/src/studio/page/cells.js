// Cells of the lattice as numbers, and the sets that tools make of them: lines, boxes, images under mirrors and turns.

/** @typedef {[number, number, number]} Cell x, y, z */

/** Coordinates of a drawing: |x|, |y| and z are at most this. */
export const LIMIT = 500;
const HALF = 512, SIDE = 1024;

/** @param {Cell} c @returns {number} the number of a cell, for sets */
export const key = ([x, y, z]) => ((z + HALF) * SIDE + (y + HALF)) * SIDE + x + HALF;
/** @param {number} k @returns {Cell} */
export const cell = (k) => [(k % SIDE) - HALF, (Math.floor(k / SIDE) % SIDE) - HALF, Math.floor(k / (SIDE * SIDE)) - HALF];
/** @param {Cell} c the floor is the layer 0 */
export const inRange = ([x, y, z]) => Math.abs(x) <= LIMIT && Math.abs(y) <= LIMIT && z >= 0 && z <= LIMIT;
/** @param {Cell} a @param {Cell} b @returns {Cell} */
export const plus = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
/** How far the numbers of the six cells that share a face with one are from its own: along x, against x, and so on. */
export const BESIDE = [1, -1, SIDE, -SIDE, SIDE * SIDE, -SIDE * SIDE];
/** The cells that others do not enclose on all sides. @param {Set<number>} cells @returns {Set<number>} */
export function outside(cells) {
  const found = new Set();
  for (const k of cells) if (BESIDE.some((d) => !cells.has(k + d))) found.add(k);
  return found;
}
/**
 * The first cell on a ray that is filled, and the direction out of the face through which the ray comes in.
 * @param {number[]} from @param {number[]} along
 * @param {Set<number>} cells @param {{ low: Cell, high: Cell }} box the corners of all cells
 * @returns {{ at: Cell, face: Cell } | null} null if there is none
 */
export function firstOn(from, along, cells, { low, high }) {
  const sign = along.map(Math.sign);
  // Where the ray comes into the box around all cells, and through a side across which axis.
  let [near, far, axis] = [0, Infinity, -1];
  for (let i = 0; i < 3; i++) {
    const [first, last] = sign[i] < 0 ? [high[i] + 0.5, low[i] - 0.5] : [low[i] - 0.5, high[i] + 0.5];
    if (sign[i] === 0) {
      if (from[i] < first || from[i] > last) return null;
      continue;
    }
    const enters = (first - from[i]) / along[i];
    if (enters > near) [near, axis] = [enters, i];
    far = Math.min(far, (last - from[i]) / along[i]);
  }
  if (near > far) return null;
  const at = /** @type {Cell} */ (from.map((v, i) => Math.min(Math.max(Math.round(v + near * along[i]), low[i]), high[i])));
  // Where the ray leaves the cell along each axis.
  const leaves = from.map((v, i) => (sign[i] === 0 ? Infinity : (at[i] + 0.5 * sign[i] - v) / along[i]));
  while (axis < 0 || !cells.has(key(at))) {
    axis = leaves.indexOf(Math.min(...leaves));
    at[axis] += sign[axis];
    if (at[axis] < low[axis] || at[axis] > high[axis]) return null;
    leaves[axis] += 1 / Math.abs(along[axis]);
  }
  return { at, face: /** @type {Cell} */ ([0, 1, 2].map((i) => (i === axis ? -sign[i] : 0))) };
}
/** @param {Cell} a @param {Cell} b */
export const same = (a, b) => a[0] === b[0] && a[1] === b[1] && a[2] === b[2];

/**
 * The corners of a set of cells.
 * @param {Iterable<Cell>} cells
 * @returns {{ low: Cell, high: Cell } | null}
 */
export function bounds(cells) {
  /** @type {Cell} */
  const low = [Infinity, Infinity, Infinity];
  /** @type {Cell} */
  const high = [-Infinity, -Infinity, -Infinity];
  for (const c of cells) {
    for (let i = 0; i < 3; i++) {
      if (c[i] < low[i]) low[i] = c[i];
      if (c[i] > high[i]) high[i] = c[i];
    }
  }
  return low[0] <= high[0] ? { low, high } : null;
}

/**
 * All cells of a box, both corners included.
 * @param {Cell} a @param {Cell} b
 * @returns {Cell[]}
 */
export function box(a, b) {
  const cells = [];
  const [low, high] = [a.map((v, i) => Math.min(v, b[i])), a.map((v, i) => Math.max(v, b[i]))];
  for (let z = low[2]; z <= high[2]; z++) for (let y = low[1]; y <= high[1]; y++) for (let x = low[0]; x <= high[0]; x++) cells.push([x, y, z]);
  return cells;
}

/**
 * A line of cells that share faces: each step goes along the axis that is behind most, of equals the first.
 * @param {Cell} a @param {Cell} b @param {number} thickness edge of the cube that is drawn along the line
 * @returns {Cell[]}
 */
export function line(a, b, thickness = 1) {
  const far = a.map((v, i) => Math.abs(b[i] - v));
  const sign = a.map((v, i) => Math.sign(b[i] - v));
  const done = [0, 0, 0];
  const at = [...a];
  const cells = [];
  const brush = () => cells.push(...box(at, at.map((v) => v + thickness - 1)));
  brush();
  for (let n = far[0] + far[1] + far[2]; n > 0; n--) {
    let axis = -1;
    for (let i = 0; i < 3; i++) {
      if (done[i] < far[i] && (axis < 0 || (2 * done[i] + 1) * far[axis] < (2 * done[axis] + 1) * far[i])) axis = i;
    }
    done[axis]++;
    at[axis] += sign[axis];
    brush();
  }
  return cells;
}

/** The image in a mirror across an axis; `twice` is twice the coordinate of the mirror, odd if it is between cells.
 * @param {Cell} c @param {0 | 1} axis @param {number} twice @returns {Cell} */
export function mirrored(c, axis, twice) {
  const image = [...c];
  image[axis] = twice - c[axis];
  return image;
}

/** Cells after a quarter turn about the vertical through the middle of their bounds.
 * @param {Cell[]} cells @returns {Cell[]} */
export function turned(cells) {
  const b = bounds(cells);
  if (!b) return [];
  return cells.map(([x, y, z]) => [b.low[0] + (b.high[1] - y), b.low[1] + (x - b.low[0]), z]);
}

/** Cells mirrored within their bounds. @param {Cell[]} cells @param {0 | 1} axis @returns {Cell[]} */
export function flipped(cells, axis) {
  const b = bounds(cells);
  return b ? cells.map((c) => mirrored(c, axis, b.low[axis] + b.high[axis])) : [];
}

/** A drawing moved so that it stands on the floor around the origin.
 * @param {{ cells: Cell[], pins?: [Cell, Cell][] }} drawing @returns {{ cells: Cell[], pins: [Cell, Cell][] }} */
export function settled({ cells, pins = [] }) {
  const b = bounds(cells);
  if (!b) return { cells: [], pins: [] };
  const by = /** @type {Cell} */ ([-Math.floor((b.low[0] + b.high[0]) / 2), -Math.floor((b.low[1] + b.high[1]) / 2), -b.low[2]]);
  const moved = (c) => plus(c, by);
  return { cells: cells.map(moved).filter(inRange), pins: pins.map(([a, c]) => [moved(a), moved(c)]) };
}

/** The six cells that share a face with one. @param {Cell} c @returns {Cell[]} */
export function neighbours(c) {
  return [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]].map((d) => plus(c, /** @type {Cell} */ (d)));
}

/**
 * The order in which modules are put together: from the floor up, each beside one that is there, if there is one.
 * @param {[Cell, Cell][]} pairs @returns {[Cell, Cell][]}
 */
export function buildOrder(pairs) {
  const rank = (p) => [Math.min(p[0][2], p[1][2]), Math.max(p[0][2], p[1][2]), p[0][1], p[0][0]];
  const waiting = [...pairs].sort((p, q) => { const [a, b] = [rank(p), rank(q)]; return a[0] - b[0] || a[1] - b[1] || a[2] - b[2] || a[3] - b[3]; });
  const beside = new Set();
  const order = [];
  const take = (pair) => {
    order.push(pair);
    for (const c of pair) for (const n of neighbours(c)) beside.add(key(n));
  };
  for (let left = waiting; left.length; ) {
    const later = [];
    for (const pair of left) (pair.some((c) => beside.has(key(c))) ? take : (p) => later.push(p))(pair);
    // A part that touches no other begins anew.
    if (later.length === left.length) take(later.shift());
    left = later;
  }
  return order;
}
