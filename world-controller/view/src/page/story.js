// The events of a run, and its state at any time. Filled piece by piece from the server; queried by the
// drawing. Times are microseconds. Independent of how things look.

import { UPRIGHT, carried } from "./parts.js";

const AT_ONCE = 8;

/** The bit of a report that says that the module asks the operator. */
const ASKS = 16;
/** The role of a module that fills a target. */
export const FILLS = 2;

/** Returns the index of the last entry of `list` with a `t` up to `t`; -1 if there is none. */
export function before(list, t) {
  let low = 0;
  let high = list.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (list[middle].t <= t) low = middle + 1;
    else high = middle;
  }
  return low - 1;
}

/** The state of a module that has not reported. */
const UNHEARD = { role: null, flags: 0, place: -1, waits: null };

export class Story {
  constructor() {
    this.next = 0;
    this.now = 0;
    this.over = false;
    this.report = null;
    this.outcome = null;
    this.troubles = [];
    this.forgotten = 0;
    this.width = 0;
    this.totals = [];
    this.faults = [];
    this.deaths = [];
    this.obstacles = [];
    this.elements = [];
    this.goalsOpened = [];
    this.motions = [];
    this.moments = [];
    this.momentsSorted = true;
    this.talk = new Map();
    this.asked = new Set();
    this.onTalk = () => {};
    /** @type {(error: Error) => void} */
    this.onLost = () => {};
    this.onAnew = () => {};
  }

  /** True if a plan is shown without a run: its list of faults has the actions. */
  get isPlan() {
    return this.scene.link === "plan";
  }

  async ask(what) {
    const answer = await fetch(what, { cache: "no-store" });
    if (!answer.ok) throw new Error(`${what}: ${answer.status}`);
    return answer.json();
  }

  async begin() {
    /** What is known before the run begins; `beginning.rs` has its layout. */
    this.scene = await this.ask("scene");
    this.modules = this.scene.start.map((body) => this.begun(body));
    while (await this.follow());
  }

  begun([at, ...parts]) {
    const poses = parts.flatMap(([, , ...pose]) => (pose.length === 3 ? [...pose, ...UPRIGHT] : pose));
    const first = { at, poses };
    const [shapes, tones] = [0, 1].map((i) => parts.map((part) => part[i]));
    return { shapes, tones, first, stance: first, doings: [], standings: [], lives: [], stuck: [] };
  }

  /** Loads a replaced scene of the run. The known part stays visible until all of it is loaded. */
  async beginAgain() {
    const fresh = new Story();
    await fresh.begin();
    const { onTalk, onLost, onAnew } = this;
    Object.assign(this, fresh, { onTalk, onLost, onAnew });
    this.onAnew();
  }

  /** Takes the events since the last call. Returns true if more are available at once. */
  async follow() {
    const last = Math.max(this.totals.length - 1, 0);
    const more = await this.ask(`events?from=${this.next}&bin=${last}&width=${this.width}`);
    if (this.telling !== undefined && this.telling !== more.telling) {
      await this.beginAgain();
      return false;
    }
    this.telling = more.telling;
    for (const event of more.events) this.take(event);
    if (more.width !== this.width || more.first === 0) {
      this.talk.clear();
      this.asked.clear();
    }
    this.totals.length = Math.min(this.totals.length, more.first);
    this.totals.push(...more.totals);
    this.next = more.next;
    this.now = Math.max(more.now, 1);
    this.width = more.width;
    this.forgotten = more.forgotten;
    this.report = more.report;
    this.outcome = more.outcome;
    this.troubles = more.troubles;
    this.over = more.over && !more.more;
    return more.more;
  }

