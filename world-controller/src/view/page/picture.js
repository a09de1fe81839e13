// From the state at a time to the drawing: the place and colour of each part, and the links between modules.
// Colours are those of the style sheet.

import { PART, PATTERN, RIBBON } from "./drawing.js";
import { POSE, UPRIGHT, box, halfCube, posesAt, wires } from "./parts.js";
import { FILLS } from "./story.js";

/** The meanings of colours, and their names. */
export const MEANINGS = {
  state: "state",
  level: "level of the goal",
  gradient: "gradient",
  locks: "locks",
};

/** Meanings that depend on messages between modules. */
export const TOLD = ["gradient", "locks"];
export const UNSEEN = "messages between modules are not available while processes run";

const FAR = 65535;

/** A scale of colours from near to far, readable in grey and without colour vision (viridis). */
const SCALE = [
  [0.267, 0.005, 0.329],
  [0.231, 0.318, 0.545],
  [0.128, 0.567, 0.551],
  [0.369, 0.789, 0.383],
  [0.993, 0.906, 0.144],
];

export function scale(x) {
  const at = Math.max(0, Math.min(0.9999, x)) * (SCALE.length - 1);
  const i = Math.floor(at);
  return SCALE[i].map((c, k) => c + (SCALE[i + 1][k] - c) * (at - i));
}

const css = (rgb) => `rgb(${rgb.map((c) => Math.round(c * 255)).join(" ")})`;

/** Returns a distinct colour for every module, for locks. */
const ownColour = (id) => {
  const hue = (id * 0.618034) % 1;
  return [0, 1 / 3, 2 / 3].map((o) => 0.5 + 0.32 * Math.cos(2 * Math.PI * (hue + o)));
};

/** Returns the centre of a cell. */
const middle = ([x, y, z]) => [x, y, z + 0.5];

/** Returns a cell as one number. */
const key = ([x, y, z]) => ((x + 32768) * 65536 + (y + 32768)) * 65536 + z + 32768;

/** Returns the number of the cell that the centre of a part is in. */
const cellKey = (poses, at) => key([Math.round(poses[at]), Math.round(poses[at + 1]), Math.floor(poses[at + 2])]);

const least = (list) => list.reduce((a, b) => Math.min(a, b), Infinity);
const most = (list) => list.reduce((a, b) => Math.max(a, b), -Infinity);

class Numbers {
  constructor() {
    this.list = new Float32Array(1024);
    this.length = 0;
  }
  clear() {
    this.length = 0;
  }
  push(...numbers) {
    if (this.length + numbers.length > this.list.length) {
      const larger = new Float32Array(this.list.length * 2);
      larger.set(this.list);
      this.list = larger;
    }
    this.list.set(numbers, this.length);
    this.length += numbers.length;
  }
  /** Adds a part whose pose is in a list. */
  part(poses, from, size, [r, g, b], pattern, [er, eg, eb]) {
    if (this.length + PART > this.list.length) this.push();
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
  /** Adds a part that stands upright in a cell. */
  inCell(cell, size, paint, edge) {
    this.part([...middle(cell), ...UPRIGHT], 0, size, paint, 0, edge);
  }
  view() {
    return this.list.subarray(0, this.length);
  }
}

/** The cells near the start and the goals that resting bodies fill. */
class Filled {
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

const MOST_CELLS = 4e6;

export class Picture {
  constructor(drawing, story) {
    this.drawing = drawing;
    this.story = story;
    this.words = story.scene.words;
    const layer = (mesh, fills = false) => ({ mesh, fills, parts: new Numbers() });
    /** By shape: the layers of upright parts, of turned ones, and of the outline of a chosen one. */
    this.shapes = story.scene.shapes.map((shape) => {
      if (shape.kind === "box") {
        const { size } = shape;
        // The outline of the chosen module consists of its far sides, so it needs all of them.
        const turned = () => layer(drawing.mesh(box(false), { size, turned: true }));
        const upright = layer(drawing.mesh(box(true), { size, facing: true }), size.every((x) => x === 1));
        return { upright, turned: turned(), chosen: turned(), half: Math.max(...size) / 2 };
      }
      const { radius, half_edge: edge } = shape;
      const round = () => layer(drawing.mesh(halfCube(radius, edge), { round: { radius, edge }, turned: true }));
      const parts = round();
      return { upright: parts, turned: parts, chosen: round(), half: radius };
    });
    this.layers = [...new Set(this.shapes.flatMap(({ upright, turned }) => [upright, turned]))];
    this.foreignMesh = drawing.mesh(box(true), { facing: true });
    this.ghostMesh = drawing.mesh(wires());
    this.foreign = new Numbers();
    this.ghosts = new Numbers();
    this.links = new Numbers();
    this.marks = new Numbers();
    this.middles = [];
    this.poses = [];
    this.goals = story.scene.goals.map((goal) => this.readGoal(goal));
    this.bounds = this.measure();
    this.filled = new Filled(this.bounds);
    this.theme();
  }

