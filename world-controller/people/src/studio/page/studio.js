// The studio: puts the drawing, its pictures, the tools, the server's answers and the run together.

import { buildOrder, key, plus, settled } from "./cells.js";
import { EXAMPLES, picture } from "./examples.js";
import { bindings, listen } from "./keys.js";
import { roomBindings } from "./room-keys.js";
import { Layer } from "./layer.js";
import { effectOf, make, many, Panel } from "./panel.js";
import { Analyst, Server } from "./server.js";
import { Recent } from "./recent.js";
import { Room } from "./room.js";
import { Space } from "./space.js";
import { Structure } from "./structure.js";
import { TOOLS, Tools } from "./tools.js";

const $ = (id) => document.getElementById(id);
/** Number of recent drawings, and of cells of the largest one that is kept. */
const RECENT = 8, KEPT = 4000;
/** How long a change waits to be drawn together with the answer about it, in ms. */
const SOON = 150;

class Studio {
  constructor() {
    this.structure = new Structure();
    this.tools = new Tools(this.structure, () => this.look());
    this.server = new Server();
    this.space = new Space($("space"), this.structure);
    this.layer = new Layer($("layer"), this.structure, this.tools);
    this.panel = new Panel(this);
    this.tools.partner = (c) => this.structure.pinnedTo(c) ?? this.space.partnerOf(c);
    this.recent = new Recent("recent", RECENT, $("recent"), (drawing) => `${drawing.name} (${drawing.cells.length})`, (drawing) => this.opened(drawing));
    this.stock = null;
    this.going = false;
    /** The timer that ends a wait, and how many waits have begun since something was drawn. */
    this.waiting = 0;
    this.waits = 0;
    /** What a repair or reason that is pointed at would do. */
    this.marked = {};
    /** The revision whose modules are shown. */
    this.drawn = -1;
    this.analyst = new Analyst(this.server, this.structure, (answer, quick) => this.answered(answer, quick));
    this.structure.addEventListener("change", () => this.changed());
    this.structure.addEventListener("look", () => this.look());
    this.pointer();
    this.buttons();
    this.room = new Room(this);
    listen(this, bindings(this), $("keylist"));
    listen(this.room, roomBindings(this.room), $("room-keylist"));
    this.setTool(0);
    // On a small screen it would hide the drawing.
    if (innerWidth <= 600) $("flat").click();
  }

  async begin() {
    const system = matchMedia("(prefers-color-scheme: dark)");
    // The system decides until the user does.
    const follow = () => this.setTheme(localStorage.getItem("theme") ?? (system.matches ? "dark" : "light"));
    system.addEventListener("change", follow);
    follow();
    const first = await this.server.post("begin");
    if (first.result !== "done") {
      this.note(`${first.why}: the drawing cannot be paired or started`);
      document.body.dataset.state = "locked";
      return;
    }
    this.stock = first.modules;
    this.room.recorder.begin(first.study);
    this.directory(first.directory);
    this.room.cards(first.room_examples);
    for (const room of first.rooms.slice(1)) Object.assign(this.room, room).remember();
    if (first.rooms.length) this.room.open(first.rooms[0]);
    else if (first.opened.length) {
      for (const drawing of first.opened) this.remember({ ...settled(drawing), name: drawing.name });
      this.opened(first.opened[0]);
    } else this.welcome();
    document.body.dataset.state = "ready";
    this.analyst.work();
    if (first.run?.going) this.showRun(first.run);
  }

  showKeys() {
    $("keys").showModal();
    $("keys").scrollTop = 0;
  }
  /** True while keys are for the drawing. */
  isActive() {
    return $("run").hidden && !(this.room.isOpen && $("welcome").hidden);
  }
  /** Shows the drawing or the room. */
  showMode(mode) {
    const inRoom = mode === "room";
    [$("drawing").hidden, $("room").hidden, $("welcome").hidden] = [inRoom, !inRoom, true];
    $("to-drawing").setAttribute("aria-pressed", String(!inRoom));
    $("to-room").setAttribute("aria-pressed", String(inRoom));
    for (const [id, hidden] of [["keylist", inRoom], ["mouse-drawing", inRoom], ["room-keylist", !inRoom], ["mouse-room", !inRoom]]) $(id).hidden = hidden;
    $("name").value = inRoom ? this.room.name : this.structure.name;
    this.note("");
    if (!inRoom) return this.look();
    if (this.room.room) this.room.panel.show(this.room.room);
    else if (!this.room.text) $("room-cards").lastElementChild?.click();
  }
  /** What undo, redo and save are about. */
  get active() {
    return this.room.isOpen ? this.room : this.structure;
  }
  undo() {
    this.structure.undo();
  }
  redo() {
    this.structure.redo();
  }
  note(text) {
    $("note").textContent = text;
    $("note").hidden = !text;
  }

