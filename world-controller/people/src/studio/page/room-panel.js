// The panel beside a room: what is violated, what would put it right, the pieces, the constraints, and the run.

import { make, many } from "./panel.js";
import { EDGE } from "./plan.js";

/** What each kind of constraint needs: the least number of chosen pieces, the most, and its fields with first values. */
const KINDS = {
  gap: { about: "gap: at least so many free between two", least: 2, most: 2, cells: 2 },
  near: { about: "near: at most so many free between two", least: 2, most: 2, cells: 3 },
  facing: { about: "facing: the first looks to the second", least: 2, most: 2 },
  align: { about: "align: in a row", least: 2, most: 128, axis: "x" },
  circle: { about: "circle: around the piece chosen last", least: 4, most: 128, radius: 12, tolerance: 0.5 },
  wall: { about: "wall: stands at a wall", least: 1, most: 1 },
  walkway: { about: "walkway: so wide from a door to all", least: 0, most: 128, cells: 2 },
  reach: { about: "reach: metamodules reach all places", least: 0, most: 128 },
};
const SIGNS = { kept: "✓", violated: "✗", unknown: "…" };
const STATES = { kept: "kept", violated: "violated", unknown: "not looked at yet" };

export class RoomPanel {
  /** @param {any} page the room's page */
  constructor(page) {
    this.page = page;
    this.get = (id) => document.getElementById(id);
    const click = (id, act) => this.get(id).addEventListener("click", act);
    click("put-right", () => page.putRight());
    click("take", () => page.accept());
    click("discard", () => page.discard());
    click("piece-turn", () => page.turn(1));
    click("piece-snap", () => page.snap());
    click("piece-remove", () => page.remove());
    click("room-open", () => this.get("file").click());
    click("room-save", () => page.save());
    click("room-scenario", () => page.downloadScenario());
    click("plan-fit", () => page.plan.fit());
    click("plan-nearer", () => page.plan.zoom(1.3));
    click("plan-farther", () => page.plan.zoom(1 / 1.3));
    this.get("piece-name").addEventListener("change", () => page.rename(this.get("piece-name").value.trim()));
    const submit = (id, act) => this.get(id).addEventListener("submit", (event) => {
      event.preventDefault();
      act();
    });
    submit("room-build", () => page.start());
    submit("piece-add", () => this.add());
    submit("arrange", () => this.arrange());
    submit("constrain", () => this.constrain());
    submit("resize", () => page.change([{ resize: { size: [Number(this.get("room-width").value), Number(this.get("room-depth").value)] } }]));
    this.get("constraint-kind").append(...Object.entries(KINDS).map(([kind, { about }]) => make("option", { value: kind }, about)));
    this.get("constraint-kind").addEventListener("change", () => this.fields());
    this.get("arrange-kind").addEventListener("change", () => this.fields());
    this.fields();
  }

  /** The answer that is shown is about an older room. */
  pending() {
    this.get("room-verdict").dataset.pending = "yes";
    this.get("room-start").disabled = true;
  }
  /** All is answered. */
  settled() {
    const { room } = this.page;
    if (!room) return;
    delete this.get("room-verdict").dataset.pending;
    const hard = room.violations.some((v) => !v.wish);
    const why = hard ? "the room violates a constraint" : !room.pieces.length ? "the room has no piece" : !room.store ? "the room has no store" : this.page.studio.going ? "a run is in progress" : "";
    this.get("room-start").disabled = why !== "";
    this.get("room-start").title = why || "start the swarm that builds it (G)";
    this.get("room-why").textContent = why;
    this.get("room-why").hidden = !why;
  }

  /** Shows what the server says of the room. */
  show(room) {
    delete this.get("room-verdict").dataset.pending;
    const [state, text] = this.judge(room);
    this.get("room-verdict").dataset.state = state;
    this.get("room-verdict-text").textContent = text;
    this.get("put-right").hidden = !room.violations.some((v) => !v.wish && v.rule !== "reach") || this.page.proposal !== null;
    this.proposal();
    // What has to be put right comes first.
    const rank = ({ state, wish }) => (state === "violated" ? (wish ? 1 : 0) : 2);
    const sorted = [...room.constraints].sort((a, b) => rank(a) - rank(b));
    this.get("constraints").replaceChildren(...sorted.map((constraint) => this.row(room, constraint)));
    this.numbers(room);
    [this.get("room-width").value, this.get("room-depth").value] = room.size.map(String);
    this.what(room);
    this.choice();
  }