  readGoal({ cells }) {
    const levels = new Map(cells.map(([x, y, z, level]) => [key([x, y, z]), level]));
    // Of a large goal only the outside is drawn.
    const inside = (c) => [0, 1, 2].every((i) => [-1, 1].every((d) => levels.has(key(c.slice(0, 3).map((x, k) => x + (k === i ? d : 0))))));
    return { cells, levels, highest: most([1, ...levels.values()]), outside: cells.filter((c) => !inside(c)) };
  }

  /** Measures the corners of the scene, roughly (start, each goal, floor), and its lowest height. */
  measure() {
    const points = [];
    const box = (middles) => {
      const low = [0, 1, 2].map((i) => least(middles.map((c) => c[i])) - 0.5);
      const high = [0, 1, 2].map((i) => most(middles.map((c) => c[i])) + 0.5);
      for (let k = 0; k < 8; k++) points.push([0, 1, 2].map((i) => ((k >> i) & 1 ? high : low)[i]));
    };
    const start = this.story.modules.map(({ first }) => first.poses.slice(0, 3));
    const { floor } = this.story.scene;
    for (const goal of this.goals) box(goal.cells.map(middle));
    if (!floor) box(start);
    else {
      const [xs, ys] = [0, 1].map((i) => [floor.min[i] - 0.5, floor.max[i] + 0.5]);
      for (const x of xs) for (const y of ys) points.push([x, y, 0]);
      for (const [x, y] of start) points.push([x, y, floor.headroom]);
    }
    const along = (i) => points.map((p) => p[i]);
    const low = [0, 1, 2].map((i) => least(along(i)));
    const high = [0, 1, 2].map((i) => most(along(i)));
    return { points, low, high };
  }

  /** Rereads the colours of the page. */
  theme() {
    const style = getComputedStyle(document.documentElement);
    const probe = document.createElement("canvas").getContext("2d", { willReadFrequently: true });
    const read = (name) => {
      probe.fillStyle = style.getPropertyValue(name).trim();
      probe.fillRect(0, 0, 1, 1);
      return [...probe.getImageData(0, 0, 1, 1).data].slice(0, 3).map((c) => c / 255);
    };
    this.colour = {};
    for (const name of ["idle", "active", "done", "dead", "paused", "stuck", "none"]) {
      this.colour[name] = read(`--m-${name}`);
    }
    for (const name of ["paper", "sky", "edge", "mark", "ghost", "foreign", "chosen", "wait", "bad", "floor", "line"]) {
      this.colour[name] = read(`--${name}`);
    }
    this.classColours = this.story.scene.classes.map((name) => read(`--c-${name}`));
    this.dark = style.getPropertyValue("--dark").trim() === "1";
  }

  /** Returns the state of a module at a time, for the picture and the panel. */
  of(id, t, talk) {
    const { story } = this;
    const life = story.lifeAt(id, t);
    const standing = story.standingAt(id, t);
    const gradient = talk ? (talk.gradient[id] ?? FAR) : null;
    return { life, standing, stuck: story.stuckAt(id, t) || (standing.flags & 2) !== 0, gradient };
  }

  roleName({ life, standing }, moving) {
    if (life === "dead") return "dead";
    if (life === "paused") return "paused";
    const { roles, moving_role } = this.words;
    const shown = moving && moving_role !== null && standing.role !== FILLS ? moving_role : standing.role;
    return roles[shown]?.colour ?? "none";
  }

