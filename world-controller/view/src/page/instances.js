// Growing lists of the values of many equal things, and the geometry that the graphics card draws them from.
// Independent of swarms.

import {
  BufferAttribute,
  DynamicDrawUsage,
  InstancedBufferGeometry,
  InstancedInterleavedBuffer,
  InterleavedBufferAttribute,
  Sphere,
  Vector3,
} from "./vendor/three.js";

export const PATTERN = { plain: 0, dead: 1, paused: 2, stuck: 3 };

/** The values of one part: place and size, rotation, colour and pattern, edge colour and visibility. */
const PART_VALUES = { place: 4, rotation: 4, paint: 4, edge: 4 };
/** The values of one ribbon: from, width there, to, width there, colour, speed of flow. */
const RIBBON_VALUES = { begin: 4, end: 4, tint: 4, flow: 1 };

const sum = (values) => Object.values(values).reduce((a, b) => a + b, 0);
export const PART = sum(PART_VALUES);
export const RIBBON = sum(RIBBON_VALUES);

/** Number of depths that are told apart when parts are put in order. */
const DEPTHS = 4096;

/** Where things are is not known from their shape. */
export const EVERYWHERE = new Sphere(new Vector3(), Infinity);

/** A list of numbers that is filled anew for every picture. */
export class Numbers {
  constructor() {
    this.list = new Float32Array(1024);
    this.length = 0;
  }

  clear() {
    this.length = 0;
  }

  /** Makes room for this many more numbers. */
  reserve(more) {
    if (this.length + more <= this.list.length) return;
    const larger = new Float32Array(Math.max(this.list.length * 2, this.length + more));
    larger.set(this.list);
    this.list = larger;
  }

  push(...numbers) {
    this.reserve(numbers.length);
    this.list.set(numbers, this.length);
    this.length += numbers.length;
  }

  /** Adds a part whose pose is in a list. */
  part(poses, from, size, [r, g, b], pattern, [er, eg, eb]) {
    this.reserve(PART);
    const { list } = this;
    let at = this.length;
    list[at++] = poses[from];
    list[at++] = poses[from + 1];
    list[at++] = poses[from + 2];
    list[at++] = size;
    list[at++] = poses[from + 3];
    list[at++] = poses[from + 4];
    list[at++] = poses[from + 5];
    list[at++] = poses[from + 6];
    list[at++] = r;
    list[at++] = g;
    list[at++] = b;
    list[at++] = pattern;
    list[at++] = er;
    list[at++] = eg;
    list[at++] = eb;
    list[at++] = 1;
    this.length = at;
  }

  view() {
    return this.list.subarray(0, this.length);
  }
}

/** One shape that is drawn many times; its objects in a scene use `geometry`. */
class Instances {
  constructor(values, corners, dimension) {
    this.values = values;
    this.stride = sum(values);
    this.objects = [];
    this.shape = new BufferAttribute(corners, dimension);
    this.enlarge(64);
  }

  /** Makes a geometry with room for this many; its size on the graphics card is fixed. */
  enlarge(room) {
    this.room = room;
    this.geometry?.dispose();
    this.buffer = new InstancedInterleavedBuffer(new Float32Array(room * this.stride), this.stride, 1);
    this.buffer.setUsage(DynamicDrawUsage);
    this.geometry = new InstancedBufferGeometry();
    this.geometry.boundingSphere = EVERYWHERE;
    this.geometry.setAttribute("position", this.shape);
    let at = 0;
    for (const [name, size] of Object.entries(this.values)) {
      this.geometry.setAttribute(name, new InterleavedBufferAttribute(this.buffer, size, at));
      at += size;
    }
    for (const object of this.objects) object.geometry = this.geometry;
  }

  /** Adds an object that draws them. */
  shows(object) {
    object.geometry = this.geometry;
    object.frustumCulled = false;
    object.matrixAutoUpdate = object.matrixWorldAutoUpdate = false;
    object.visible = false;
    this.objects.push(object);
    return object;
  }

  /** Returns the list to write this many into; `ready` follows. */
  begin(count) {
    if (count > this.room) this.enlarge(Math.max(count, this.room * 2));
    return this.buffer.array;
  }

  ready(count) {
    this.geometry.instanceCount = count;
    for (const object of this.objects) object.visible = count > 0;
    if (count === 0) return;
    this.buffer.clearUpdateRanges();
    this.buffer.addUpdateRange(0, count * this.stride);
    this.buffer.needsUpdate = true;
  }

  fill(numbers) {
    const count = numbers.length / this.stride;
    this.begin(count).set(numbers);
    this.ready(count);
  }
}

/** Ribbons between points. */
export class Ribbons extends Instances {
  constructor() {
    super(RIBBON_VALUES, new Float32Array([0, -1, 1, -1, 1, 1, 0, -1, 1, 1, 0, 1]), 2);
  }
}

/** Parts of one shape. */
export class Parts extends Instances {
  /**
   * `size` scales them. `round` is half a ball with plates of this radius and half edge; instances of others may be
   * `turned` or stand upright. `facing` has only three sides of an upright box, mirrored to those that are visible.
   */
  constructor(corners, { size = [1, 1, 1], round = null, turned = false, facing = false } = {}) {
    super(PART_VALUES, corners, 3);
    this.size = size;
    this.round = round;
    this.turned = turned;
    this.facing = facing;
    /** Further objects that draw them, by name. */
    this.also = /** @type {Record<string, any>} */ ({});
  }

  /** Takes the visible parts, nearest first, so that hidden pixels are not painted. */
  fillNearestFirst(numbers, [ox, oy, oz]) {
    const all = numbers.length / PART;
    if (!(this.depths?.length >= all)) {
      this.depths = new Float32Array(all * 2);
      this.counts = new Uint32Array(DEPTHS + 1);
    }
    const { depths, counts } = this;
    let [nearest, farthest] = [-Infinity, Infinity];
    for (let i = 0, at = 0; i < all; i++, at += PART) {
      const depth = numbers[at] * ox + numbers[at + 1] * oy + numbers[at + 2] * oz;
      depths[i] = depth;
      if (depth > nearest) nearest = depth;
      if (depth < farthest) farthest = depth;
    }
    const finely = (DEPTHS - 1) / Math.max(nearest - farthest, 1e-6);
    const drawer = (i) => ((nearest - depths[i]) * finely) | 0;
    // In linear time: counted by depth, then each is put at its place.
    counts.fill(0);
    for (let i = 0, at = PART - 1; i < all; i++, at += PART) if (numbers[at] !== 0) counts[drawer(i) + 1]++;
    for (let d = 0; d < DEPTHS; d++) counts[d + 1] += counts[d];
    const seen = counts[DEPTHS];
    const sorted = this.begin(seen);
    for (let i = 0, at = 0; i < all; i++, at += PART) {
      if (numbers[at + PART - 1] === 0) continue;
      let to = counts[drawer(i)]++ * PART;
      for (let k = 0; k < PART; k++) sorted[to++] = numbers[at + k];
    }
    this.ready(seen);
  }
}
