// The panel beside the picture: outcome of the run, legend, the chosen module with its last messages, faults.
// Everything that comes from a run is inserted as text, never as HTML.

import { by, make } from "./dom.js";

/** Number of moves shown. */
const MOVES = 6;
/** Number of modules shown of those that wait at the end. */
const SHOWN = 6;

/**
 * What the bits of a module's report mean.
 * @type {[number, string][]}
 */
const FLAGS = [
  [4, "held by a dead one"],
  [2, "cannot move any more"],
  [8, "knows a way to a target"],
];

const number = (n) => n.toLocaleString("en");
const seconds = (t) => `${(t / 1e6).toFixed(2)} s`;
const failing = ({ failed, why }) => (failed ? `, which fails${why && `: ${why}`}` : "");

export class Panel {
  constructor(story, picture) {
    this.story = story;
    this.picture = picture;
    /** @type {(name: string) => any} */
    this.part = (name) => document.querySelector(`[data-part="${name}"]`);
    /** @type {(id: number) => void} */
    this.onChoose = () => {};
    /** @type {(t: number) => void} */
    this.onSeek = () => {};
    /** Answers a request: its module goes on by itself. Null if the page commands nothing.
     * @type {((id: number) => void) | null} */
    this.onRelease = null;
    this.requestsText = "";
    this.asked = null;
    this.legendText = "";
    this.faultCount = -1;
    this.outcomeText = "";
    this.movesText = null;
  }

  /** Makes all texts be written again. */
  forget() {
    this.requestsText = "";
    this.asked = null;
    this.faultCount = -1;
    this.outcomeText = "";
    this.movesText = null;
  }

  /** Shows the outcome of the run, or its progress. */
  outcome() {
    const { story } = this;
    const report = story.report;
    const text = story.outcome ?? (story.over ? "not over" : "running");
    for (const button of document.querySelectorAll("[data-command]:not([data-refused])")) button.toggleAttribute("disabled", story.over);
    const reason = report?.reason ?? "";
    const key = [text, reason, ...story.troubles].join();
    if (this.outcomeText === key) return;
    this.outcomeText = key;
    const badge = by("outcome");
    badge.textContent = text;
    badge.dataset.outcome = text;
    const why = this.part("why");
    why.replaceChildren(...story.troubles.map((trouble) => make("p", { class: "reason" }, trouble)));
    if (!report) return;
    const standstills = report.standstills?.count ? report.standstills : null;
    // Of a built run, only the help that it had is worth a word.
    if (report.outcome !== "built" || standstills || report.move_details.led) why.append(make("p", { class: "reason" }, reason));
    if (standstills) why.append(this.standstills(standstills));
    if (report.outcome === "built") return;
    const stall = report.unbuilt;
    if (!stall) return;
    if (stall.prospect) why.append(make("p", {}, stall.prospect));
    if (stall.wait_cycle.length) {
      const names = stall.wait_cycle.flatMap((id, i) => [i ? ", " : "", this.link(id)]);
      why.append(make("p", { class: "circle" }, "wait for each other in a circle: ", ...names));
    }
    if (stall.detected) {
      why.append(make("p", {}, this.link(stall.detected.by), ` counted all others and found this out at ${stall.detected.at_s.toFixed(2)} s`));
    }
    const on = (w) => (w.waits_for === null ? [] : [": ", this.link(w.waits_for)]);
    const row = (w) => make("li", {}, this.link(w.module), ` ${w.why}`, ...on(w));
    if (stall.waiting.length) why.append(make("ul", { class: "waiting" }, ...stall.waiting.slice(0, SHOWN).map(row)));
    if (stall.waiting.length > SHOWN) why.append(make("p", {}, `and ${stall.waiting.length - SHOWN} more; the report has them`));
    if (story.forgotten) why.append(make("p", {}, `${story.forgotten} events were too many to be kept`));
  }

  /** Lists the standstills in the course of the run, and what ended them. */
  standstills({ events, count }) {
    const end = (e) => (e.until_s === null ? "until the end" : `until ${e.until_s.toFixed(1)} s, ended by ${e.ended_by}`);
    const help = (e) => [[e.called, "called"], [e.led, "led"]].filter(([n]) => n).map(([n, how]) => `, ${number(n)} ${how}`).join("");
    const row = (e) => make("li", { title: e.text }, `${e.since_s.toFixed(1)} s ${end(e)}${help(e)}`);
    const more = count > SHOWN ? [make("li", {}, `and ${number(count - SHOWN)} more; the report has them`)] : [];
    const list = make("ul", { class: "standstills" }, ...events.slice(0, SHOWN).map(row), ...more);
    return make("details", {}, make("summary", {}, count === 1 ? "1 standstill" : `${number(count)} standstills`), list);
  }

