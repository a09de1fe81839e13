// The page: reads the story, plays it, and handles buttons and keys.

import { Control } from "./control.js";
import { keyList, press } from "./keys.js";
import { Look } from "./look.js";
import { by, make } from "./dom.js";
import { HostsTable } from "./hosts.js";
import { Panel } from "./panel.js";
import { fetchFigure, figureOf, renderLine, saveAs } from "./figure.js";
import { MEANINGS, TOLD, UNSEEN } from "./legend.js";
import { Picture } from "./picture.js";
import { Renderer } from "./renderer.js";
import { Story } from "./story.js";
import { Timeline } from "./timeline.js";
import { Viewpoint } from "./viewpoint.js";

const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4, 8, 16, 32, 64, 128];
const FOLLOW_EVERY = 400;
/** Of a page that commands the run. */
const FOLLOW_CLOSELY = 100;
/** Time between two requests for the messages of a module while a run is played, in milliseconds. */
const MESSAGES_EVERY = 250;
/** What is shown, by the link of the scene. */
const LINKS = { sim: "simulated", ipc: "processes", plan: "a plan, one action a second" };

class Page {
  constructor(story) {
    this.story = story;
    // A run in progress is shown at its present.
    this.t = story.over ? 0 : story.now;
    this.playing = false;
    this.speed = 1;
    this.chosen = null;
    this.meaning = "state";
    this.dirty = true;
    /** True if more than the camera has changed since the picture was built. */
    this.stale = true;
    this.seen = null;
    this.clock = 0;
    this.said = 0;
    this.heard = 0;
    this.last = null;
    this.drawnAt = null;
    this.passed = 0;
    this.rested = null;
    this.moving = false;
    this.plain = false;
    this.scale = 1;
    this.late = 0;
    /** The timer of the next request for what is new; null while one is under way. */
    this.next = null;
    this.isHurried = false;
    this.setTheme(matchMedia("(prefers-color-scheme: dark)").matches);
    this.camera = new Viewpoint(by("space"));
    this.renderer = new Renderer(by("space"));
    this.picture = new Picture(this.renderer, story);
    this.timeline = new Timeline(by("timeline"), by("head"), by("tip"), story);
    this.panel = new Panel(story, this.picture);
    this.hosts = new HostsTable(story);
    this.control = story.over ? null : Control.fromAddress();
    this.control?.show(story.scene.commands, () => this.chosen);
    if (this.control) this.control.onTaken = () => this.hurry();
    if (this.control) this.panel.onRelease = (id) => this.control.give(`release ${id}`);
    this.redraw = () => (this.dirty = this.stale = true);
    this.look = new Look(this);
    this.fill();
    this.listen();
    this.look.fit();
    this.camera.onChange = () => (this.moving = this.dirty = true);
    story.onTalk = this.redraw;
    story.onLost = (error) => this.lost(error);
    story.onAnew = () => this.anew();
    const resized = new ResizeObserver(() => {
      this.timeline.refresh();
      this.redraw();
    });
    for (const element of [document.body, by("frame")]) resized.observe(element);
    requestAnimationFrame((now) => this.frame(now));
    if (!story.over) this.follow();
  }

  fill() {
    const { scene } = this.story;
    document.title = `${scene.title} – Metamorph`;
    by("title").textContent = scene.title;
    const modules = `${scene.start.length.toLocaleString("en")} ${scene.words.modules}`;
    const seed = scene.seed === null ? null : `seed ${scene.seed}`;
    by("about").textContent = [modules, LINKS[scene.link], seed].filter((text) => text).join(" · ");
    if (this.story.isPlan) by("entries").textContent = "actions";
    by("repeat").textContent = scene.repeat;
    by("description").textContent = scene.description ?? "";
    by("meaning").append(...Object.entries(MEANINGS).map(([value, text]) => make("option", { value }, text)));
    by("speed").append(...SPEEDS.map((s) => make("option", { value: s }, `${s}×`)));
    this.setSpeed(this.story.over && !this.story.isPlan ? this.story.now / 1e6 / 40 : 1);
    by("keylist").append(...keyList());
    const classes = scene.classes.map((name, i) => {
      const swatch = make("i");
      swatch.style.backgroundColor = `var(--c-${name})`;
      const box = make("input", { type: "checkbox", checked: true, "data-class": name });
      box.addEventListener("change", () => {
        this.timeline.shown[i] = box.checked;
        this.timeline.refresh();
        this.redraw();
      });
      return make("label", {}, box, swatch, name);
    });
    by("classes").append(...classes);
    this.offer();
  }