  // The drawing and its pictures.

  /** Draws nothing for a moment, since the answer may come soon. A frame is dear without a graphics card. */
  hold() {
    if (this.waits === 2) return;
    this.waits += 1;
    clearTimeout(this.waiting);
    this.waiting = setTimeout(() => this.release(), SOON);
    this.space.held = this.layer.held = true;
  }
  /** Draws again. */
  release() {
    if (!this.space.held) return;
    clearTimeout(this.waiting);
    this.waits = 0;
    this.space.held = this.layer.held = false;
    if (!this.analyst.isAnswered) {
      this.panel.pending();
      $("start").disabled = true;
    }
    this.look();
  }
  changed() {
    this.hold();
    this.note("");
    this.mark({});
    this.panel.list = [];
  }
  answered(answer, quick) {
    this.release();
    if (answer.result === "refused") this.note(answer.why);
    if (quick) $("start").disabled = true;
    // The modules of the whole answer are those of the quick one.
    if (quick || this.ordered || answer.revision !== this.drawn) {
      this.drawn = answer.revision;
      this.pairs = answer.pairs ?? [];
      this.ordered = false;
      this.space.shown = Infinity;
      this.space.show(this.pairs, answer.unpaired ?? []);
      this.layer.show(this.pairs, answer.unpaired ?? []);
    }
    this.panel.show(answer, quick);
  }
  look() {
    const { structure, tools, space } = this;
    const stroke = tools.effect();
    space.marked = { cells: new Set((this.marked.cells ?? []).map(key)), near: new Set((this.marked.near ?? []).map(key)) };
    space.marks = {
      add: [...structure.images(stroke.add), ...(this.marked.add ?? []), ...(this.hover ?? [])],
      remove: [...structure.images(stroke.remove), ...(this.marked.remove ?? []), ...stroke.select],
    };
    space.redraw();
    this.layer.ask();
    if (space.held) return;
    $("height").textContent = `layer ${structure.cursor[2]}`;
    $("hint").textContent = this.begun ? `from ${this.begun.from.join(", ")}; move the cursor and press ${this.begun.tool === "line" ? "L" : "B"}` : `cursor ${structure.cursor.join(", ")}`;
    const n = structure.selected.size;
    $("chosen").hidden = !n;
    $("chosen-text").textContent = `${many(n, "cube")} chosen`;
    for (const [axis, name] of [[0, "mirror-x"], [1, "mirror-y"]]) {
      const kind = structure.mirror[axis];
      $(name).setAttribute("aria-pressed", String(kind !== "off"));
      $(name).title = `mirror across ${"xy"[axis]} (${"XY"[axis]}): ${kind === "off" ? "off" : `${kind} cells`}`;
      $(name).dataset.kind = kind;
    }
  }
  mark(marked) {
    this.marked = marked;
    this.look();
  }
  setTool(i) {
    this.tools.tool = TOOLS[i][0];
    for (const [name] of TOOLS) $(`tool-${name}`).setAttribute("aria-pressed", String(name === this.tools.tool));
    $("thickness").hidden = !["line", "box"].includes(this.tools.tool);
    this.look();
  }
  setThickness(by) {
    this.tools.thickness = Math.min(4, Math.max(1, this.tools.thickness + by));
    $("thickness").textContent = `× ${this.tools.thickness}`;
    this.look();
  }
  nextMode() {
    const modes = ["modules", "cubes", "both"];
    this.setMode(modes[(modes.indexOf(this.space.mode) + 1) % 3]);
  }
  setMode(mode) {
    this.space.mode = $("mode").value = mode;
    this.space.preset("iso");
    this.space.redraw();
  }
  setShown(by) {
    if (!this.ordered) this.space.pairs = this.pairs = buildOrder(this.pairs);
    this.ordered = true;
    const bar = $("order");
    bar.value = String(Number(bar.value) + by);
    this.space.shown = Number(bar.value) === this.pairs.length ? Infinity : Number(bar.value);
    $("order-text").textContent = `${bar.value} of ${many(this.pairs.length, "module")}`;
    this.space.redraw();
  }
  nextTheme() {
    const next = document.documentElement.dataset.theme === "dark" ? "light" : "dark";
    localStorage.setItem("theme", next);
    this.setTheme(next);
  }
  setTheme(theme) {
    document.documentElement.dataset.theme = theme;
    this.space.theme();
    this.layer.ask();
  }

