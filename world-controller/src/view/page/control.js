// Commands to the run: only if the page was opened with the second address, whose fragment holds the secret for it. The
// secret stays in memory: after a reload, the address must be opened again.

import { by, make } from "./dom.js";

const VERSION = 1;
const VERBS = [
  ["kill", "the process ends; the body stays"],
  ["restart", "the process starts again without its memory"],
  ["pause", "the process stands still"],
  ["resume", "the process goes on"],
  ["stick", "the joint sticks: moves fail"],
  ["unstick", "the joint is free again"],
];

const random = () => [...crypto.getRandomValues(new Uint8Array(16))].map((b) => b.toString(16).padStart(2, "0")).join("");

export class Control {
  /** Returns the control of the run, or null if the address has no secret. */
  static fromAddress() {
    const secret = /^#c=([0-9a-f]{32})$/.exec(location.hash)?.[1];
    if (!secret) return null;
    history.replaceState(null, "", location.pathname);
    return new Control(secret);
  }

  constructor(secret) {
    this.secret = secret;
    this.session = random();
    this.n = 0;
    this.waiting = Promise.resolve();
    /** Called after each answer, with a text for the user. */
    this.onAnswer = (_text) => {};
  }

  /** Makes the buttons; `chosen` returns the module that they are for. */
  show(place, chosen) {
    const button = ([verb, title]) =>
      make("button", { type: "button", title, "data-command": verb, onclick: () => this.give(`${verb} ${chosen()}`) }, verb);
    place.replaceChildren(make("h3", {}, "commands"), make("div", { class: "commands" }, ...VERBS.map(button)), make("p", { id: "answer", role: "status" }));
    place.hidden = false;
    this.onAnswer = (text) => (by("answer").textContent = text);
  }

  /** Gives a command. Commands are sent one after the other. */
  give(command, takeOver = false) {
    this.onAnswer(`${command}: pending`);
    this.waiting = this.waiting.then(() => this.send(command, takeOver)).catch((error) => this.onAnswer(`${command}: ${error.message}`));
    return this.waiting;
  }

  async send(command, takeOver) {
    const n = this.n + 1;
    const body = JSON.stringify({ version: VERSION, session: this.session, n, take_over: takeOver, commands: [command] });
    const headers = { "Content-Type": "application/json", Authorization: `Bearer ${this.secret}` };
    for (;;) {
      const response = await fetch("command", { method: "POST", headers, body });
      const answer = await response.json().catch(() => ({ why: "the page is not allowed to command this run" }));
      // A refused request has no number, except for those that the run itself has refused.
      if (answer.n) this.n = answer.n;
      if (response.status === 202) continue;
      if (response.status === 423 && confirm(`${answer.why}. Take over?`)) return this.send(command, true);
      const how = answer.result === "taken" ? `taken, at ${answer.at_s.toFixed(2)} s` : answer.why;
      return this.onAnswer(`${command}: ${how}`);
    }
  }
}
