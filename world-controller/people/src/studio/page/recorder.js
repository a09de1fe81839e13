// The session log of `--study`: what is chosen, the room after each change, and where the eye is, sent to the server, which
// says what was done. Nothing is kept or sent without that option.

/** Time between two places of the eye, and their number in one request: tenths of a second, once a second. */
const EVERY_MS = 100, TOGETHER = 10;
/** A pause that ends a gesture of the eye, in seconds. */
const PAUSE = 0.5;
/** Number of events that wait to be sent, from which on no place of the eye is kept; and at most. */
const WAITING = 1_200, MOST_WAITING = 2_400;
/** Number of events in a request at most; the server takes no more than 512. */
const AT_ONCE = 512;

/** @typedef {{ t: number, kind: "room" | "chosen" | "look" | "eye", text?: string, pieces?: string[], at?: number[], direction?: number[] }} Waiting */

export class Recorder {
  /** @param {any} page the room's page */
  constructor(page) {
    this.page = page;
    this.on = false;
    /** When the first room was opened, on the clock of the page. @type {number | null} */
    this.begun = null;
    /** When the latest change was made, in seconds since then. */
    this.acted = 0;
    /** The last gesture of the eye. */
    this.looked = -Infinity;
    /** What was noted last. */
    this.text = "";
    this.chosen = "[]";
    /** What waits, in the order of times. @type {Waiting[]} */
    this.waiting = [];
    this.sending = false;
  }

  /** True if all that was done is in the log; places of the eye may wait. */
  get settled() {
    return !this.sending && this.waiting.every(({ kind }) => kind === "eye");
  }

  /** Begins, if the studio records. @param {string | null} file the name of the log */
  begin(file) {
    if (!file) return;
    this.on = true;
    this.say(`● recorded in ${file}`, "recorded: what is chosen, moved and looked at in a room");
    this.timer = setInterval(() => this.sample(), EVERY_MS);
  }
  /** Ends for good. @param {string} why */
  end(why) {
    this.on = false;
    clearInterval(this.timer);
    this.waiting = [];
    this.say(`not recorded: ${why}`, why);
  }
  /** Says on the page whether it is recorded. @param {string} text @param {string} title */
  say(text, title) {
    const shown = document.getElementById("recorded");
    [shown.textContent, shown.title, shown.hidden, shown.dataset.on] = [text, title, false, String(this.on)];
  }

  /** Seconds since the first room was opened. */
  now() {
    return Math.round(performance.now() - (this.begun ?? 0)) / 1000;
  }

  /** A change is made, whose room is not known yet. */
  act() {
    this.acted = this.now();
  }
  /** The room has this text since a time. @param {string} text @param {string[]} chosen @param {number} t */
  arrange(text, chosen, t = this.now()) {
    if (!this.on) return;
    if (text !== this.text) {
      this.text = text;
      this.begun ??= performance.now();
      this.note({ t: Math.min(t, this.now()), kind: "room", text });
    }
    this.choose(chosen);
  }
  /** @param {string[]} pieces */
  choose(pieces) {
    const names = JSON.stringify(pieces);
    if (this.begun === null || names === this.chosen) return;
    this.chosen = names;
    this.note({ t: this.now(), kind: "chosen", pieces: [...pieces] });
  }
  /** The picture is moved or made larger; a gesture is one action. */
  look() {
    if (this.begun === null) return;
    const t = this.now();
    if (t - this.looked > PAUSE) this.note({ t, kind: "look" });
    this.looked = t;
  }
  /** Notes where the eye is while the room is seen. */
  sample() {
    const { page } = this;
    if (this.begun === null || document.hidden || !page.isActive() || !page.room || this.waiting.length >= WAITING) return;
    this.note({ t: this.now(), kind: "eye", ...page.plan.eye() });
  }

  /** @param {Waiting} event */
  note(event) {
    if (!this.on) return;
    if (this.waiting.length >= MOST_WAITING) return this.end("the server is too slow");
    this.waiting.push(event);
    // A room is known later than when it was made so.
    this.waiting.sort((a, b) => a.t - b.t);
    if (event.kind !== "eye" || this.waiting.length >= TOGETHER) this.send();
  }
  /** Sends what waits, unless a change is under way, which belongs before it. */
  async send() {
    if (this.sending) return;
    this.sending = true;
    const { session, server } = this.page;
    while (this.on && this.waiting.length && !this.page.edits.length) {
      const rooms = this.waiting.findIndex(({ kind }) => kind === "room");
      const count = Math.min(rooms < 0 ? this.waiting.length : Math.max(rooms, 1), AT_ONCE);
      const events = this.waiting.splice(0, count).map(({ kind, ...members }) => ({ [kind]: members }));
      const answer = await server.post("study", rooms === 0 ? { session, ...events[0] } : { session, events });
      if (answer.result !== "done") this.end(answer.why);
    }
    this.sending = false;
  }
}