  /** Disables what cannot be shown: messages between modules are not available while processes run. */
  offer() {
    const { messages } = this.story.scene;
    const why = messages ? "" : UNSEEN;
    by("messages").disabled = !messages;
    by("messages").parentElement.title = why;
    for (const option of by("meaning").options) {
      option.disabled = !messages && TOLD.includes(option.value);
      option.title = option.disabled ? why : "";
      option.hidden = option.value === "host" && !this.story.scene.hosts;
    }
  }

  /** Handles a replaced scene. The time and the view stay as they are. */
  anew() {
    this.offer();
    this.panel.forget();
    this.timeline.refresh();
    this.redraw();
  }

  listen() {
    const click = (id, action) => by(id).addEventListener("click", action);
    click("play", () => this.setPlaying(!this.playing));
    click("step", () => this.step(true));
    click("back", () => this.step(false));
    click("start", () => this.seek(0, true));
    click("end", () => this.seek(this.story.now, true));
    click("theme", () => this.setTheme(document.documentElement.dataset.theme !== "dark", true));
    click("help", () => by("keys").showModal());
    click("unchoose", () => this.choose(null));
    click("save", () => this.openSaving());
    for (const id of ["format", "width"]) by(id).addEventListener("change", () => this.tellRender());
    by("saving").addEventListener("close", () => by("saving").returnValue && this.save());
    by("speed").addEventListener("change", (e) => this.setSpeed(Number(e.target.value)));
    by("meaning").addEventListener("change", (e) => this.setMeaning(e.target.value));
    by("scrub").addEventListener("input", (e) => this.seek(Number(e.target.value), true));
    by("find").addEventListener("submit", (e) => {
      e.preventDefault();
      const text = by("which").value.trim();
      const id = Number(text);
      if (text !== "" && Number.isInteger(id) && this.story.modules[id]) this.choose(id);
      else by("which").select();
    });
    this.timeline.onSeek = (t) => this.seek(t, true);
    this.panel.onSeek = (t) => this.seek(t, true);
    this.panel.onChoose = (id) => this.choose(id);
    this.camera.listen(by("space"), (e) => {
      const box = by("space").getBoundingClientRect();
      const x = ((e.clientX - box.left) / box.width) * 2 - 1;
      const y = 1 - ((e.clientY - box.top) / box.height) * 2;
      this.choose(this.picture.pick(this.camera.ray(x, y)));
    });
    document.addEventListener("keydown", (e) => press(this, e));
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", (e) => this.setTheme(e.matches, true));
    // The library makes everything again when the browser gives the picture back.
    by("space").addEventListener("webglcontextlost", () => this.note("The browser has taken the picture away."));
    by("space").addEventListener("webglcontextrestored", () => {
      this.note("");
      this.redraw();
    });
  }

  setTheme(dark, again = false) {
    document.documentElement.dataset.theme = dark ? "dark" : "light";
    if (!again) return;
    this.picture.theme();
    this.timeline.refresh();
    this.redraw();
  }

  setMeaning(meaning) {
    const { messages, hosts } = this.story.scene;
    if ((!messages && TOLD.includes(meaning)) || (!hosts && meaning === "host")) return;
    this.meaning = meaning;
    by("meaning").value = meaning;
    this.redraw();
  }

  setSpeed(speed) {
    const near = (a, b) => Math.abs(Math.log(a / speed)) - Math.abs(Math.log(b / speed));
    this.speed = [...SPEEDS].sort(near)[0];
    by("speed").value = `${this.speed}`;
  }

  faster(by_) {
    const i = SPEEDS.indexOf(this.speed) + by_;
    this.setSpeed(SPEEDS[Math.max(0, Math.min(SPEEDS.length - 1, i))]);
  }