  link(id) {
    return make("button", { class: "link", type: "button", onclick: () => this.onChoose(id) }, `${id}`);
  }

  numbers(t, { counts }) {
    const progress = this.story.progressAt(t);
    const { omitted } = this.story.scene.goals[this.story.goalAt(t).goal] ?? { omitted: 0 };
    const facts = [
      [`${this.story.scene.words.targets} filled`, progress ? `${number(progress.filled)} / ${number(progress.goal)}` : "–"],
      ...(omitted && progress ? [["of the shape", `${number(progress.goal)} / ${number(progress.goal + omitted)}`]] : []),
      ["alive", `${number(counts.alive)} / ${number(this.story.modules.length)}`],
      ["moving", number(counts.moving)],
      ["dead", number(counts.dead)],
      ["paused", number(counts.paused)],
      ["messages/s", this.story.scene.messages ? number(this.story.messagesPerSecond(t)) : "–"],
    ];
    const list = this.part("numbers");
    while (list.children.length > facts.length) list.lastChild.remove();
    facts.forEach(([name, value], i) => {
      const at = list.children[i] ?? list.appendChild(make("div", {}, make("dt"), make("dd")));
      if (at.children[0].textContent !== name) at.children[0].textContent = name;
      if (at.children[1].textContent !== value) at.children[1].textContent = value;
    });
  }

  /** Shows who asks the operator, what, and how long. */
  requests(t) {
    const asking = this.story.requestsAt(t);
    const isOpen = !this.story.over && this.onRelease !== null;
    const left = (r) => `${Math.ceil(r.left / 1e6)} s left`;
    // Buttons stay while only the time changes, so that one can be pressed.
    const text = JSON.stringify([asking.map((r) => r.id), isOpen]);
    const list = this.part("requests");
    if (text !== this.requestsText) {
      this.requestsText = text;
      const row = (r, i) => {
        const answer = make("button", { type: "button", "data-answer": r.id, title: i ? "" : "R", onclick: () => this.onRelease?.(r.id) }, "go on by itself");
        const what = make("span", {}, " asks whether to plan for all; ", make("span", { class: "when" }, left(r)), " ");
        return make("li", {}, this.link(r.id), what, ...(isOpen ? [answer] : []));
      };
      list.replaceChildren(...asking.map(row));
      this.part("requests-section").hidden = !asking.length;
      this.part("requests-title").textContent = asking.length === 1 ? "a request" : `${asking.length} requests`;
      this.part("requests-how").textContent = isOpen ? "Or command it something else: choose it." : "";
    }
    asking.forEach((r, i) => {
      const at = list.children[i].querySelector(".when");
      if (at.textContent !== left(r)) at.textContent = left(r);
    });
  }

  legend(meaning, seen) {
    const entries = this.picture.legend(meaning, seen);
    const text = JSON.stringify(entries);
    if (text === this.legendText) return;
    this.legendText = text;
    const item = (e) => {
      if (!e.ramp) {
        const swatch = make("span", { class: "swatch", "data-pattern": e.pattern });
        swatch.style.backgroundColor = e.colour;
        return make("li", {}, swatch, e.text);
      }
      const ramp = make("span", { class: "ramp" });
      ramp.style.backgroundImage = `linear-gradient(to right, ${e.ramp.join(", ")})`;
      return make("li", { class: "scale" }, make("span", {}, e.near), ramp, make("span", {}, e.far));
    };
    this.part("legend").replaceChildren(...entries.map(item));
  }

  faults() {
    const { faults } = this.story;
    if (faults.length === this.faultCount) return;
    this.faultCount = faults.length;
    const row = (f) =>
      make(
        "li",
        {},
        make("button", { class: "link", type: "button", onclick: () => this.onSeek(f.t) }, seconds(f.t)),
        " ",
        make("span", { title: f.effect }, f.who === null || /^external /.test(f.what) ? `${f.what}: ${f.effect}` : f.what),
      );
    this.part("faults").replaceChildren(...faults.slice(0, 500).map(row));
    this.part("faults-section").hidden = faults.length === 0;
  }

