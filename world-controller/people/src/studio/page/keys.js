// The keys: everything can be done without a mouse.

/** @typedef {{ keys: string[], shown: string, about: string, group: string, act: (event: KeyboardEvent) => void }} Key */

/**
 * The keys, for the list of them and for the page. `page` has what they do.
 * @param {any} page @returns {Key[]}
 */
export function bindings(page) {
  const { structure, tools, space } = page;
  const step = (by) => (event) => {
    if (event.shiftKey && structure.selected.size) return tools.moveChosen(by);
    structure.move(structure.cursor.map((v, i) => v + by[i]));
  };
  /** @type {Key[]} */
  const keys = [];
  const add = (group, shown, names, about, act) => keys.push({ group, shown, keys: names, about, act });
  add("cursor", "← →", ["ArrowLeft"], "along x; with Shift, the chosen cubes", step([-1, 0, 0]));
  add("cursor", "", ["ArrowRight"], "", step([1, 0, 0]));
  add("cursor", "↑ ↓", ["ArrowUp"], "along y; with Shift, the chosen cubes", step([0, 1, 0]));
  add("cursor", "", ["ArrowDown"], "", step([0, -1, 0]));
  add("cursor", "PageUp PageDown", ["PageUp"], "a layer up, down; with Shift, the chosen cubes", step([0, 0, 1]));
  add("cursor", "", ["PageDown"], "", step([0, 0, -1]));
  add("drawing", "Enter", ["Enter"], "a cube at the cursor, or none if there is one", () => {
    const c = structure.cursor;
    structure.has(c) ? structure.change([], [c]) : tools.put(c);
  });
  add("drawing", "Delete", ["Delete", "Backspace"], "the chosen cubes away, or the one at the cursor", () => (structure.selected.size ? tools.removeChosen() : structure.change([], [structure.cursor])));
  add("drawing", "B", ["b"], "begin a rectangle at the cursor; again: fill it", () => page.corner("add"));
  add("drawing", "L", ["l"], "begin a line at the cursor; again: draw it", () => page.corner("line"));
  add("drawing", "1 … 6, 0", ["1", "2", "3", "4", "5", "6", "0"], "the tool of the pointer", (event) => page.setTool((Number(event.key) + 6) % 7));
  add("drawing", "+ −", ["+", "="], "thicker, thinner lines and blocks", () => page.setThickness(1));
  add("drawing", "", ["-"], "", () => page.setThickness(-1));
  add("drawing", "X, Y", ["x"], "mirror across x, y: through cells, between cells, off", () => structure.nextMirror(0));
  add("drawing", "", ["y"], "", () => structure.nextMirror(1));
  add("drawing", "Z, Shift Z", ["z", "Z"], "undo, redo", (event) => (event.shiftKey ? structure.redo() : structure.undo()));
  add("selection", "Space", [" "], "choose the cube at the cursor, or give it up", () => tools.select(structure.has(structure.cursor) ? [structure.cursor] : [], true));
  add("selection", "A", ["a"], "choose all", () => tools.choose(structure.list()));
  add("selection", "C, V", ["c"], "copy, paste at the cursor", () => tools.copy());
  add("selection", "", ["v"], "", () => tools.paste());
  add("selection", "T", ["t"], "turn by a quarter", () => tools.turnChosen());
  add("selection", "M, Shift M", ["m", "M"], "mirror along x, along y", (event) => tools.flipChosen(event.shiftKey ? 1 : 0));
  add("selection", "Escape", ["Escape"], "give up the selection or what is begun", () => page.escape());
  add("modules", "K, Shift K", ["k", "K"], "pin the module at the cursor, or two chosen cubes, or no longer; with Shift: no pins", (event) => (event.shiftKey ? page.unpin(structure.pinList()) : tools.pin()));
  add("modules", "R, Shift R", ["r", "R"], "take the first repair; with Shift: give up the pins that forbid it", (event) => (event.shiftKey ? page.unpin(page.panel.costly) : page.repair(0)));
  add("modules", "[ ]", ["["], "a module less, more of the order of building", () => page.setShown(-1));
  add("modules", "", ["]"], "", () => page.setShown(1));
  add("modules", "G", ["g"], "start the swarm that builds it", () => page.start());
  add("view", "P", ["p"], "cubes, modules, or both", () => page.nextMode());
  add("view", "F", ["f"], "look at all of it", () => space.preset("iso"));
  add("view", "7 8 9", ["7"], "from the front, from the side, from above", () => space.preset("front"));
  add("view", "", ["8"], "", () => space.preset("side"));
  add("view", "", ["9"], "", () => space.preset("top"));
  add("view", "W A S D with Alt", [], "turn; + and − with Alt: nearer, farther", () => {});
  add("view", "D", ["d"], "light or dark", () => page.nextTheme());
  add("page", "Q", ["q"], "the room", () => page.showMode("room"));
  add("page", "N", ["n"], "the first page", () => page.welcome());
  add("page", "O", ["o"], "open a file", () => document.getElementById("file").click());
  add("page", "S", ["s"], "save", () => document.getElementById("save").click());
  add("page", "?", ["?"], "this list", () => page.showKeys());
  return keys;
}

/** Makes keys work while `page` is active, and lists them. @param {any} page @param {Key[]} keys @param {HTMLElement} list */
export function listen(page, keys, list) {
  for (const group of new Set(keys.map((k) => k.group))) {
    const heading = document.createElement("h3");
    heading.textContent = group;
    const rows = document.createElement("dl");
    for (const k of keys.filter((k) => k.group === group && k.shown)) {
      const [term, text] = [document.createElement("dt"), document.createElement("dd")];
      [term.textContent, text.textContent] = [k.shown, k.about];
      rows.append(term, text);
    }
    list.append(heading, rows);
  }
  const turns = { w: [0, 0.12], s: [0, -0.12], a: [-0.12, 0], d: [0.12, 0] };
  addEventListener("keydown", (event) => {
    const target = /** @type {HTMLElement} */ (event.target);
    if (event.ctrlKey || event.metaKey) {
      const word = event.key.toLowerCase();
      if (!page.isActive()) return;
      if (word === "z") event.shiftKey ? page.redo() : page.undo();
      else if (word === "y") page.redo();
      else return;
      return event.preventDefault();
    }
    if (document.querySelector("dialog[open]") || !page.isActive() || target.closest("input:not([type=checkbox]):not([type=range]), select")) return;
    if (event.altKey) {
      if (!page.space) return;
      const turn = turns[event.key.toLowerCase()];
      if (turn) page.space.turn(turn[0], turn[1]);
      else if (event.key === "+" || event.key === "=") page.space.turn(0, 0, 1.15);
      else if (event.key === "-") page.space.turn(0, 0, 1 / 1.15);
      else return;
      return event.preventDefault();
    }
    // A focused button keeps the keys that press it.
    if (target.closest("button, summary, input") && (event.key === "Enter" || event.key === " " || event.key.startsWith("Arrow"))) return;
    const binding = keys.find((k) => k.keys.includes(event.key)) ?? keys.find((k) => k.keys.includes(event.key.toLowerCase()));
    if (!binding) return;
    binding.act(event);
    event.preventDefault();
  });
}
