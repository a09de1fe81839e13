// The panel beside the drawing: what the drawing becomes, why not, what to change, and its numbers.

/** Edge of a cell in mm, and mass of a module in kg, of Roombots. */
const EDGE = 110, MASS = 1.4;

/** Makes an element. @param {string} tag @param {object} properties @param {...(Node | string)} children */
export function make(tag, properties = {}, ...children) {
  const element = Object.assign(document.createElement(tag), properties);
  element.append(...children);
  return element;
}
export const many = (n, noun) => `${n.toLocaleString("en")} ${noun}${n === 1 ? "" : "s"}`;

/** Puts a repair into words. @param {{ changes: object[], choice: string }} repair */
export function repairText({ changes, choice }) {
  const [add, remove] = ["add", "remove"].map((verb) => changes.filter((c) => verb in c).length);
  const parts = [add && `add ${many(add, "cube")}`, remove && `remove ${many(remove, "cube")}`].filter(Boolean);
  return parts.join(", ") + (choice === "symmetric" ? ", keep the symmetry" : choice === "next-additions" ? " elsewhere" : "");
}

/** The cells of a repair. @param {{ changes: { add?: number[], remove?: number[] }[] }} repair */
export const effectOf = ({ changes }) => ({ add: changes.flatMap((c) => (c.add ? [c.add] : [])), remove: changes.flatMap((c) => (c.remove ? [c.remove] : [])) });

export class Panel {
  /** @param {any} page */
  constructor(page) {
    this.page = page;
    this.get = (id) => document.getElementById(id);
    this.answer = null;
    /** The pins that are to be given up so that more cubes have a partner. */
    this.costly = [];
    /** Whether a family can build the drawing, and why not. */
    [this.can, this.why] = [false, ""];
  }

  /** The drawing has changed, and the answer is about an older one. */
  pending() {
    this.get("verdict").dataset.pending = "yes";
    this.numbers();
  }

  /** Shows an answer of the server. `quick` if repairs and splits are still to come. */
  show(answer, quick) {
    this.answer = answer;
    const verdict = this.get("verdict");
    delete verdict.dataset.pending;
    const [state, text] = this.judge(answer);
    verdict.dataset.state = state;
    this.get("verdict-text").textContent = text;
    this.reasons(answer.reasons ?? []);
    this.costly = answer.costly_pins ?? [];
    if (!quick) {
      this.repairs(answer.repairs ?? [], answer);
      this.families(answer.families);
    } else if (!answer.d) this.repairs([], answer);
    const bar = this.get("order");
    bar.max = String(answer.pairs?.length ?? 0);
    bar.value = bar.max;
    this.get("order-text").textContent = `${bar.value} of ${many(answer.pairs?.length ?? 0, "module")}`;
    this.numbers();
  }

  /** @returns {[string, string]} */
  judge(answer) {
    if (answer.result === "empty") return ["none", "Draw a cube: click the floor, or press Enter."];
    if (answer.result !== "analysed") return ["bad", answer.why ?? "no answer"];
    const modules = many(answer.pairs.length, "module");
    if (answer.d && !answer.d_without_pins) return ["bad", `${answer.costly_pins.length === 1 ? "A pin forbids" : `${answer.costly_pins.length} pins forbid`} it: ${many(answer.d, "cube")} left over`];
    if (answer.d) return ["bad", `${many(answer.d, "cube")} left over: ${answer.d === 1 ? "it has" : "they have"} no partner`];
    if (answer.parts > 1) return ["part", `${modules}, in ${answer.parts} parts that do not touch`];
    return ["good", `${modules}: every cube has a partner`];
  }

  reasons(reasons) {
    const mark = (reason) => () => this.page.mark(reason ? { cells: reason.cells, near: reason.neighbours } : {});
    const row = (reason) => {
      const [n, m] = [reason.cells.length, reason.neighbours.length];
      const held = reason.pins?.length ?? 0;
      const free = held ? " that are not pinned" : "";
      const text = m === 0 ? (held ? "This cube touches only pinned ones" : "This cube touches no other") : `These ${n} cubes touch only ${m === 1 ? "this one" : `these ${m}`}${m === 1 && held ? " that is not pinned" : free}`;
      const over = `${n - m} ${n - m === 1 ? "stays" : "stay"} over`;
      const about = m === 0 ? "" : m === 1 ? `, which can take one of them, so ${over}` : `; each of these can take one, so ${over}`;
      const button = make("button", { type: "button", className: "reason", onmouseenter: mark(reason), onfocus: mark(reason), onmouseleave: mark(null), onblur: mark(null) }, text + about + ".");
      return make("li", {}, button);
    };
    const rows = reasons.slice(0, 4).map(row);
    if (reasons.length > 4) rows.push(make("li", {}, `and ${reasons.length - 4} more`));
    this.get("reasons").replaceChildren(...rows);
  }