  /** @returns {[string, string]} */
  judge(room) {
    const state = (wanted) => room.constraints.filter((c) => c.state === wanted);
    const hard = state("violated").filter((c) => !c.wish).length;
    const wishes = state("violated").length - hard;
    if (hard) return ["bad", `${many(hard, "constraint")} violated`];
    if (!room.pieces.length) return ["none", "An empty room: add a piece."];
    if (wishes) return ["part", `${many(wishes, "wish").replace("wishs", "wishes")} not fulfilled`];
    if (!room.complete) return ["part", "No constraint is known to be violated; the time for looking was over"];
    return ["good", state("unknown").length ? "No constraint is violated so far" : "No constraint is violated"];
  }

  proposal() {
    const { proposal } = this.page;
    this.get("proposal").hidden = !proposal;
    if (!proposal) return;
    const { moves, total, least } = proposal;
    this.get("proposal-text").textContent = `Move ${many(moves.length, "piece")}, ${total} in all${least === "proven" ? ": the least that puts the room right" : "; less may do"}.`;
  }

  /** A constraint: whether it is kept, what it asks for, and how it is violated. */
  row(room, constraint) {
    const violations = room.violations.filter((v) => v.constraint === constraint.number && v.rule === constraint.kind);
    const about = violations.map((v) => make("span", { className: "why" }, v.why));
    const mark = (on) => () => this.page.mark(on ? { pieces: [...new Set([...constraint.pieces, ...violations.flatMap((v) => v.pieces)])].slice(0, 32), violation: violations[0] ?? null } : null);
    const { number } = constraint;
    const text = make("button", { type: "button", className: "constraint-text", onclick: () => constraint.pieces.length && this.page.choose(constraint.pieces), onmouseenter: mark(true), onmouseleave: mark(false), onfocus: mark(true), onblur: mark(false), title: "choose its pieces" }, make("b", {}, constraint.kind), `: ${constraint.text}`, ...about);
    const buttons = number === null ? [] : [
      make("button", { type: "button", className: "small", ariaLabel: `constraint ${number} is ${constraint.wish ? "a wish" : "a must"}`, title: constraint.wish ? "only a wish; make it a must" : "a must; make it only a wish", onclick: () => this.page.change([{ wish: { constraint: number, wish: !constraint.wish } }]) }, constraint.wish ? "wish" : "must"),
      make("button", { type: "button", className: "small", ariaLabel: `give constraint ${number} up`, title: "give it up", onclick: () => this.page.change([{ release: { constraint: number } }]) }, "×"),
    ];
    const row = make("li", {}, make("span", { className: "sign", ariaLabel: STATES[constraint.state], role: "img", title: STATES[constraint.state] }, SIGNS[constraint.state]), text, ...buttons);
    row.dataset.state = constraint.state;
    row.dataset.wish = String(constraint.wish);
    return row;
  }

  numbers(room) {
    const metres = room.size.map((n) => (n * EDGE).toFixed(1)).join(" × ");
    const facts = [["pieces", room.pieces.length], ["metamodules", `${room.metamodules} + ${room.spare} spare`], ["size", `${metres} m`], ["height", `${(room.height * EDGE).toFixed(1)} m`]];
    for (const { p_l, p_g } of room.circles) facts.push(["circle p_l", `${p_l.toFixed(4)} m`], ["circle p_g", p_g === null ? "none" : p_g.toFixed(4)]);
    this.get("room-numbers").replaceChildren(...facts.map(([term, text]) => make("div", {}, make("dt", {}, term), make("dd", {}, String(text)))));
  }

  /** What can be added: shapes, the drawing, and drawings of the directory. */
  what(room) {
    const { studio } = this.page;
    const select = this.get("piece-what");
    const cells = studio.structure.cells.size;
    const options = [...room.shapes.map((name) => [`shape:${name}`, name]), ...(cells ? [["drawing", `${studio.structure.name}, as drawn (${cells})`]] : []), ...(studio.drawings ?? []).map((name) => [`file:${name}`, name])];
    const before = select.value;
    select.replaceChildren(...options.map(([value, text]) => make("option", { value }, text)));
    select.value = options.some(([value]) => value === before) ? before : `shape:${room.shapes[1] ?? room.shapes[0]}`;
    for (const id of ["piece-colour", "arrange-colour"]) {
      if (!this.get(id).children.length) this.get(id).append(...room.colours.map((name) => make("option", { value: name, selected: name === "blue" }, name)));
    }
  }
  add() {
    const { studio } = this.page;
    const colour = this.get("piece-colour").value;
    const what = this.get("piece-what").value;
    if (what === "drawing") {
      const pins = studio.structure.pinList();
      return this.page.add({ cells: studio.structure.list(), ...(pins.length ? { pins } : {}), colour });
    }
    const [key, name] = what.split(/:(.*)/s);
    this.page.add({ [key]: name, colour });
  }

