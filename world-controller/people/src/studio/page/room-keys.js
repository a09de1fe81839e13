// The keys for rooms: everything can be done without a mouse.

/** @typedef {import("./keys.js").Key} Key */

/** The keys, for the list of them and for the page. @param {any} room @returns {Key[]} */
export function roomBindings(room) {
  const { studio } = room;
  const get = (id) => document.getElementById(id);
  const move = (x, y) => (event) => room.move([x, y].map((v) => v * (event.shiftKey ? 5 : 1)));
  const open = (details, field) => {
    get(details).open = true;
    get(field).focus();
  };
  /** @type {Key[]} */
  const keys = [];
  const add = (group, shown, names, about, act) => keys.push({ group, shown, keys: names, about, act });
  add("choosing", "N, B", ["n", "N"], "choose the next piece; with Shift, one more", (event) => room.next(1, event.shiftKey));
  add("choosing", "", ["b", "B"], "", (event) => room.next(-1, event.shiftKey));
  add("choosing", "Tab", [], "to the pieces, one after the other", () => {});
  add("choosing", "V", ["v"], "choose all", () => room.choose(room.room?.pieces.map((piece) => piece.name) ?? []));
  add("choosing", "Escape", ["Escape"], "leave the proposal, or choose nothing", () => room.escape());
  add("pieces", "← → ↑ ↓", ["ArrowLeft"], "move by a connector; with Shift, by five", move(-1, 0));
  add("pieces", "", ["ArrowRight"], "", move(1, 0));
  add("pieces", "", ["ArrowUp"], "", move(0, 1));
  add("pieces", "", ["ArrowDown"], "", move(0, -1));
  add("pieces", "T, Shift T", ["t", "T"], "turn by a quarter, to the left, to the right", (event) => room.turn(event.shiftKey ? -1 : 1));
  add("pieces", "C", ["c"], "the next colour", () => room.colour());
  add("pieces", "J", ["j"], "snap to the nearest place that violates nothing", () => room.snap());
  add("pieces", "R", ["r"], "give another name", () => !get("piece-chosen").hidden && get("piece-name").select());
  add("pieces", "A, Shift A", ["a", "A"], "add a piece; with Shift, several", (event) => (event.shiftKey ? open("arrangements", "arrange-kind") : get("piece-what").focus()));
  add("pieces", "Delete", ["Delete", "Backspace"], "take out what is chosen", () => room.remove());
  add("pieces", "Z, Shift Z", ["z", "Z"], "undo, redo", (event) => (event.shiftKey ? room.redo() : room.undo()));
  add("constraints", "P", ["p"], "propose an arrangement that violates nothing", () => room.putRight());
  add("constraints", "Enter", ["Enter"], "take the proposal", () => room.accept());
  add("constraints", "K", ["k"], "add a constraint", () => open("more-constraints", "constraint-kind"));
  add("room", "G", ["g"], "start the swarm that builds it", () => room.start());
  add("view", "+ −", ["+", "="], "nearer, farther", () => room.plan.zoom(1.3));
  add("view", "", ["-"], "", () => room.plan.zoom(1 / 1.3));
  add("view", "F", ["f"], "look at all of it", () => room.plan.fit());
  add("view", "D", ["d"], "light or dark", () => studio.nextTheme());
  add("page", "Q", ["q"], "the drawing", () => studio.showMode("drawing"));
  add("page", "W", ["w"], "the first page", () => studio.welcome());
  add("page", "O", ["o"], "open a file", () => get("file").click());
  add("page", "S", ["s"], "save", () => room.save());
  add("page", "?", ["?"], "this list", () => studio.showKeys());
  return keys;
}
