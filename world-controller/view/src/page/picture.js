// From the state at a time to the drawing: the place and colour of each part, and the links between modules.
// Colours are those of the style sheet.

import { Filled, cellKey, key, middle } from "./cells.js";
import { Numbers, PART, PATTERN } from "./instances.js";
import { TOLD, legend, ownColour, scale } from "./legend.js";
import { arrow, contactLines, messageLines } from "./links.js";
import { POSE, UPRIGHT, box, halfCube, posesAt, wires } from "./parts.js";
import { FILLS } from "./story.js";

const FAR = 65535;

/** More than a body has parts. */
const MOST_PARTS = 1024;

/** Returns the pose of a part that stands upright in a cell. */
const resting = (cell) => [...middle(cell), ...UPRIGHT];

const least = (list) => list.reduce((a, b) => Math.min(a, b), Infinity);
const most = (list) => list.reduce((a, b) => Math.max(a, b), -Infinity);

/** The number of the goal while none is built. */
const NO_GOAL = 0xffff;

export class Picture {
  constructor(renderer, story) {
    this.renderer = renderer;
    this.story = story;
    this.words = story.scene.words;
    const layer = (shape, fills = false) => ({ shape, fills, parts: new Numbers() });
    /** By shape: the layers of upright parts, of turned ones, and of the outline of a chosen one. */
    this.shapes = story.scene.shapes.map((shape) => {
      if (shape.kind === "box") {
        const { size } = shape;
        const upright = layer(renderer.bodies(box(true), { size, facing: true }), size.every((x) => x === 1));
        const turned = layer(renderer.bodies(box(false), { size, turned: true }));
        // The outline of the chosen module consists of its far sides, so it needs all of them.
        const chosen = layer(renderer.outlines(box(false), { size, turned: true }));
        return { upright, turned, chosen, half: Math.max(...size) / 2 };
      }
      const { radius, half_edge: edge } = shape;
      const ball = [halfCube(radius, edge), { round: { radius, edge }, turned: true }];
      const parts = layer(renderer.bodies(...ball));
      return { upright: parts, turned: parts, chosen: layer(renderer.outlines(...ball)), half: radius };
    });
    this.layers = [...new Set(this.shapes.flatMap(({ upright, turned }) => [upright, turned]))];
    this.foreign = layer(renderer.bodies(box(true), { facing: true }));
    this.ghosts = layer(renderer.wires(wires()));
    this.links = new Numbers();
    this.marks = new Numbers();
    this.middles = [];
    this.poses = [];
    /** Parts that are not shown, by module and number. */
    this.hidden = new Set();
    this.goals = story.scene.goals.map((goal) => this.readGoal(goal));
    this.bounds = this.measure();
    this.filled = new Filled(this.bounds);
    this.theme();
  }

  readGoal({ cells }) {
    const levels = new Map(cells.map(([x, y, z, level]) => [key([x, y, z]), level]));
    // Of a large goal only the outside is drawn.
    const inside = (c) => [0, 1, 2].every((i) => [-1, 1].every((d) => levels.has(key(c.slice(0, 3).map((x, k) => x + (k === i ? d : 0))))));
    return { cells, levels, highest: most([1, ...levels.values()]), outside: cells.filter((c) => !inside(c)), turned: [] };
  }

  /** Returns a goal by its number, turned by quarters from x to y. */
  goalOf(number, quarters) {
    if (number === NO_GOAL) return this.readGoal({ cells: [] });
    const goal = this.goals[Math.min(number, this.goals.length - 1)];
    if (!quarters) return goal;
    const turn = ([x, y, z, level]) => [-y, x, z, level];
    goal.turned[quarters] ??= this.readGoal({ cells: [...Array(quarters)].reduce((cells) => cells.map(turn), goal.cells) });
    return goal.turned[quarters];
  }