  build(t, options) {
    const { story, colour } = this;
    const talk =
      options.messages || options.meaning === "gradient" || options.meaning === "locks" || options.chosen !== null
        ? story.talkAt(t)
        : null;
    [this.foreign, this.ghosts, this.links, this.marks].forEach((n) => n.clear());
    for (const { upright, turned, chosen } of this.shapes) for (const { parts } of [upright, turned, chosen]) parts.clear();
    const owners = new Map();
    for (let i = 0; i < (talk?.locks.length ?? 0); i += 2) owners.set(talk.locks[i], talk.locks[i + 1]);
    const locking = new Set(owners.values());
    let farthest = 1;
    if (options.meaning === "gradient") talk?.gradient.forEach((d) => d !== FAR && (farthest = Math.max(farthest, d)));
    // If bodies hide what is between them, they are drawn smaller while messages are shown.
    const back = options.messages && this.words.scale_among_messages !== null;
    const size = back ? this.words.scale_among_messages : this.words.scale;
    const { goal, shift } = story.goalAt(t);
    const now = this.goals[Math.min(goal, this.goals.length - 1)];
    const taken = new Set();
    const waits = new Map();
    const counts = { alive: 0, dead: 0, paused: 0, moving: 0, unheard: 0, stuck: 0 };
    this.filled.clear();
    this.drawing.shaded = false;

    for (let id = 0; id < story.modules.length; id++) {
      const body = story.bodyAt(id, t);
      const known = this.of(id, t, talk);
      const role = this.roleName(known, body.doing !== null);
      if (known.life === "dead") counts.dead++;
      else counts.alive++;
      if (known.life === "paused") counts.paused++;
      if (body.doing) counts.moving++;
      if (role === "none") counts.unheard++;
      if (known.stuck) counts.stuck++;
      if (known.life === "alive" && known.standing.waits !== null) waits.set(id, known.standing.waits);
      let paint = colour[role];
      if (options.meaning === "level") paint = this.levelColour(known, body, now, shift);
      else if (options.meaning === "gradient") {
        const far = known.gradient === FAR || known.gradient === null;
        paint = far ? colour.none : scale(1 - known.gradient / farthest);
      } else if (options.meaning === "locks") {
        const owner = owners.get(id);
        paint = owner !== undefined ? ownColour(owner) : locking.has(id) ? ownColour(id) : colour.none;
      }
      if (back) paint = paint.map((c, i) => c + (colour.sky[i] - c) * 0.45);
      let pattern = PATTERN.plain;
      let edge = colour.edge;
      if (known.life === "dead") [pattern, edge] = [PATTERN.dead, colour.mark];
      else if (known.life === "paused") [pattern, edge] = [PATTERN.paused, colour.mark];
      else if (known.stuck) [pattern, edge] = [PATTERN.stuck, colour.stuck];
      this.put(id, body, size, paint, pattern, edge, id === options.chosen, taken);
    }
    if (!back) this.hideEnclosed();
    for (const cell of story.obstaclesAt(t)) this.foreign.inCell(cell, 0.9, colour.foreign, colour.edge);
    if (options.goal) {
      for (const [x, y, z] of now.outside) {
        const at = [x + shift[0], y + shift[1], z];
        if (taken.has(key(at))) continue;
        this.ghosts.inCell(at, 0.94, colour.ghost, colour.ghost);
      }
    }
    if (options.messages && talk) this.drawTalk(talk, options);
    // Modules that wait for each other during a run mostly go on a moment later. They are stuck only at the
    // end of a run that ended in a deadlock.
    const stalled = t >= story.now && story.over && story.outcome === "deadlock";
    const stall = stalled ? story.report?.unbuilt : null;
    for (const { module, waits_for } of stall?.waiting ?? []) if (waits_for !== null) waits.set(module, waits_for);
    const circle = stalled ? story.circle(waits) : new Set();
    stall?.wait_cycle.forEach((id) => circle.add(id));
    this.drawWaits(waits, circle, options, stalled);
    if (options.meaning === "locks") {
      for (const [holder, owner] of owners) this.arrow(holder, owner, [...ownColour(owner), 0.9], 0.05);
    }
    const arrows = waits.size > circle.size && (options.waits || stalled);
    return { talk, waits, circle, counts, farthest, arrows };
  }

  /** Hides boxes that have a neighbour on each side, as they are invisible. */
  hideEnclosed() {
    for (const { fills, parts } of this.layers) {
      const { list, length } = parts;
      for (let at = 0; fills && at < length; at += PART) {
        const [x, y, z] = [list[at], list[at + 1], list[at + 2]];
        const rests = Number.isInteger(x) && Number.isInteger(y) && Number.isInteger(z - 0.5);
        if (rests && this.filled.encloses(x, y, z)) list[at + PART - 1] = 0;
      }
    }
  }