  /** Begins or ends a rectangle or a line with the keyboard. */
  corner(tool) {
    const at = this.structure.cursor;
    if (!this.begun) {
      this.begun = { from: at, tool };
      return this.look();
    }
    const stroke = { hit: { at, face: [0, 0, 1], onCube: false }, from: this.begun.from, to: at, tool };
    this.begun = null;
    const { add, pin } = this.tools.effect(stroke);
    this.structure.change(add, [], false, pin);
    this.look();
  }
  escape() {
    this.begun = null;
    this.tools.cancel();
    if (!$("welcome").hidden) this.close();
    this.tools.choose([]);
  }
  /** Gives up pins, as one step. @param {[import("./cells.js").Cell, import("./cells.js").Cell][]} pins */
  unpin(pins) {
    this.structure.change([], [], true, [], pins);
  }
  /** Takes a repair, as one step. */
  repair(i) {
    const repair = this.panel.list?.[i];
    if (!repair) return;
    const { add, remove } = effectOf(repair);
    this.structure.change(add, remove, true);
  }

  // Pointers.

  pointer() {
    const canvas = $("space");
    const down = new Set();
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("pointerdown", (event) => {
      down.add(event.pointerId);
      this.hover = null;
      const mouse = this.space.controls.mouseButtons;
      mouse.LEFT = null;
      // A second finger turns.
      if (down.size > 1) return this.tools.cancel();
      if (event.button === 1) return;
      const hit = this.space.pick(event.clientX, event.clientY);
      if (!hit) {
        if (event.button === 0) mouse.LEFT = 0;
        return;
      }
      const away = event.button === 2 || event.altKey;
      if ((away || this.tools.tool === "remove") && !hit.onCube) return;
      this.hold();
      this.tools.begin(hit, away);
    }, { capture: true });
    canvas.addEventListener("pointermove", (event) => {
      const stroke = this.tools.stroke;
      if (stroke && down.has(event.pointerId)) {
        const to = this.space.across(stroke.hit, event.clientX, event.clientY);
        // A drag is seen at once.
        if (String(to) !== String(stroke.to)) this.release();
        return this.tools.go(to);
      }
      if (down.size || event.pointerType === "touch") return;
      const hit = this.space.pick(event.clientX, event.clientY);
      const draws = ["add", "line", "box", "module"].includes(this.tools.tool) && !event.altKey;
      const at = hit && draws ? [hit.at, ...(this.tools.tool === "module" ? [plus(hit.at, hit.face)] : [])] : null;
      if (String(at) === String(this.hover)) return;
      this.hover = at;
      this.look();
    });
    const up = (event) => {
      down.delete(event.pointerId);
      if (event.type === "pointerup") this.tools.end(event.shiftKey);
      else this.tools.cancel();
    };
    canvas.addEventListener("pointerup", up);
    canvas.addEventListener("pointercancel", up);
    canvas.addEventListener("pointerleave", () => {
      this.hover = null;
      this.look();
    });
  }