  setPlaying(playing) {
    // At the end, playing starts over.
    if (playing && this.story.over && this.t >= this.story.now) this.t = 0;
    this.playing = playing;
    by("play").textContent = playing ? "❚❚" : "▶";
    by("play").setAttribute("aria-label", playing ? "pause" : "play");
    document.body.dataset.state = playing ? "playing" : "paused";
    this.last = null;
    this.redraw();
  }

  seek(t, pause) {
    this.t = Math.max(0, Math.min(this.story.now, t));
    if (pause && this.playing) this.setPlaying(false);
    this.moving = true;
    this.redraw();
  }

  step(forward) {
    this.seek(this.story.moment(this.t, forward), true);
  }

  choose(id) {
    this.chosen = id;
    if (id !== null) by("which").value = `${id}`;
    this.redraw();
  }

  /** Answers the request that has waited longest. */
  answer() {
    const [first] = this.story.requestsAt(this.story.now);
    if (first && !this.story.over) this.panel.onRelease?.(first.id);
  }

  neighbour(by_) {
    const n = this.story.modules.length;
    this.choose(this.chosen === null ? (by_ > 0 ? 0 : n - 1) : (this.chosen + by_ + n) % n);
  }

  /** Returns the figure of what is shown, as options of `metamorph render`. */
  figure() {
    return figureOf({
      story: this.story,
      t: this.t,
      camera: this.camera,
      meaning: this.meaning,
      ...this.look.options(),
      notes: by("notes").checked,
      dark: document.documentElement.dataset.theme === "dark",
      width: by("width").value,
      moving: ["gif", "apng"].includes(by("format").value),
    });
  }

  openSaving() {
    this.setPlaying(false);
    by("saving").returnValue = "";
    by("saving").showModal();
    this.tellRender();
  }

  tellRender() {
    const isScreen = by("format").value === "screen";
    by("as-figure").hidden = by("wide").hidden = isScreen;
    by("as-screen").hidden = !isScreen;
    by("render").textContent = isScreen ? "" : renderLine(this.figure(), by("format").value);
  }

  async save() {
    by("save").disabled = true;
    this.note("");
    try {
      const format = by("format").value;
      saveAs(await (format === "screen" ? this.screen() : fetchFigure(this.figure(), format)));
    } catch (error) {
      this.note(`The figure cannot be saved: ${error.message}`);
    }
    by("save").disabled = false;
  }

  /** Returns the picture as it is. */
  screen() {
    const draw = () => this.picture.draw(this.camera, this.clock);
    const entries = this.picture.legend(this.meaning, this.seen);
    return this.look.screen(this.renderer, draw, { t: this.t, entries }).finally(() => this.redraw());
  }

  note(text) {
    by("note").textContent = text;
    by("note").hidden = !text;
  }

  lost(error) {
    if (this.story.over) this.note("The program that showed this run has ended. What has been loaded stays.");
    else this.note(`The run cannot be followed any more: ${error.message}`);
  }

  /** Asks for what is new at once, or, if that was asked before now, again after it. */
  hurry() {
    this.isHurried = true;
    if (this.next === null) return;
    clearTimeout(this.next);
    this.follow();
  }

  async follow() {
    this.next = null;
    this.isHurried = false;
    const end = this.story.now;
    try {
      while (await this.story.follow());
    } catch (error) {
      return this.lost(error);
    }
    this.timeline.refresh();
    // The time may have changed before the response arrived.
    if (this.t >= end && !this.playing) this.t = this.story.now;
    this.redraw();
    if (this.story.over) return;
    const wait = this.isHurried ? 0 : this.control ? FOLLOW_CLOSELY : FOLLOW_EVERY;
    this.next = setTimeout(() => this.follow(), wait);
  }

  frame(now) {
    requestAnimationFrame((next) => this.frame(next));
    if (this.playing) {
      const passed = this.last === null ? 0 : Math.min(now - this.last, 250);
      this.last = now;
      this.clock += passed / 1000;
      this.t += passed * 1000 * this.speed;
      if (this.t >= this.story.now) {
        this.t = this.story.now;
        if (this.story.over) this.setPlaying(false);
      }
      this.stale = true;
    } else if (!this.dirty) {
      this.drawnAt = null;
      return;
    }
    if ((this.moving || this.playing) && this.drawnAt !== null) this.adapt(now - this.drawnAt);
    this.drawnAt = now;
    this.show();
  }