  levelColour({ standing }, { to }, goal, shift) {
    const [x, y, z] = to.poses;
    const level = goal.levels.get(cellKey([x - shift[0], y - shift[1], z], 0));
    if (standing.role !== FILLS || level === undefined) return this.colour.none;
    return scale(0.08 + 0.88 * (level / goal.highest));
  }

  put(id, body, size, paint, pattern, edge, isChosen, taken) {
    const { shapes, tones } = this.story.modules[id];
    const poses = posesAt(body);
    const middle = [0, 0, 0];
    for (let i = 0, at = 0; i < shapes.length; i++, at += POSE) {
      const shape = this.shapes[shapes[i]];
      const layer = poses[at + 6] === 1 ? shape.upright : shape.turned;
      const tint = tones[i] === 0 ? paint : paint.map((c) => c + (this.dark ? 0.16 : 0.26) * (1 - c));
      layer.parts.part(poses, at, size, tint, pattern, edge);
      if (isChosen) shape.chosen.parts.part(poses, at, size, tint, 0, edge);
      if (layer.fills && !body.doing) this.filled.add(poses[at], poses[at + 1], poses[at + 2]);
      for (let k = 0; k < 3; k++) middle[k] += poses[at + k] / shapes.length;
      taken.add(cellKey(poses, at));
    }
    this.middles[id] = middle;
    this.poses[id] = poses;
  }

  /** Adds a ribbon. */
  ribbon(into, a, wa, b, wb, rgba, flow) {
    into.push(...a, wa, ...b, wb, ...rgba, flow);
  }

  drawTalk(talk, { classes }) {
    const n = classes.length;
    const step = 2 + n;
    const seconds = this.story.width / 1e6;
    const middles = this.middles;
    for (let i = 0; i < talk.edges.length; i += step) {
      const [from, to] = [middles[talk.edges[i]], middles[talk.edges[i + 1]]];
      let [sum, top, which] = [0, 0, 0];
      for (let k = 0; k < n; k++) {
        const count = classes[k] ? talk.edges[i + 2 + k] : 0;
        sum += count;
        if (count > top) [top, which] = [count, k];
      }
      if (sum === 0 || !from || !to) continue;
      const often = Math.log2(1 + sum / seconds);
      const strong = Math.min(1, 0.5 + 0.2 * often);
      const width = 0.03 + 0.05 * Math.min(1, often / 5);
      // The two directions are drawn side by side.
      const d = to.map((x, k) => x - from[k]);
      const across = [d[1] - d[2], d[2] - d[0], d[0] - d[1]];
      const length = Math.hypot(...across) || 1;
      const aside = across.map((x) => (x / length) * 0.09);
      // Smaller bodies leave the links between them visible; other links are drawn over the bodies.
      const back = this.words.scale_among_messages !== null;
      const lift = back ? 0 : 0.15;
      const place = (p) => p.map((x, k) => x + aside[k] + (k === 2 ? lift : 0));
      this.ribbon(back ? this.links : this.marks, place(from), width, place(to), width, [...this.classColours[which], strong], 1);
    }
  }

  /** Draws who waits for whom: all of it at a final deadlock, and circles in another colour. */
  drawWaits(waits, circle, options, stalled) {
    for (const [from, to] of waits) {
      const within = circle.has(from) && circle.has(to);
      if (!within && !stalled && !options.waits && from !== options.chosen && to !== options.chosen) continue;
      const rgb = within ? this.colour.bad : this.colour.wait;
      this.arrow(from, to, [...rgb, within ? 1 : 0.85], within ? 0.09 : stalled ? 0.06 : 0.04);
    }
  }

  /** Adds a bent arrow from one module to another, over everything. */
  arrow(from, to, rgba, width) {
    const [a, b] = [this.middles[from], this.middles[to]];
    if (!a || !b) return;
    const length = Math.hypot(...a.map((x, i) => x - b[i]));
    const rise = 0.5 + length * 0.22;
    const at = (s) => a.map((x, i) => x + (b[i] - x) * s + (i === 2 ? rise * 4 * s * (1 - s) : 0));
    const pieces = 12;
    const neck = 1 - Math.min(0.35, (width * 5) / Math.max(length, 0.1));
    for (let i = 0; i < pieces; i++) {
      this.ribbon(this.marks, at((i / pieces) * neck), width, at(((i + 1.08) / pieces) * neck), width, rgba, 0);
    }
    this.ribbon(this.marks, at(neck - 0.01), width * 3.2, at(1), 0, rgba, 0);
  }