  buttons() {
    const { structure, tools, space } = this;
    const icons = {
      add: "M8 3v10M3 8h10", remove: "M3 8h10", module: "M2 6h12v5H2zM8 6v5", line: "M2 13h3v-4h4V6h4V3", box: "M3 5l5-3 5 3v6l-5 3-5-3zM3 5l5 3 5-3M8 8v6", select: "M3 3h2m2 0h2m2 0h2v2m0 2v2m0 2v2h-2m-2 0H7m-2 0H3v-2m0-2V7m0-2V3", pin: "M2 5h12v6H2zM5 6l2 2-2 2-2-2zM11 6l2 2-2 2-2-2z",
    };
    const icon = (path) => {
      const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
      svg.setAttribute("viewBox", "0 0 16 16");
      const line = document.createElementNS("http://www.w3.org/2000/svg", "path");
      line.setAttribute("d", path);
      svg.append(line);
      return svg;
    };
    const tool = ([name, shortcut, about], i) => {
      const button = make("button", { type: "button", id: `tool-${name}`, title: `${name} (${shortcut}): ${about}`, onclick: () => this.setTool(i) }, icon(icons[name]), make("span", {}, name));
      return button;
    };
    const mirror = (axis) => make("button", { type: "button", id: `mirror-${"xy"[axis]}`, onclick: () => structure.nextMirror(axis) }, icon(axis ? "M2 8h12M8 6 5 3h6zM8 10l-3 3h6z" : "M8 2v12M6 8 3 5v6zM10 8l3-3v6z"), make("span", {}, `mirror ${"xy"[axis]}`));
    $("tools").append(...TOOLS.map(tool), make("button", { type: "button", id: "thickness", title: "thickness (+ −)", hidden: true, onclick: () => this.setThickness(tools.thickness === 4 ? -3 : 1) }, "× 1"), mirror(0), mirror(1));
    const chosen = [["copy", () => tools.copy()], ["paste", () => tools.paste()], ["turn", () => tools.turnChosen()], ["mirror", () => tools.flipChosen(0)], ["remove", () => tools.removeChosen()], ["none", () => this.escape()]];
    $("chosen-buttons").append(...chosen.map(([text, onclick]) => make("button", { type: "button", onclick }, text)));
    const click = (id, act) => $(id).addEventListener("click", act);
    click("undo", () => this.active.undo());
    click("redo", () => this.active.redo());
    click("to-drawing", () => this.showMode("drawing"));
    click("to-room", () => this.showMode("room"));
    click("new", () => this.welcome());
    click("theme", () => this.nextTheme());
    click("help", () => this.showKeys());
    click("fit", () => space.preset("iso"));
    click("flat", () => {
      $("beside").hidden = !$("beside").hidden;
      $("flat").setAttribute("aria-pressed", String(!$("beside").hidden));
      this.layer.ask();
    });
    click("up", () => structure.move([structure.cursor[0], structure.cursor[1], structure.cursor[2] + 1]));
    click("down", () => structure.move([structure.cursor[0], structure.cursor[1], structure.cursor[2] - 1]));
    click("open", () => $("file").click());
    click("save", () => this.save());
    click("scenario", () => this.downloadScenario());
    click("back", () => this.showDrawing());
    click("stop", () => this.server.post("stop"));
    $("mode").addEventListener("change", () => this.setMode($("mode").value));
    $("order").addEventListener("input", () => this.setShown(0));
    $("name").addEventListener("change", () => {
      const inRoom = this.room.isOpen;
      (inRoom ? this.room : structure).name = $("name").value || (inRoom ? "room" : "drawing");
    });
    $("file").addEventListener("change", () => this.import($("file").files[0]));
    $("build").addEventListener("submit", (event) => {
      event.preventDefault();
      this.start();
    });
  }

  // The first page, files, recent drawings.

