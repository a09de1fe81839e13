// Requests to the studio's server: only if the page was opened with the whole printed address, whose fragment holds the
// secret. The secret stays in memory: after a reload, the address must be opened again.

import { cell } from "./cells.js";

/** @typedef {import("./structure.js").Structure} Structure */

const VERSION = 1;
const random = () => [...crypto.getRandomValues(new Uint8Array(16))].map((b) => b.toString(16).padStart(2, "0")).join("");

export class Server {
  constructor() {
    this.secret = /^#c=([0-9a-f]{32})$/.exec(location.hash)?.[1] ?? null;
    if (this.secret) history.replaceState(null, "", location.pathname);
  }

  /** Sends a request. Refusals are values, too.
   * @param {string} name @param {object} body @returns {Promise<any>} */
  async post(name, body = {}) {
    const headers = { "Content-Type": "application/json", Authorization: `Bearer ${this.secret}` };
    try {
      const response = await fetch(name, { method: "POST", headers, body: JSON.stringify({ version: VERSION, ...body }) });
      return await response.json().catch(() => ({ result: "refused", why: "open the whole address that metamorph has printed" }));
    } catch {
      return { result: "gone", why: "the studio has ended" };
    }
  }
}

/** Keeps the answer about a drawing up to date: sends what has changed since the last revision that was answered, first
 * for its modules, then, when nothing has changed meanwhile, for repairs and splits. Old answers are dropped. */
export class Analyst {
  /** @param {Server} server @param {Structure} structure @param {(answer: any, quick: boolean) => void} onAnswer */
  constructor(server, structure, onAnswer) {
    [this.server, this.structure, this.onAnswer] = [server, structure, onAnswer];
    this.session = random();
    this.revision = 0;
    /** The revision that the server has, and what has changed since: true if the cell is filled now. */
    this.base = null;
    /** @type {Map<number, boolean>} */
    this.since = new Map();
    /** Whether pins have changed since. */
    this.repinned = false;
    this.answered = { revision: 0, all: true };
    this.busy = false;
    structure.addEventListener("change", (event) => {
      const { add, remove, pins } = /** @type {CustomEvent} */ (event).detail;
      this.repinned ||= pins;
      for (const k of remove) this.since.set(k, false);
      for (const k of add) this.since.set(k, true);
      this.revision += 1;
      this.work();
    });
  }

  /** True if an answer about the present drawing is shown. */
  get isAnswered() {
    return this.answered.revision === this.revision;
  }
  /** True if the answer that is shown is complete and of the present drawing. */
  get settled() {
    return !this.busy && this.isAnswered && this.answered.all;
  }

  async work() {
    if (this.busy) return;
    this.busy = true;
    while (this.answered.revision !== this.revision || !this.answered.all) {
      const all = this.answered.revision === this.revision;
      const { revision, since } = this;
      this.since = new Map();
      const changed = (filled) => [...since].filter(([, now]) => now === filled).map(([k]) => cell(k));
      const [add, remove] = this.base === null ? [this.structure.list(), []] : [changed(true), changed(false)];
      const pins = this.base === null || this.repinned ? this.structure.pinList() : null;
      this.repinned = false;
      const answer = await this.server.post("analyse", { session: this.session, revision, base: this.base, add, remove, pins, all });
      if (answer.result === "gone") break;
      if (answer.result === "stale") {
        this.base = null;
        continue;
      }
      this.base = revision;
      if (answer.result === "refused") this.base = null;
      if (revision === this.revision) {
        this.answered = { revision, all: all || answer.result !== "analysed" };
        this.onAnswer(answer, !this.answered.all);
        // The picture comes before repairs, which take longer.
        if (!this.answered.all) await new Promise((done) => requestAnimationFrame(() => setTimeout(done)));
      }
      // Too large a drawing is refused again until it has changed.
      if (answer.result === "refused" && revision === this.revision) break;
    }
    this.busy = false;
  }
}