  /** Shows the chosen module at a time. */
  module(id, t, { talk, waits, circle }) {
    const section = this.part("module-section");
    section.hidden = this.part("module-facts").hidden = id === null;
    if (id === null) return;
    const { story, picture } = this;
    const known = picture.of(id, t, talk);
    const body = story.bodyAt(id, t);
    const { standing, life } = known;
    const { words } = story.scene;
    const role = standing.role === null ? "not heard of yet" : words.roles[standing.role].about.replace("{}", standing.place);
    const does = body.doing ? body.motion.name + failing(body.doing) : "rests";
    const [one, several] = words.distance;
    // Messages between modules are being loaded, or not available at all.
    const untold = story.scene.messages ? "loading" : "not seen from outside";
    const target = known.gradient === null ? untold : known.gradient === 65535 ? "knows none" : `${known.gradient} ${known.gradient === 1 ? one : several}`;
    const asks = story.scene.answer_within ? "asks the operator" : "its joints did not turn";
    const flags = [...FLAGS, /** @type {[number, string]} */ ([16, asks])].filter(([bit]) => standing.flags & bit);
    const owner = this.owner(id, talk);
    const dead = life === "dead";
    const facts = [
      ["process", known.stuck ? `${life}, joint stuck` : life],
      [dead ? "was" : "part", role],
      ["at", (body.part >= 1 ? body.to : body.from).at],
      ["does", dead ? null : does],
      [`${words.target} in`, dead ? null : target],
      ["waits for", dead || standing.role === null ? null : standing.waits === null ? "none" : this.link(standing.waits)],
      ["in a circle", circle.has(id) ? "yes" : null],
      ["locked by", dead ? null : !talk ? untold : owner === null ? "none" : this.link(owner)],
      ["reports", flags.length && !dead ? flags.map(([, text]) => text).join(", ") : null],
    ].filter(([, value]) => value !== null);
    section.dataset.id = id;
    section.dataset.life = life;
    const name = `${words.module} ${id}`;
    if (this.part("module-name").textContent !== name) this.part("module-name").textContent = name;
    this.part("module").replaceChildren(...facts.map(([name, value]) => make("div", {}, make("dt", {}, name), make("dd", {}, value))));
  }

  owner(id, talk) {
    for (let i = 0; i < (talk?.locks.length ?? 0); i += 2) if (talk.locks[i] === id) return talk.locks[i + 1];
    return null;
  }

  /** Shows the last moves of the chosen module; without one, the moves that are under way. */
  moves(id, t) {
    const { story } = this;
    const moves = id === null ? story.underWay(t, MOVES) : story.movesOf(id, t, MOVES);
    const row = ({ doing, who }) => {
      const begun = make("button", { class: "link", type: "button", onclick: () => this.onSeek(doing.t) }, seconds(doing.t));
      const how = failing(doing);
      const what = make("span", {}, `${doing.motion.name}${how}`, make("span", { class: "where" }, ` to ${doing.to.at}`));
      return id === null ? make("li", {}, begun, this.link(who), what) : make("li", { class: "own" }, begun, what);
    };
    const key = moves.map(({ doing, who }) => [who, doing.t, doing.failed]).join(";") + id;
    if (this.movesText === key) return;
    this.movesText = key;
    const { actions } = story.scene.words;
    this.part("moves-section").hidden = moves.length === 0;
    this.part("moves-title").textContent = id === null ? `${actions} under way` : `last ${actions}`;
    this.part("moves").replaceChildren(...moves.map(row));
  }

  /** Shows the last messages of the chosen module, requested when the picture is at rest. */
  async messages(id, t) {
    const list = this.part("messages");
    if (id === null) return;
    if (!this.story.scene.messages) {
      list.replaceChildren(make("li", {}, "Messages between processes are not seen from outside."));
      return;
    }
    const key = `${id} ${Math.floor(t)}`;
    if (this.asked === key) return;
    this.asked = key;
    const messages = await this.story.messagesOf(id, t);
    if (this.asked !== key) return;
    const row = (m) =>
      make(
        "li",
        { "data-class": this.story.scene.classes[m.class], title: this.story.scene.classes[m.class] },
        make("span", { class: "when" }, seconds(m.t)),
        m.sent ? " to " : " from ",
        this.link(m.peer),
        ` ${m.text}`,
      );
    list.replaceChildren(...messages.map(row));
    if (!messages.length) list.append(make("li", {}, "none so far"));
  }
}