  take(event) {
    const [kind, t, who] = event;
    const module = this.modules[who];
    const moment = (time) => {
      this.moments.push(time);
      this.momentsSorted = false;
    };
    switch (kind) {
      case "d": {
        const [takes, name, segments] = event[2];
        this.motions.push({ takes, name, segments });
        break;
      }
      case "m": {
        const [, , , number, at] = event;
        const motion = this.motions[number];
        const from = module.stance;
        const until = t + motion.takes;
        module.stance = { at, poses: carried(from.poses, motion.segments, 1) };
        module.doings.push({ t, until, from, to: module.stance, motion, failed: false, why: "" });
        moment(t);
        moment(until);
        break;
      }
      case "f": {
        const last = module.doings[module.doings.length - 1];
        if (last) {
          last.failed = true;
          last.why = event[3];
          module.stance = last.from;
        }
        break;
      }
      case "r": {
        // Refused, so it has not begun.
        const last = module.doings.pop();
        if (last) module.stance = last.from;
        break;
      }
      case "s": {
        const [, , , role, flags, place, waits] = event;
        module.standings.push({ t, role, flags, place, waits });
        break;
      }
      case "l": {
        module.lives.push({ t, life: event[3] });
        if (event[3] === "dead" || event[3] === "restarted") this.deaths.push({ t, who, life: event[3] });
        moment(t);
        break;
      }
      case "x": {
        const [, , , what, effect] = event;
        this.faults.push({ t, who, what, effect });
        if (module && /^(un)?stick /.test(what)) module.stuck.push({ t, stuck: what.startsWith("stick") });
        moment(t);
        break;
      }
      case "o":
        this.obstacles.push({ t, cells: event[2] });
        break;
      case "e":
        this.elements.push({ t, all: event[2] });
        break;
      case "g":
        this.goalsOpened.push({ t, goal: event[2], shift: event[3], quarters: event[4] });
        break;
    }
  }