  /**
   * Draws less on a slow machine while things move: first no shadows of moving bodies, then fewer pixels.
   * `passed` is the time from one picture to the next. One step speeds a picture up by less than a factor of
   * two, so the limits for slower and faster are that far apart.
   */
  adapt(passed) {
    this.passed = passed;
    if (passed > 50) this.late += passed > 100 ? 2 : 1;
    else if (passed < 25) this.late -= 0.1;
    if (this.late >= 4) {
      this.late = 0;
      if (this.playing && !this.plain) this.plain = true;
      else this.scale = Math.max(0.5, this.scale * 0.8);
    } else if (this.late <= -4) {
      this.late = 0;
      if (this.scale < 1) this.scale = Math.min(1, this.scale / 0.8);
      else this.plain = false;
    }
  }

  /** Sets the quality: as fast as needed in motion, as fine as possible at rest. */
  quality() {
    const { renderer } = this;
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    clearTimeout(this.rested);
    if (this.playing || this.moving) {
      renderer.sharpness = ratio * this.scale;
      // Shadows are repainted only after bodies have moved.
      renderer.shadows = !(this.playing && this.plain);
      if (this.playing) return;
      // If pictures take long, the next input may be late too.
      const rest = Math.min(200 + 4 * this.passed, 2000);
      this.rested = setTimeout(() => {
        this.moving = false;
        this.dirty = true;
      }, rest);
    } else {
      renderer.sharpness = renderer.slow ? Math.max(ratio, 2) : ratio;
      renderer.shadows = true;
    }
  }

  show() {
    this.dirty = false;
    this.quality();
    const options = { meaning: this.meaning, ...this.look.options(), chosen: this.chosen, classes: this.timeline.shown };
    if (this.stale) {
      this.seen = this.picture.build(this.t, options);
      this.look.follow(this.chosen);
    }
    this.picture.draw(this.camera, this.clock);
    this.look.note(this.t);
    // Text is read more slowly than pictures, so it changes less often.
    const told = !this.playing || this.clock - this.said > 0.1 || this.clock < this.said;
    if (this.stale) {
      this.timeline.draw(this.t);
      if (told) this.say(this.seen);
    }
    this.stale = false;
  }

  /** Updates all texts about the picture. */
  say(seen) {
    this.said = this.clock;
    const time = by("time");
    time.textContent = `${(this.t / 1e6).toFixed(2)} s of ${(this.story.now / 1e6).toFixed(2)} s`;
    time.dataset.micros = Math.round(this.t);
    const scrub = by("scrub");
    scrub.max = this.story.now;
    scrub.value = this.t;
    scrub.setAttribute("aria-valuetext", time.textContent);
    this.panel.outcome();
    this.panel.numbers(this.t, seen);
    this.panel.requests(this.t);
    this.panel.legend(this.meaning, seen);
    this.panel.faults();
    this.hosts.show(this.t, seen.talk ?? (this.story.scene.hosts && this.story.scene.messages ? this.story.talkAt(this.t) : null));
    this.panel.module(this.chosen, this.t, seen);
    this.panel.moves(this.chosen, this.t);
    // While a run is played its messages are asked for less often than pictures are drawn.
    const since = performance.now() - this.heard;
    if (this.chosen !== null && (!this.playing || since > MESSAGES_EVERY)) {
      this.heard = performance.now();
      this.panel.messages(this.chosen, this.t).catch((error) => this.lost(error));
    }
    document.body.dataset.circle = [...seen.circle].join(" ");
  }
}

const story = new Story();
try {
  await story.begin();
  const page = new Page(story);
  // For the console of the browser.
  Object.assign(window, { page });
  page.setPlaying(false);
} catch (error) {
  document.body.dataset.state = "failed";
  by("outcome").textContent = "not shown";
  by("note").hidden = false;
  by("note").textContent = `The page cannot be shown: ${error.message}`;
  throw error;
}
