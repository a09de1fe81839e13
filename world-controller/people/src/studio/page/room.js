// Rooms: the text of a room file, changed by the server alone, and the state of the page about it. What pieces stand on
// and which constraints are violated comes with each answer; nothing of that is computed here.

import { make } from "./panel.js";
import { miniature, Plan, turnedPlace } from "./plan.js";
import { Recent } from "./recent.js";
import { Recorder } from "./recorder.js";
import { RoomPanel } from "./room-panel.js";

const $ = (id) => document.getElementById(id);
const COLOURS = ["red", "yellow", "green", "blue", "violet"];
/** Number of recent rooms, and characters of the largest one that is kept. */
const RECENT = 6, KEPT = 100_000;
const NOTHING = { pieces: [], violation: null };
const random = () => [...crypto.getRandomValues(new Uint8Array(16))].map((b) => b.toString(16).padStart(2, "0")).join("");

export class Room {
  /** @param {any} studio the page that this is a part of */
  constructor(studio) {
    [this.studio, this.server] = [studio, studio.server];
    this.session = random();
    this.name = "room";
    this.recent = new Recent("rooms", RECENT, $("room-recent"), (room) => room.name, (room) => this.open(room));
    /** The text of the file, as the server gave it; and those before and after it. */
    this.text = "";
    /** @type {string[]} */
    this.past = [];
    /** @type {string[]} */
    this.future = [];
    /** What the server says of the text, with pieces where the changes under way put them. @type {any} */
    this.room = null;
    /** Names of the chosen pieces. @type {string[]} */
    this.chosen = [];
    /** What would put the room right. @type {{ moves: { piece: any, place: any }[], total: number, least: string } | null} */
    this.proposal = null;
    /** What a constraint that is pointed at is about. */
    this.marked = NOTHING;
    /** Changes that the server has not made yet. @type {any[]} */
    this.edits = [];
    /** Where the pieces of a drag would stand. @type {any[] | null} */
    this.trial = null;
    /** What is asked next: `put-right`, or `{ snap: name }`. @type {any} */
    this.question = null;
    /** A step back that waits for changes under way. @type {(() => void) | null} */
    this.later = null;
    this.revision = 0;
    /** The revision of the last answer, and whether it is about everything. */
    this.answered = { revision: -1, all: false };
    this.busy = false;
    /** Whether an undone step is the next answer. */
    this.silent = false;
    this.recorder = new Recorder(this);
    this.plan = new Plan(/** @type {any} */ ($("plan")), this);
    this.panel = new RoomPanel(this);
  }

  /** True if everything that was asked is answered. */
  get settled() {
    return !this.busy && this.answered.revision === this.revision && this.answered.all && !this.question;
  }
  get isOpen() {
    return !$("room").hidden;
  }
  isActive() {
    return this.isOpen && $("run").hidden && $("welcome").hidden;
  }

  /** Opens a room. @param {{ name: string, text: string }} opened */
  open({ name, text }) {
    [this.name, this.text, this.past, this.future] = [name, text, [], []];
    [this.edits, this.trial, this.question, this.chosen] = [[], null, null, []];
    this.room = null;
    $("name").value = name;
    this.studio.showMode("room");
    this.plan.reset();
    this.ask();
  }

  // Changes.

  /** Makes changes, as one step. @param {any[]} edits @param {any} question */
  change(edits, question = null) {
    if (!this.room) return;
    this.studio.note("");
    this.proposal = null;
    this.trial = null;
    this.edits.push(...edits);
    this.recorder.act();
    for (const { place } of edits) if (place) Object.assign(this.piece(place.piece) ?? {}, { at: place.at, turn: place.turn });
    if (question) this.question = question;
    this.ask();
  }
  ask() {
    this.revision += 1;
    this.panel.pending();
    this.plan.draw();
    this.work();
  }
  piece(name) {
    return this.room?.pieces.find((piece) => piece.name === name);
  }
  pieces() {
    return this.chosen.map((name) => this.piece(name)).filter(Boolean);
  }
  undo() {
    this.step(this.past, this.future);
  }
  redo() {
    this.step(this.future, this.past);
  }
  step(from, to) {
    // Changes under way are made first; then there is a text to go back to.
    if (this.edits.length) return (this.later = () => this.step(from, to));
    if (!from.length) return;
    to.push(this.text);
    this.text = from.pop() ?? this.text;
    this.recorder.arrange(this.text, this.chosen);
    this.proposal = null;
    this.question = null;
    this.ask();
  }