  /** Returns the next time at which something begins or ends, or the previous one. */
  moment(t, forward) {
    if (!this.momentsSorted) {
      this.moments = [...new Set(this.moments)].sort((a, b) => a - b);
      this.momentsSorted = true;
    }
    let low = 0;
    let high = this.moments.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (forward ? this.moments[middle] <= t : this.moments[middle] < t) low = middle + 1;
      else high = middle;
    }
    if (forward) return Math.min(this.moments[low] ?? this.now, this.now);
    return low > 0 ? this.moments[low - 1] : 0;
  }

  /** Returns the action of a body, or its rest: `from`, `to` and the share between, 0..1. */
  bodyAt(id, t) {
    const module = this.modules[id];
    const i = before(module.doings, t);
    if (i < 0) return { from: module.first, to: module.first, part: 0, doing: null };
    const doing = module.doings[i];
    const { from, to, motion } = doing;
    const part = Math.min((t - doing.t) / Math.max(doing.until - doing.t, 1), 1);
    if (doing.failed) {
      // There and back, to show the attempt and its failure.
      const swing = part < 1 ? 0.5 * Math.sin(Math.PI * part) : 0;
      return { from, to, part: swing, doing: part < 1 ? doing : null, motion };
    }
    return { from, to, part, doing: part < 1 ? doing : null, motion };
  }

  /** Returns the last moves of a module that have begun, the latest first. */
  movesOf(id, t, most) {
    const { doings } = this.modules[id];
    const end = before(doings, t) + 1;
    return doings.slice(Math.max(0, end - most), end).reverse().map((doing) => ({ doing, who: id }));
  }

  /** Returns moves that are under way, at most so many. */
  underWay(t, most) {
    const found = [];
    for (let who = 0; who < this.modules.length && found.length < most; who++) {
      const { doing } = this.bodyAt(who, t);
      if (doing) found.push({ doing, who });
    }
    return found;
  }

  /** Returns the last report of a module; its role is null before the first one. */
  standingAt(id, t) {
    const list = this.modules[id].standings;
    const i = before(list, t);
    // Reports from before a restart do not count.
    const lives = this.modules[id].lives;
    let k = before(lives, t);
    while (k >= 0 && lives[k].life !== "restarted") k--;
    return i < 0 || (k >= 0 && lives[k].t > list[i].t) ? UNHEARD : list[i];
  }

  /** Returns the modules that ask the operator, the first one first, each with the time left for an answer. */
  requestsAt(t) {
    const within = this.scene.answer_within;
    if (!within) return [];
    const asking = [];
    for (let id = 0; id < this.modules.length; id++) {
      if (!(this.standingAt(id, t).flags & ASKS) || this.lifeAt(id, t) === "dead") continue;
      const { standings } = this.modules[id];
      let first = before(standings, t);
      while (first > 0 && standings[first - 1].flags & ASKS) first--;
      asking.push({ id, since: standings[first].t, left: Math.max(0, standings[first].t + within - t) });
    }
    return asking.sort((a, b) => a.since - b.since || a.id - b.id);
  }

  /** Returns "alive", "dead" or "paused". */
  lifeAt(id, t) {
    const list = this.modules[id].lives;
    const i = before(list, t);
    if (i < 0) return "alive";
    return { dead: "dead", paused: "paused" }[list[i].life] ?? "alive";
  }

  stuckAt(id, t) {
    const list = this.modules[id].stuck;
    const i = before(list, t);
    return i >= 0 && list[i].stuck;
  }

  goalAt(t) {
    const i = before(this.goalsOpened, t);
    return i < 0 ? { goal: 0, shift: [0, 0], quarters: 0 } : this.goalsOpened[i];
  }

  /** Returns how each cell of a passive element is held, by the name of the cell. */
  elementsAt(t) {
    const i = before(this.elements, t);
    const all = i < 0 ? [] : this.elements[i].all;
    return new Map(all.flatMap(([hold, cells]) => cells.map((cell) => [String(cell), hold])));
  }

  obstaclesAt(t) {
    const i = before(this.obstacles, t);
    return i < 0 ? [] : this.obstacles[i].cells;
  }

  binAt(t) {
    return Math.max(Math.min(Math.floor(t / this.width), this.totals.length - 1), 0);
  }

  /**
   * Returns the number of filled targets at a time, and the size of the goal; null if nothing is known. Where the goal is no shape
   * it is known from the report.
   */
  progressAt(t) {
    const [, , filled, goal] = this.totals[this.binAt(t)] ?? [[], 0, 0, 0];
    if (goal) return { filled, goal };
    if (!this.report || t < this.now) return null;
    return { filled: this.report.goal.filled, goal: this.report.goal.cells };
  }

  messagesPerSecond(t) {
    const [counts] = this.totals[this.binAt(t)] ?? [[]];
    return Math.round(counts.reduce((a, b) => a + b, 0) / (this.width / 1e6));
  }

  /** Returns the messages between modules at a time; null until they are loaded, which calls `onTalk`. */
  talkAt(t) {
    const bin = this.binAt(t);
    const chunk = Math.floor(bin / AT_ONCE);
    this.fetchTalk(chunk);
    if (bin % AT_ONCE > AT_ONCE / 2) this.fetchTalk(chunk + 1);
    return this.talk.get(chunk)?.[bin % AT_ONCE] ?? null;
  }

  async fetchTalk(chunk) {
    const first = chunk * AT_ONCE;
    if (this.asked.has(chunk) || first >= this.totals.length) return;
    this.asked.add(chunk);
    const { width, telling } = this;
    const last = this.totals.length;
    try {
      const { width: theirs, bins } = await this.ask(`talk?first=${first}&count=${AT_ONCE}`);
      if (theirs !== width || width !== this.width || telling !== this.telling) return;
      this.talk.set(chunk, bins);
      // Time bins still in progress are requested again.
      if (!this.over && first + AT_ONCE >= last) setTimeout(() => this.asked.delete(chunk), 500);
      if (this.talk.size > 64) this.forgetTalk(chunk);
      this.onTalk();
    } catch (error) {
      this.asked.delete(chunk);
      this.onLost(error);
    }
  }

  forgetTalk(near) {
    const far = [...this.talk.keys()].sort((a, b) => Math.abs(b - near) - Math.abs(a - near))[0];
    this.talk.delete(far);
    this.asked.delete(far);
  }

  messagesOf(id, t) {
    return this.ask(`messages?id=${id}&at=${Math.floor(t)}`).then((answer) => answer.messages);
  }

  /** Returns the modules that wait for each other in a circle. */
  circle(waits) {
    const seen = new Map();
    const inCircle = new Set();
    for (const start of waits.keys()) {
      const path = [];
      let at = start;
      while (at !== undefined && !seen.has(at)) {
        seen.set(at, start);
        path.push(at);
        at = waits.get(at);
      }
      if (at !== undefined && seen.get(at) === start && path.includes(at)) {
        path.slice(path.indexOf(at)).forEach((id) => inCircle.add(id));
      }
    }
    return inCircle;
  }
}