  /** What is chosen. */
  choice() {
    const pieces = this.page.pieces();
    this.get("piece-chosen").hidden = !pieces.length;
    this.fields();
    this.get("piece-where").textContent = "";
    if (!pieces.length) return;
    const alone = pieces.length === 1;
    this.get("piece-name").value = alone ? pieces[0].name : many(pieces.length, "piece");
    this.get("piece-name").disabled = !alone;
    this.get("piece-snap").disabled = !alone;
    this.get("piece-where").textContent = alone ? `at ${pieces[0].at.join(", ")}, turned ${pieces[0].turn * 90}°, ${many(pieces[0].metamodules, "metamodule")}` : pieces.map((piece) => piece.name).join(", ");
    const swatch = (name) => {
      const button = make("button", { type: "button", className: "swatch", title: `${name} (C: the next colour)`, ariaLabel: name, ariaPressed: String(pieces.every((piece) => piece.colour === name)), onclick: () => this.page.colour(name) });
      button.dataset.colour = name;
      return button;
    };
    this.get("piece-colours").replaceChildren(...(this.page.room.colours ?? []).map(swatch));
  }

  /** Shows the fields of the chosen kinds, and whether they can be sent. */
  fields() {
    const kind = KINDS[this.get("constraint-kind").value] ?? KINDS.gap;
    for (const [field, id] of [["cells", "constraint-cells"], ["axis", "constraint-axis"], ["radius", "constraint-radius"], ["tolerance", "constraint-tolerance"]]) {
      this.get(id).closest("label").hidden = kind[field] === undefined;
    }
    const n = this.page.chosen.length;
    const fits = n >= kind.least && (kind.most === 128 || n <= kind.most);
    const wanted = kind.most === 128 ? `${kind.least} or more pieces` : many(kind.least, "piece");
    this.get("constraint-add").disabled = !fits;
    this.get("constraint-why").textContent = kind.least ? (fits ? `of ${this.page.chosen.join(", ")}` : `choose ${wanted} first (Shift and a click, or Shift N)`) : "";
    const arrange = this.get("arrange-kind").value;
    this.get("arrange-rows").closest("label").hidden = !["grid", "auditorium"].includes(arrange);
    this.get("arrange-radius").closest("label").hidden = !["circle", "auditorium"].includes(arrange);
    this.get("arrange-gap").closest("label").hidden = arrange === "circle";
    this.get("arrange-where").textContent = n === 1 ? `around ${this.page.chosen[0]}` : "around the middle of what is seen; choose a piece to put it around that";
  }
  constrain() {
    const kind = this.get("constraint-kind").value;
    const { chosen } = this.page;
    const number = (id) => Number(this.get(id).value);
    const wanted = { kind };
    const { most, cells, axis, radius } = KINDS[kind];
    if (kind === "wall") wanted.piece = chosen[0];
    else if (kind === "circle") Object.assign(wanted, { pieces: chosen.slice(0, -1), around: chosen[chosen.length - 1] });
    else if (most === 2 || kind === "align") wanted.pieces = chosen;
    if (cells !== undefined) wanted.cells = number("constraint-cells");
    if (axis !== undefined) wanted.axis = this.get("constraint-axis").value;
    if (radius !== undefined) Object.assign(wanted, { radius: number("constraint-radius"), tolerance: number("constraint-tolerance") });
    this.page.change([{ constrain: wanted }]);
  }
  arrange() {
    const { page } = this;
    const number = (id) => Number(this.get(id).value);
    const template = this.get("arrange-kind").value;
    const rows = ["grid", "auditorium"].includes(template) ? number("arrange-rows") : 1;
    page.change([{ arrange: { template, count: [number("arrange-count"), rows], around: this.middle(), radius: number("arrange-radius"), gap: number("arrange-gap"), shape: this.get("arrange-shape").value, colour: this.get("arrange-colour").value } }]);
  }
  /** The connector in the middle of the chosen piece, or of what is seen. */
  middle() {
    const { room, plan } = this.page;
    const [piece] = this.page.pieces();
    if (piece) {
      const { size } = room.forms[piece.form].turns[piece.turn % 4];
      return piece.at.map((v, i) => v + Math.floor(size[i] / 2));
    }
    const { x, y, width, height } = plan.window ?? plan.whole();
    return [Math.round(x + width / 2), Math.round(room.size[1] - y - height / 2)].map((v, i) => Math.min(Math.max(v, 0), room.size[i] - 1));
  }
}
