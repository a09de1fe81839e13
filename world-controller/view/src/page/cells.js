// Cells: their numbers, which of them are filled, and which are kept by a section.

/** Returns the centre of a cell. */
export const middle = ([x, y, z]) => [x, y, z + 0.5];

/**
 * Returns a cell as one number.
 * @param {number[]} cell
 */
export const key = ([x, y, z]) => ((x + 32768) * 65536 + (y + 32768)) * 65536 + z + 32768;

/** Returns the cell that the centre of a part is in. */
const cellAt = (poses, at) => [Math.round(poses[at]), Math.round(poses[at + 1]), Math.floor(poses[at + 2])];

/** Returns the number of that cell. */
export const cellKey = (poses, at) => key(cellAt(poses, at));

/** A plane between cells, as in `render --section`: cells up to `last` along an axis are kept, or those from it on. */
export class Section {
  constructor(axis, above, last) {
    this.axis = axis;
    this.above = above;
    this.last = last;
  }
  keeps(cell) {
    return this.above ? cell[this.axis] >= this.last : cell[this.axis] <= this.last;
  }
  keepsPart(poses, at) {
    return this.keeps(cellAt(poses, at));
  }
  toString() {
    return `${"xyz"[this.axis]}${this.above ? ">=" : "<="}${this.last}`;
  }
}

/** Above this number, whether cells are filled is not tracked. */
const MOST_CELLS = 4e6;

/** The cells near the start and the goals that resting bodies fill. */
export class Filled {
  constructor({ low, high }) {
    // A margin for bodies that walk around the structure; cells beyond it are not tracked.
    this.low = low.map((x) => Math.floor(x) - 3);
    this.size = high.map((x, i) => Math.ceil(x) + 4 - this.low[i]);
    const cells = this.size.reduce((a, b) => a * b, 1);
    this.stamps = new Uint32Array(cells <= MOST_CELLS ? cells : 0);
    this.stamp = 0;
  }
  clear() {
    this.stamp++;
  }
  /** Returns the index of the cell with this centre; -1 at the rim and outside. */
  place(x, y, z) {
    const [i, j, k] = [x - this.low[0], y - this.low[1], z - 0.5 - this.low[2]];
    const [a, b, c] = this.size;
    if (i < 1 || j < 1 || k < 1 || i >= a - 1 || j >= b - 1 || k >= c - 1) return -1;
    return (k * b + j) * a + i;
  }
  add(x, y, z) {
    const at = this.place(x, y, z);
    if (at >= 0) this.stamps[at] = this.stamp;
  }
  /** Returns true if all neighbours of a cell are filled. */
  encloses(x, y, z) {
    const at = this.place(x, y, z);
    if (at < 0) return false;
    const [a, b] = this.size;
    const { stamps, stamp } = this;
    const both = (d) => stamps[at - d] === stamp && stamps[at + d] === stamp;
    return both(1) && both(a) && both(a * b);
  }
}