  /** Measures the corners of the scene, roughly (start, each goal, floor), and its lowest height. */
  measure() {
    const points = [];
    const box = (middles) => {
      // Of families whose goal is no shape.
      if (!middles.length) return;
      const low = [0, 1, 2].map((i) => least(middles.map((c) => c[i])) - 0.5);
      const high = [0, 1, 2].map((i) => most(middles.map((c) => c[i])) + 0.5);
      for (let k = 0; k < 8; k++) points.push([0, 1, 2].map((i) => ((k >> i) & 1 ? high : low)[i]));
    };
    const start = this.story.modules.map(({ first }) => first.poses.slice(0, 3));
    const { floor } = this.story.scene;
    for (const goal of this.goals) box(goal.cells.map(middle));
    if (!floor) box(start.length || points.length ? start : [[0, 0, 0]]);
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
    for (const name of ["paper", "sky", "edge", "mark", "ghost", "foreign", "chosen", "wait", "bad", "floor", "line", "soft"]) {
      this.colour[name] = read(`--${name}`);
    }
    for (const hold of ["rests", "held", "shared", "fallen"]) this.colour[hold] = read(`--element-${hold}`);
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

  roleName({ life, standing }, moving, isBuilt) {
    if (life === "dead") return "dead";
    if (life === "paused") return "paused";
    const { roles, moving_role } = this.words;
    // When all is built, the modules that are in no goal cell are spare.
    if (isBuilt && standing.role !== FILLS) return roles[0].colour;
    const shown = moving && moving_role !== null && standing.role !== FILLS ? moving_role : standing.role;
    return roles[shown]?.colour ?? "none";
  }

  /** Builds what is seen at a time, and returns what the texts about it need. */
  build(t, options) {
    const frame = this.frameAt(t, options);
    for (const { parts } of [...this.layers, ...this.shapes.map(({ chosen }) => chosen), this.foreign, this.ghosts]) parts.clear();
    this.links.clear();
    this.marks.clear();
    this.filled.clear();
    this.hidden.clear();
    this.renderer.shaded = false;
    for (let id = 0; id < this.story.modules.length; id++) this.addModule(id, t, frame);
    if (!frame.back) this.hideEnclosed();
    this.addCells(t, frame);
    contactLines(this.links, this.story.scene.contacts, this.middles, this.colour.soft);
    if (options.messages && frame.talk) this.addTalk(frame.talk, options);
    return this.addWaits(t, frame);
  }

  /** Returns what holds for all modules at a time. */
  frameAt(t, options) {
    const { story } = this;
    const needsTalk = options.messages || TOLD.includes(options.meaning) || options.chosen !== null;
    const talk = needsTalk ? story.talkAt(t) : null;
    const owners = new Map();
    for (let i = 0; i < (talk?.locks.length ?? 0); i += 2) owners.set(talk.locks[i], talk.locks[i + 1]);
    let farthest = 1;
    if (options.meaning === "gradient") talk?.gradient.forEach((d) => d !== FAR && (farthest = Math.max(farthest, d)));
    // If bodies hide what is between them, they are drawn smaller while messages are shown.
    const back = options.messages && this.words.scale_among_messages !== null;
    const { goal, shift, quarters } = story.goalAt(t);
    const { sections = [], only = "all" } = options;
    return {
      options,
      talk,
      owners,
      locking: new Set(owners.values()),
      farthest,
      back,
      size: back ? this.words.scale_among_messages : this.words.scale,
      now: this.goalOf(goal, quarters),
      shift,
      sections,
      only,
      keeps: (cell) => sections.every((section) => section.keeps(cell)),
      taken: new Set(),
      waits: new Map(),
      counts: { alive: 0, dead: 0, paused: 0, moving: 0, unheard: 0, stuck: 0 },
    };
  }

  addModule(id, t, frame) {
    const { counts, waits } = frame;
    const body = this.story.bodyAt(id, t);
    const known = this.of(id, t, frame.talk);
    const { over, outcome, now } = this.story;
    const isBuilt = over && outcome === "built" && t >= now && frame.now.levels.size > 0;
    const role = this.roleName(known, body.doing !== null, isBuilt);
    if (known.life === "dead") counts.dead++;
    else counts.alive++;
    if (known.life === "paused") counts.paused++;
    if (body.doing) counts.moving++;
    if (role === "none") counts.unheard++;
    if (known.stuck) counts.stuck++;
    if (known.life === "alive" && known.standing.waits !== null) waits.set(id, known.standing.waits);
    const { colour } = this;
    let paint = this.paintOf(id, role, known, body, frame);
    if (frame.back) paint = paint.map((c, i) => c + (colour.sky[i] - c) * 0.45);
    let [pattern, edge] = [PATTERN.plain, colour.edge];
    if (known.life === "dead") [pattern, edge] = [PATTERN.dead, colour.mark];
    else if (known.life === "paused") [pattern, edge] = [PATTERN.paused, colour.mark];
    else if (known.stuck) [pattern, edge] = [PATTERN.stuck, colour.stuck];
    this.put(id, body, { paint, pattern, edge }, frame);
  }

  paintOf(id, role, known, body, { options, owners, locking, farthest, now, shift }) {
    const { colour } = this;
    switch (options.meaning) {
      case "level":
        return this.levelColour(known, body, now, shift);
      case "gradient": {
        const far = known.gradient === FAR || known.gradient === null;
        return far ? colour.none : scale(1 - known.gradient / farthest);
      }
      case "locks": {
        const owner = owners.get(id);
        return owner !== undefined ? ownColour(owner) : locking.has(id) ? ownColour(id) : colour.none;
      }
      case "host":
        return ownColour(this.story.scene.hosts.homes[id]);
      default:
        return colour[role];
    }
  }

  /** Adds obstacles and passive elements, and the cells of the goal that nothing is in. */
  addCells(t, { options, now, shift, keeps, sections, taken }) {
    const { colour } = this;
    const held = this.story.elementsAt(t);
    for (const cell of this.story.obstaclesAt(t).filter(keeps)) {
      const body = colour[held.get(String(cell))] ?? colour.foreign;
      this.foreign.parts.part(resting(cell), 0, 0.9, body, PATTERN.plain, colour.edge);
    }
    if (!options.goal) return;
    // Within a structure that is cut, too.
    for (const [x, y, z] of sections.length ? now.cells : now.outside) {
      const at = [x + shift[0], y + shift[1], z];
      if (taken.has(key(at)) || !keeps(at)) continue;
      this.ghosts.parts.part(resting(at), 0, 0.94, colour.ghost, PATTERN.plain, colour.ghost);
    }
  }

  /** Adds who waits for whom, and returns what the texts about the picture need. */
  addWaits(t, { options, talk, owners, waits, counts, farthest }) {
    const { story } = this;
    // Modules that wait for each other during a run mostly go on a moment later. They are stuck only at the
    // end of a run that ended in a deadlock.
    const stalled = t >= story.now && story.over && story.outcome === "deadlock";
    const stall = stalled ? story.report?.unbuilt : null;
    for (const { module, waits_for } of stall?.waiting ?? []) if (waits_for !== null) waits.set(module, waits_for);
    const circle = stalled ? story.circle(waits) : new Set();
    stall?.wait_cycle.forEach((id) => circle.add(id));
    this.drawWaits(waits, circle, options, stalled);
    if (options.meaning === "locks") {
      for (const [holder, owner] of owners) arrow(this.marks, this.middles[holder], this.middles[owner], [...ownColour(owner), 0.9], 0.05);
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

  put(id, body, { paint, pattern, edge }, { options, size, now, shift, sections, only, taken }) {
    const { shapes, tones } = this.story.modules[id];
    const poses = posesAt(body);
    const isOut = only === "goal" && !now.levels.has(cellKey([poses[0] - shift[0], poses[1] - shift[1], poses[2]], 0));
    const middle = [0, 0, 0];
    let shown = 0;
    for (let i = 0, at = 0; i < shapes.length; i++, at += POSE) {
      taken.add(cellKey(poses, at));
      for (let k = 0; k < 3; k++) middle[k] += poses[at + k] / shapes.length;
      if (isOut || !sections.every((section) => section.keepsPart(poses, at))) {
        this.hidden.add(id * MOST_PARTS + i);
        continue;
      }
      shown++;
      const shape = this.shapes[shapes[i]];
      const layer = poses[at + 6] === 1 ? shape.upright : shape.turned;
      const tint = tones[i] === 0 ? paint : paint.map((c) => c + (this.dark ? 0.16 : 0.26) * (1 - c));
      layer.parts.part(poses, at, size, tint, pattern, edge);
      if (id === options.chosen) shape.chosen.parts.part(poses, at, size, tint, PATTERN.plain, edge);
      if (layer.fills && !body.doing) this.filled.add(poses[at], poses[at + 1], poses[at + 2]);
    }
    // Lines end at bodies that are shown.
    this.middles[id] = shown > 0 ? middle : null;
    this.poses[id] = poses;
  }

  addTalk(bin, { classes }) {
    // Smaller bodies leave the links between them visible; other links are drawn over the bodies.
    const back = this.words.scale_among_messages !== null;
    messageLines(back ? this.links : this.marks, {
      edges: bin.edges,
      middles: this.middles,
      shown: classes,
      colours: this.classColours,
      seconds: this.story.width / 1e6,
      homes: this.story.scene.hosts?.homes ?? null,
      lift: back ? 0 : 0.15,
    });
  }

  /** Draws who waits for whom: all of it at a final deadlock, and circles in another colour. */
  drawWaits(waits, circle, options, stalled) {
    for (const [from, to] of waits) {
      const within = circle.has(from) && circle.has(to);
      if (!within && !stalled && !options.waits && from !== options.chosen && to !== options.chosen) continue;
      const rgb = within ? this.colour.bad : this.colour.wait;
      arrow(this.marks, this.middles[from], this.middles[to], [...rgb, within ? 1 : 0.85], within ? 0.09 : stalled ? 0.06 : 0.04);
    }
  }

  draw(viewpoint, clock) {
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
    const group = ({ shape, parts }) => ({ shape, numbers: parts.view() });
    this.renderer.draw({
      viewpoint,
      paper: colour.sky,
      ground,
      groups: [...this.layers, this.foreign].map(group),
      ghosts: { ...group(this.ghosts), colour: [...colour.ghost, this.ghosts.parts.length > 200 * PART ? 0.5 : 0.9] },
      chosen: this.shapes.map(({ chosen }) => group(chosen)),
      outline: colour.chosen,
      links: this.links.view(),
      marks: this.marks.view(),
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
        if (this.hidden.has(id * MOST_PARTS + part)) continue;
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

  legend(meaning, seen) {
    return legend(this.story.scene, this.colour, meaning, seen);
  }
}