  repairs(repairs, answer) {
    const ghost = (repair) => () => this.page.mark(repair ? effectOf(repair) : {});
    // What is drawn symmetrically is meant so: the repair that keeps the symmetry comes first, though another may cost less.
    this.list = [...repairs].sort((a, b) => Number(b.choice === "symmetric") - Number(a.choice === "symmetric"));
    const row = (repair, i) =>
      make("button", { type: "button", className: i ? "repair" : "repair first", onclick: () => this.page.repair(i), onmouseenter: ghost(repair), onfocus: ghost(repair), onmouseleave: ghost(null), onblur: ghost(null), title: `cost ${repair.cost}${repair.cheapest === "proven" ? ", the least" : ""}${i ? "" : " (R)"}` }, repairText(repair));
    const pins = this.costly.length ? [this.giveUp(answer)] : [];
    const note = answer.complete === false ? [make("p", { className: "soft" }, "The search was ended after 2 s; there may be more.")] : [];
    this.get("repairs").replaceChildren(...this.list.map(row), ...pins, ...note);
    this.get("repair-section").hidden = !repairs.length && !pins.length && !note.length;
  }

  /** The button that gives up the pins that cost modules. */
  giveUp(answer) {
    const { costly, page } = this;
    const show = (near) => () => page.mark({ near });
    const left = answer.d_without_pins ? `, ${many(answer.d_without_pins, "cube")} stay over` : "";
    return make("button", { type: "button", id: "give-up", className: "repair", onclick: () => page.unpin(costly), onmouseenter: show(costly.flat()), onfocus: show(costly.flat()), onmouseleave: show([]), onblur: show([]), title: "the marked modules may be others then (Shift R)" }, `give up ${many(costly.length, "pin")}${left}`);
  }

  /** Which families can build it. */
  families(families) {
    const select = this.get("family");
    const before = select.value;
    select.replaceChildren(...(families ?? []).map((f) => make("option", { value: f.name, disabled: !f.can }, f.can ? `${f.name}s` : `${f.name}s (cannot)`)));
    const can = (families ?? []).filter((f) => f.can).map((f) => f.name);
    if (can.length) select.value = can.includes(before) ? before : can[0];
    this.get("family-label").hidden = !families?.length;
    const why = (families ?? []).filter((f) => !f.can).map((f) => `${f.name}s: ${f.why}`);
    this.get("cannot").textContent = why.join("\n");
    this.startable(can.length > 0, families ? why.join("\n") : this.answer?.parts > 1 ? "A swarm builds a drawing in one part." : "");
  }

  /** Whether a swarm can be started; if not, why stands below the button. */
  startable(can = this.can, why = this.why) {
    [this.can, this.why] = [can, why];
    const reason = this.page.going ? "Another run is in progress: stop it first." : can ? "" : why || "Nothing is drawn yet.";
    this.get("start").disabled = Boolean(reason);
    this.get("start-why").textContent = reason;
    this.get("start-why").hidden = !reason;
  }

  numbers() {
    const { structure, stock } = this.page;
    const n = structure.cells.size;
    const b = structure.bounds();
    const size = b ? b.low.map((v, i) => ((b.high[i] - v + 1) * EDGE) / 10).join(" × ") : "0";
    const modules = this.answer?.pairs?.length ?? 0;
    const pins = structure.pins.size / 2;
    const facts = [["cubes", n.toLocaleString("en")], ["modules", stock ? `${modules} of ${stock}` : modules.toLocaleString("en")], ["size", `${size} cm`], ["mass", `${(modules * MASS).toFixed(1)} kg`], ...(pins ? [["pins", pins.toLocaleString("en")]] : [])];
    this.get("numbers").replaceChildren(...facts.map(([term, text]) => make("div", {}, make("dt", {}, term), make("dd", {}, text))));
    this.get("stock").hidden = !stock || modules <= stock;
    this.get("stock").textContent = stock ? `${many(modules - stock, "module")} too few` : "";
  }
}
