// The keys of the page, and the list of them.

import { MEANINGS } from "./legend.js";
import { by, make } from "./dom.js";

const KEYS = [
  ["Space", "play or pause"],
  [", .", "a step back, a step on"],
  ["Home End", "to the beginning, to the end"],
  ["[ ]", "slower, faster"],
  ["← → ↑ ↓", "turn the picture; with Shift move it aside"],
  ["+ −", "nearer, farther"],
  ["F", "everything in view"],
  ["V L", "next view; parallel projection or perspective"],
  ["C", "follow the chosen module, or stay"],
  ["1 2 3 4 5", "colours: state, level of the goal, gradient, locks, host"],
  ["M W G O", "messages, who waits for whom, unfilled goal, only the goal: on or off"],
  ["X PgUp PgDn", "next section; move it"],
  ["A", "time, axes and scale: on or off"],
  ["N P", "next module, previous module"],
  ["Esc", "choose no module"],
  ["R", "answer the first request: it goes on by itself"],
  ["S", "save a picture"],
  ["D", "light or dark"],
  ["?", "this list"],
];

/** How far one press of an arrow turns, and moves aside. */
const [TURN, ASIDE] = [0.12, 0.06];


/** Returns the entries of the list of keys. */
export function keyList() {
  const names = (keys) => keys.split(" ").flatMap((k, i) => [i ? " " : "", make("kbd", {}, k)]);
  return KEYS.flatMap(([keys, text]) => [make("dt", {}, ...names(keys)), make("dd", {}, text)]);
}

/** Returns what each key does. */
function actionsOf(page, shift) {
  const { camera, look } = page;
  const toggle = (id) => {
    if (by(id).disabled) return;
    by(id).checked = !by(id).checked;
    by(id).dispatchEvent(new Event("change"));
  };
  const arrow = (dx, dy) => (shift ? camera.pan(dx * ASIDE, dy * ASIDE) : camera.orbit(dx * TURN, dy * TURN));
  const actions = {
    " ": () => page.setPlaying(!page.playing),
    ",": () => page.step(false),
    ".": () => page.step(true),
    Home: () => page.seek(0, true),
    End: () => page.seek(page.story.now, true),
    "[": () => page.faster(-1),
    "]": () => page.faster(1),
    ArrowLeft: () => arrow(-1, 0),
    ArrowRight: () => arrow(1, 0),
    ArrowUp: () => arrow(0, -1),
    ArrowDown: () => arrow(0, 1),
    "+": () => camera.zoom(0.9),
    "=": () => camera.zoom(0.9),
    "-": () => camera.zoom(1.11),
    f: () => look.fit(),
    v: () => look.nextView(),
    l: () => toggle("parallel"),
    c: () => toggle("follow"),
    x: () => look.nextSection(),
    PageUp: () => look.moveSection(1),
    PageDown: () => look.moveSection(-1),
    a: () => toggle("notes"),
    m: () => toggle("messages"),
    w: () => toggle("waits"),
    g: () => toggle("goal"),
    o: () => toggle("only"),
    n: () => page.neighbour(1),
    p: () => page.neighbour(-1),
    d: () => page.setTheme(document.documentElement.dataset.theme !== "dark", true),
    Escape: () => page.choose(null),
    r: () => page.answer(),
    s: () => page.openSaving(),
    "?": () => by("keys").showModal(),
  };
  Object.keys(MEANINGS).forEach((meaning, i) => (actions[`${i + 1}`] = () => page.setMeaning(meaning)));
  return actions;
}

/** Handles a key that was pressed. */
export function press(page, e) {
  const typing = e.target.matches?.("input:not([type=checkbox]):not([type=range]), select, textarea");
  if (typing || e.ctrlKey || e.metaKey || e.altKey || by("keys").open || by("saving").open) return;
  const action = actionsOf(page, e.shiftKey)[e.key.length === 1 ? e.key.toLowerCase() : e.key];
  // Buttons and ranges keep their own keys.
  if (!action || (e.key === " " && e.target.matches?.("button, input, summary"))) return;
  if (e.target.type === "range" && /^(Arrow|Page)/.test(e.key)) return;
  e.preventDefault();
  action();
}
