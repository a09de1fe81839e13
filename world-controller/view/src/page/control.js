// Commands to the run: only if the page was opened with the second address, whose fragment holds the secret for it. The
// secret stays in memory: after a reload, the address must be opened again.

import { by, make } from "./dom.js";

const VERSION = 1;

/**
 * The parameters of commands: the fields to fill, each with its label, its first value and its unit, and the text that they make.
 * @type {Record<string, { fields: [string, number, string?][], text: (...values: string[]) => string }>}
 */
const PARAMETERS = {
  cell: { fields: [["x", 0], ["y", 0], ["z", 0]], text: (x, y, z) => `[${x}, ${y}, ${z}]` },
  shift: { fields: [["x", 1], ["y", 0]], text: (x, y) => `[${x}, ${y}]` },
  number: { fields: [["number", 0]], text: (number) => number },
  percent: { fields: [["", 20, "%"]], text: (percent) => `${percent}%` },
  modules: { fields: [["modules", 0], ["to", 0]], text: (first, last) => `${first}..${last}` },
  lease: { fields: [["for", 60, "s"]], text: (seconds) => `for ${seconds}s` },
};
/** The longest time that a command holds, in seconds. */
const LONGEST_LEASE = 600;

/** Returns the fields of a parameter, and what reads its text from them. */
function parameter(kind, verb) {
  if (kind.words) {
    const select = make("select", { "aria-label": `${verb}: value` }, ...kind.words.map((word) => make("option", {}, word)));
    return { fields: [select], text: () => select.value };
  }
  const { fields, text } = PARAMETERS[kind];
  const bounds = { cell: {}, shift: {}, lease: { min: 1, max: LONGEST_LEASE }, percent: { min: 0, max: 100 } }[kind] ?? { min: 0 };
  /** @param {[string, number, string?]} field */
  const called = ([name, , unit]) => `${verb}: ${[name, unit && `in ${unit}`].filter(Boolean).join(" ")}`;
  const inputs = fields.map((field) => make("input", { type: "number", step: 1, required: true, value: field[1], "aria-label": called(field), ...bounds }));
  return { fields: fields.map(([name, , unit], i) => make("label", {}, name, inputs[i], unit ?? "")), text: () => text(...inputs.map((input) => input.value)) };
}

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
    /** Called after a command was taken. */
    this.onTaken = () => {};
  }

  /**
   * Makes the buttons: those to one module, which `chosen` returns, and those to the run.
   * Those that the level of autonomy refuses cannot be pressed, and the reason is below them.
   * @param {{ verb: string, of_module: boolean, parameters: any[], about: string, refused: string | null }[]} commands
   * @param {() => number | null} chosen
   */
  show(commands, chosen) {
    const button = ({ verb, of_module, parameters, about, refused }) => {
      const all = parameters.map((kind) => parameter(kind, verb));
      const give = (event) => {
        event.preventDefault();
        this.give([verb, ...(of_module ? [chosen()] : []), ...all.map((one) => one.text())].join(" "));
      };
      const press = make("button", { type: "submit", title: refused ?? about, "data-command": verb }, verb);
      if (refused) for (const name of ["disabled", "data-refused"]) press.toggleAttribute(name, true);
      return make("form", { class: "command", onsubmit: give }, press, ...all.flatMap((one) => one.fields));
    };
    for (const [place, title, of_module] of /** @type {[string, string, boolean][]} */ ([["commands", "commands", true], ["run-commands", "commands to the run", false]])) {
      const own = commands.filter((command) => command.of_module === of_module).map(button);
      const refused = commands.filter((command) => command.of_module === of_module && command.refused);
      const why = [...new Set(refused.map((command) => command.refused))].map((reason) => make("p", { class: "soft refused" }, `${refused.filter((command) => command.refused === reason).map((command) => command.verb).join(", ")}: ${reason}`));
      by(place).replaceChildren(make(of_module ? "h3" : "h2", {}, title), make("div", { class: "commands" }, ...own), ...why);
      by(place).hidden = !own.length;
    }
    by("answer").hidden = false;
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
      if (answer.result === "taken") this.onTaken();
      const how = answer.result === "taken" ? `taken, at ${answer.at_s.toFixed(2)} s` : answer.why;
      return this.onAnswer(`${command}: ${how}`);
    }
  }
}