  /** Asks the server until the answer is about everything that is wanted. */
  async work() {
    if (this.busy) return;
    this.busy = true;
    while (!(this.answered.revision === this.revision && this.answered.all && !this.question)) {
      const { revision, question, trial, text } = this;
      const { acted } = this.recorder;
      const edits = [...this.edits];
      const again = this.answered.revision === revision;
      const needed = edits.length || !again;
      const ask = needed || trial ? (question?.snap && edits.length ? question : "check") : (question ?? "reach");
      const answer = await this.server.post("room", { session: this.session, revision, room: text, edits: [...edits, ...(trial ?? [])], ask });
      // The answer is about a room that is no longer the one, after a step back or when another room was opened.
      if (answer.result === "stale" || (text !== this.text && answer.result !== "gone")) continue;
      if (answer.result !== "checked") {
        this.refused(answer, edits, trial);
        if (answer.result === "gone") break;
        continue;
      }
      if (!trial) this.take(answer, edits);
      if (ask === question) this.question = null;
      if (revision === this.revision) {
        this.answered = { revision, all: trial !== null || ask === "reach" };
        this.show(answer, ask);
      }
      // A new piece is where it belongs only after its next change.
      if (!trial && !this.silent) this.recorder.arrange(this.text, this.chosen, edits.length ? acted : undefined);
    }
    this.busy = false;
    this.panel.settled();
    const { later } = this;
    this.later = null;
    later?.();
  }
  /** Keeps the changed text. */
  take(answer, edits) {
    this.edits = this.edits.slice(edits.length);
    if (answer.room === this.text) return;
    if (edits.length && !this.silent) {
      this.past.push(this.text);
      this.future = [];
    }
    this.silent = false;
    this.text = answer.room;
  }
  refused(answer, edits, trial) {
    this.studio.note(answer.why);
    this.edits = this.edits.slice(edits.length);
    this.question = null;
    if (trial) this.trial = null;
    if (this.room && (edits.length || trial)) {
      // Pieces go back to where the server has them.
      this.revision += 1;
      return;
    }
    this.answered = { revision: this.revision, all: true };
  }
  show(answer, ask) {
    const before = this.room;
    this.room = answer;
    this.chosen = this.chosen.filter((name) => this.piece(name));
    this.marked = NOTHING;
    if (ask === "put-right") this.propose(answer);
    else if (ask.snap) this.snapped(ask.snap, answer);
    if (String(before?.size) !== String(answer.size)) this.plan.reset();
    this.plan.draw();
    this.panel.show(answer);
  }

  // Help of the server.

  propose({ put_right: mended, ended, pieces }) {
    if (!mended) return this.studio.note(ended ? "the time was over before an arrangement was found; move a piece, or give a constraint up" : "there is no arrangement that violates nothing; give a constraint up");
    const moves = pieces.map((piece, i) => ({ piece, place: mended.placements[i] })).filter(({ piece, place }) => String(piece.at) !== String(place.at) || piece.turn !== place.turn);
    if (!moves.length) return this.studio.note("nothing has to be moved");
    this.proposal = { moves, total: mended.total, least: mended.least };
  }
  putRight() {
    if (!this.room || this.question) return;
    this.studio.note("");
    this.proposal = null;
    this.question = "put-right";
    this.ask();
  }
  /** Takes the proposal. */
  accept() {
    if (this.proposal) this.change(this.proposal.moves.map(({ piece, place }) => ({ place: { piece: piece.name, ...place } })));
  }
  discard() {
    this.proposal = null;
    this.plan.draw();
    this.panel.show(this.room);
  }
  /** Moves the chosen piece to the nearest place at which it violates nothing. */
  snap() {
    const [piece] = this.chosen;
    if (!piece || this.question) return;
    this.question = { snap: piece };
    this.ask();
  }
  snapped(name, { snap, ended }) {
    const piece = this.piece(name);
    if (!snap) return this.studio.note(ended ? `the time was over before a place for ${name} was found` : `there is no place at which ${name} violates nothing`);
    if (!piece || (String(snap.at) === String(piece.at) && snap.turn === piece.turn)) return;
    Object.assign(piece, snap);
    this.edits.push({ place: { piece: name, ...snap } });
    // A new piece and its place are one step.
    this.silent = this.added === name;
    this.added = null;
    this.revision += 1;
  }

  // What a person does to pieces.