  draw(camera, options, clock) {
    const { colour, bounds } = this;
    const floor = this.story.scene.floor;
    const ground = !floor
      ? {
          z: bounds.low[2] - 0.02,
          bounds: [bounds.low[0] - 9, bounds.low[1] - 9, bounds.high[0] + 9, bounds.high[1] + 9],
          plates: false,
          fill: [...colour.floor, 0],
          line: [...colour.line, this.dark ? 0.5 : 0.8],
        }
      : {
          z: 0,
          bounds: [floor.min[0] - 0.5, floor.min[1] - 0.5, floor.max[0] + 0.5, floor.max[1] + 0.5],
          plates: true,
          fill: [...colour.floor, 1],
          line: [...colour.line, 1],
        };
    const seen = ({ parts }) => parts.length > 0;
    const group = ({ mesh, parts }) => ({ mesh, numbers: parts.view() });
    const groups = this.layers.filter(seen).map(group);
    if (this.foreign.length) groups.push({ mesh: this.foreignMesh, numbers: this.foreign.view() });
    this.drawing.draw({
      camera,
      paper: colour.sky,
      ground,
      groups,
      ghosts: this.ghosts.length ? { mesh: this.ghostMesh, numbers: this.ghosts.view(), colour: [...colour.ghost, this.ghosts.length > 200 * PART ? 0.5 : 0.9] } : null,
      chosen: this.shapes.map(({ chosen }) => chosen).filter(seen).map(group),
      outline: colour.chosen,
      links: this.links.view(),
      marks: this.marks.view(),
      light: [0.45, -0.55, 1],
      clock,
      dark: this.dark,
    });
  }

  /** Returns the first module on a ray; null if none. */
  pick({ origin, direction }) {
    let [best, found] = [Infinity, null];
    for (let id = 0; id < this.poses.length; id++) {
      const { shapes } = this.story.modules[id];
      const poses = this.poses[id];
      for (let part = 0; part < shapes.length; part++) {
        const { half } = this.shapes[shapes[part]];
        let [near, far] = [0, Infinity];
        for (let i = 0; i < 3; i++) {
          const a = (poses[POSE * part + i] - half - origin[i]) / direction[i];
          const b = (poses[POSE * part + i] + half - origin[i]) / direction[i];
          near = Math.max(near, Math.min(a, b));
          far = Math.min(far, Math.max(a, b));
        }
        if (near <= far && near < best) [best, found] = [near, id];
      }
    }
    return found;
  }

  /** Returns the entries of the legend: text, colour and pattern. */
  legend(meaning, { farthest, circle, arrows, counts, talk }) {
    const { colour } = this;
    const swatch = (text, rgb, pattern) => ({ text, colour: css(rgb), pattern });
    const told = talk || !TOLD.includes(meaning);
    const entries = told
      ? this.meanings(meaning, farthest, swatch, colour, counts)
      : [swatch(this.story.scene.messages ? "loading" : UNSEEN, colour.none)];
    if (circle.size) entries.push(swatch("wait for each other in a circle", colour.bad));
    if (arrows) entries.push(swatch("waits for", colour.wait));
    return entries;
  }

  meanings(meaning, farthest, swatch, colour, counts) {
    const { roles, levels, distance } = this.words;
    const lives = [];
    if (counts.unheard) lives.push(swatch("not heard of yet", colour.none));
    if (counts.dead) lives.push(swatch("dead", colour.dead, "dead"));
    if (counts.paused) lives.push(swatch("paused", colour.paused, "paused"));
    if (counts.stuck) lives.push(swatch("stuck", colour.none, "stuck"));
    const ramp = (from, to, near, far) => ({
      ramp: [0, 0.25, 0.5, 0.75, 1].map((x) => css(scale(from + (to - from) * x))),
      near,
      far,
    });
    switch (meaning) {
      case "state":
        return [...roles.map((role) => swatch(role.legend, colour[role.colour])), ...lives];
      case "level":
        return [ramp(0.08, 0.96, ...levels), swatch("not in the goal", colour.none)];
      case "gradient":
        return [ramp(1, 0, "at a target", `${farthest} ${distance[1]}`), swatch("knows no target", colour.none)];
      default:
        return [swatch("locks a module, or is locked by one", ownColour(3)), swatch("no lock", colour.none)];
    }
  }
}