  welcome() {
    const card = ({ name, about, cells }) => make("button", { type: "button", className: "card", onclick: () => this.opened({ name, cells }) }, picture(cells), make("strong", {}, name), make("span", {}, about));
    const empty = make("button", { type: "button", className: "link", onclick: () => this.opened({ name: "drawing", cells: [] }) }, "or begin with nothing");
    $("cards").replaceChildren(...EXAMPLES.map(card));
    $("welcome").querySelector(".link")?.remove();
    $("welcome").append(empty);
    $("welcome").hidden = false;
    $("cards").firstElementChild.focus();
  }
  close() {
    $("welcome").hidden = true;
    if (!this.room.isOpen) $("space").focus();
  }
  opened({ name, cells, pins, note }) {
    if (this.structure.cells.size) this.remember();
    this.showMode("drawing");
    const drawing = settled({ cells, pins });
    this.structure.open(drawing.cells, name, drawing.pins);
    $("name").value = name;
    this.close();
    this.space.preset("iso");
    if (note) this.note(note);
  }
  async import(file) {
    if (!file) return;
    const bytes = new Uint8Array(await file.arrayBuffer());
    const content = [...bytes].map((b) => b.toString(16).padStart(2, "0")).join("");
    $("file").value = "";
    this.take(await this.server.post("open", { name: file.name.replace(/[^A-Za-z0-9._-]/g, "-").replace(/^\.+/, ""), content }));
  }
  take(answer) {
    if (answer.result === "done") answer.room ? this.room.open(answer.room) : this.opened(answer.opened);
    else this.note(answer.why);
  }
  directory(names) {
    this.hasDirectory = names !== null && names !== undefined;
    const row = (name) => make("li", {}, make("button", { type: "button", className: "link", onclick: async () => this.take(await this.server.post("open", { name })) }, name));
    /** What may be drawings, for rooms. */
    this.drawings = (names ?? []).filter((n) => n.endsWith(".toml"));
    for (const id of ["files", "room-files"]) $(id).replaceChildren(...(names ?? []).filter((n) => /\.(toml|stl|obj|xml|vox)$/i.test(n)).map(row));
  }
  fileName() {
    return this.structure.name.replace(/[^A-Za-z0-9_-]+/g, "-").replace(/^-+/, "") || "drawing";
  }
  download(name, text) {
    const link = make("a", { href: URL.createObjectURL(new Blob([text], { type: "application/toml" })), download: name });
    link.click();
    URL.revokeObjectURL(link.href);
  }
  async save(replace = false) {
    const name = `${this.fileName()}.toml`;
    const { cells, pins } = this.drawing();
    this.remember();
    const pinned = pins.length ? `pins = ${JSON.stringify(pins)}\n` : "";
    if (!this.hasDirectory) return this.download(name, `version = 1\nname = ${JSON.stringify(this.structure.name)}\ncells = ${JSON.stringify(cells)}\n${pinned}`);
    const answer = await this.server.post("save", { name, cells, pins, replace });
    if (answer.result === "done") this.directory(answer.directory);
    else if (!replace && /already/.test(answer.why) && confirm(`${name} is there already. Replace it?`)) return this.save(true);
    else return this.note(answer.why);
    $("hint").textContent = `${name} is saved`;
  }
  /** The drawing, as it is kept and sent. */
  drawing() {
    return { name: this.structure.name, cells: this.structure.list(), pins: this.structure.pinList() };
  }
  remember({ name, cells, pins } = this.drawing()) {
    if (!cells.length || cells.length > KEPT) return;
    this.recent.add({ name, cells, pins });
  }

  // The run.

  request() {
    return { ...this.drawing(), name: this.fileName(), family: $("family").value, link: $("link").value };
  }
  async downloadScenario() {
    const answer = await this.server.post("start", { ...this.request(), only_scenario: true });
    if (answer.result === "done") this.download(`${this.fileName()}-scenario.toml`, answer.scenario);
    else this.note(answer.why);
  }
  async start() {
    if ($("start").disabled || !this.analyst.settled) return;
    $("start").disabled = true;
    this.remember();
    const answer = await this.server.post("start", this.request());
    if (answer.result === "done") return this.showRun({ run: answer.run });
    this.panel.startable();
    this.note(answer.why);
  }
  showRun({ run }) {
    this.going = true;
    $("run").querySelector("iframe")?.remove();
    $("run").append(make("iframe", { src: `run/?${run}#c=${this.server.secret}`, title: "the run" }));
    $("run").hidden = false;
    $("run").querySelector("iframe").focus();
    $("welcome").hidden = true;
    this.follow();
  }
  /** Asks for the state of the run until it is over. */
  async follow() {
    for (;;) {
      const { run, why } = await this.server.post("state");
      if (!run) return ($("run-state").textContent = why ?? "");
      const state = run.going ? "building" : (run.outcome ?? "failed");
      $("run-title").textContent = run.title;
      $("run-state").textContent = run.failure ?? state;
      $("run-state").dataset.outcome = state;
      $("stop").hidden = !run.going;
      $("run").dataset.modules = String(run.modules);
      if (!run.going) {
        this.going = false;
        this.panel.startable();
        this.room.panel.settled();
        return;
      }
      await new Promise((done) => setTimeout(done, 250));
    }
  }
  showDrawing() {
    $("run").hidden = true;
    if (!this.room.isOpen) $("space").focus();
    $("note").hidden = true;
    if (!this.going) return;
    this.note("the run is in progress");
    const show = make("button", { type: "button", className: "link", onclick: () => { $("run").hidden = false; this.note(""); } }, "show it");
    $("note").append(" ", show);
  }
}

const studio = new Studio();
// For tests, and for people who look.
window.studio = studio;
studio.recent.show();
studio.room.recent.show();
studio.begin();