  choose(names) {
    this.chosen = names;
    this.recorder.choose(names);
    this.plan.draw();
    this.panel.choice();
  }
  mark(marked) {
    this.marked = marked ?? NOTHING;
    this.plan.draw();
  }
  moved(by) {
    return this.pieces().map((piece) => ({ place: { piece: piece.name, at: piece.at.map((v, i) => v + by[i]), turn: piece.turn } }));
  }
  /** Shows and checks where the chosen pieces would stand; null if they are put back. @param {[number, number] | null} by */
  dragged(by) {
    this.base ??= this.pieces().map((piece) => [piece.name, [...piece.at]]);
    for (const [name, at] of this.base) Object.assign(this.piece(name) ?? {}, { at: at.map((v, i) => v + (by?.[i] ?? 0)) });
    this.trial = by ? this.moved([0, 0]) : null;
    if (!by) this.base = null;
    this.proposal = null;
    this.ask();
  }
  dropped() {
    const edits = this.moved([0, 0]);
    this.base = null;
    this.change(edits);
  }
  move(by) {
    if (this.chosen.length) this.change(this.moved(by));
  }
  turn(by) {
    if (this.chosen.length) this.change(this.pieces().map((piece) => ({ place: { piece: piece.name, ...turnedPlace(this.room, piece, by) } })));
  }
  colour(colour = null) {
    const next = (piece) => colour ?? COLOURS[(COLOURS.indexOf(piece.colour) + 1) % COLOURS.length];
    if (this.chosen.length) this.change(this.pieces().map((piece) => ({ colour: { piece: piece.name, colour: next(piece) } })));
  }
  remove() {
    const gone = this.chosen;
    this.chosen = [];
    if (gone.length) this.change(gone.map((piece) => ({ remove: { piece } })));
  }
  rename(name) {
    const [piece] = this.chosen;
    if (!piece || !name || name === piece) return;
    this.chosen = [name];
    this.change([{ rename: { piece, name } }]);
  }
  /** Chooses the next piece, or the one before; or one more. */
  next(by, more = false) {
    const names = this.room?.pieces.map((piece) => piece.name) ?? [];
    if (!names.length) return;
    const i = names.indexOf(this.chosen[this.chosen.length - 1]);
    const name = names[(Math.max(i, by > 0 ? -1 : 0) + by + names.length) % names.length];
    this.choose(more ? [...this.chosen.filter((other) => other !== name), name] : [name]);
    this.plan.focus(name);
  }
  /** Puts a new piece into the middle of what is seen, or the nearest place at which it violates nothing. */
  add(what) {
    const stem = what.shape ?? (what.file ? what.file.replace(/\.toml$/, "") : "piece");
    const taken = new Set(this.room?.pieces.map((piece) => piece.name));
    let number = 1;
    while (taken.has(`${stem} ${number}`)) number += 1;
    const name = `${stem} ${number}`;
    const { x, y, width, height } = this.plan.window ?? this.plan.whole();
    const inside = (v, i) => Math.min(Math.max(Math.round(v), 0), this.room.size[i] - 1);
    const at = [inside(x + width / 2 - 2, 0), inside(this.room.size[1] - (y + height / 2) - 2, 1)];
    this.chosen = [name];
    this.added = name;
    this.change([{ add: { name, at, ...what } }], { snap: name });
  }
  escape() {
    if (this.plan.drag) return this.plan.cancel();
    if (this.proposal) return this.discard();
    this.choose([]);
  }

  // Files and runs.

  fileName() {
    return this.name.replace(/[^A-Za-z0-9_-]+/g, "-").replace(/^-+/, "") || "room";
  }
  async save(replace = false) {
    const name = `${this.fileName()}.toml`;
    this.remember();
    const { studio } = this;
    if (!studio.hasDirectory) return studio.download(name, this.text);
    const answer = await this.server.post("save", { name, room: this.text, replace });
    if (answer.result === "done") studio.directory(answer.directory);
    else if (!replace && /already/.test(answer.why) && confirm(`${name} is there already. Replace it?`)) return this.save(true);
    else return studio.note(answer.why);
    $("room-hint").textContent = `${name} is saved`;
  }
  request() {
    return { name: this.fileName(), room: this.text, kind: $("room-kind").value, link: $("room-link").value };
  }
  async downloadScenario() {
    const answer = await this.server.post("start", { ...this.request(), only_scenario: true });
    if (answer.result === "done") this.studio.download(`${this.fileName()}-scenario.toml`, answer.scenario);
    else this.studio.note(answer.why);
  }
  async start() {
    if ($("room-start").disabled || !this.settled) return;
    $("room-start").disabled = true;
    this.remember();
    $("room-hint").textContent = "looking for an order of building …";
    const answer = await this.server.post("start", this.request());
    $("room-hint").textContent = "";
    if (answer.result === "done") return this.studio.showRun({ run: answer.run });
    this.studio.note(answer.why);
    this.panel.settled();
  }
  remember() {
    if (!this.text || this.text.length > KEPT) return;
    this.recent.add({ name: this.name, text: this.text });
  }

  /** The cards of the first page. @param {any[]} examples */
  cards(examples) {
    const card = ({ name, about, text, described }) => make("button", { type: "button", className: "card room-card", onclick: () => this.open({ name, text }) }, miniature(described), make("strong", {}, name), make("span", {}, about));
    $("room-cards").replaceChildren(...examples.map(card));
  }
}

