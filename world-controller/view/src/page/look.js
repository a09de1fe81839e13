// What is shown of the swarm and from where: the controls over the picture, and the notes on it.

import { Section } from "./cells.js";
import { drawLegend, drawNotes, drawTime, legendHeight } from "./overlay.js";
import { by, make } from "./dom.js";
import { VIEWS } from "./viewpoint.js";

/** The sections: an axis, and whether cells above the plane are kept. */
const SECTIONS = { none: null, "x ≤": [0, false], "x ≥": [0, true], "y ≤": [1, false], "y ≥": [1, true], "z ≤": [2, false], "z ≥": [2, true] };
/** Pictures that are saved have this many pixels in one of the page. */
const SAVED = 2;

const next = (list, one) => list[(list.indexOf(one) + 1) % list.length];

export class Look {
  constructor({ story, camera, picture, redraw }) {
    this.story = story;
    this.camera = camera;
    this.picture = picture;
    this.redraw = redraw;
    this.noted = "";
    by("view").append(...Object.keys(VIEWS).map((name) => make("option", { value: name }, name)));
    by("section").append(...Object.keys(SECTIONS).map((name) => make("option", { value: name }, name)));
    for (const id of ["messages", "waits", "goal", "only", "notes", "follow"]) by(id).addEventListener("change", redraw);
    by("view").addEventListener("change", (e) => this.setView(e.target.value));
    by("parallel").addEventListener("change", (e) => camera.setParallel(e.target.checked));
    by("section").addEventListener("change", (e) => this.setSection(e.target.value));
    by("cut").addEventListener("input", redraw);
    // On a narrow page the controls would leave little room for the picture. On a wide one they cannot be hidden.
    const narrow = matchMedia("(max-width: 1100px)");
    const fold = () => (by("shown").open = !narrow.matches);
    narrow.addEventListener("change", fold);
    fold();
    this.tellView();
  }

  /** Returns the options of `Picture.build` that are set here. */
  options() {
    const section = this.section();
    const checked = (id) => by(id).checked;
    return {
      messages: checked("messages"),
      waits: checked("waits"),
      goal: checked("goal"),
      only: checked("only") ? "goal" : "all",
      sections: section ? [section] : [],
    };
  }

  section() {
    const kept = SECTIONS[by("section").value];
    return kept && new Section(...kept, Number(by("cut").value));
  }

  setSection(name) {
    by("section").value = name;
    const kept = SECTIONS[name];
    by("plane").hidden = !kept;
    if (kept) {
      const { low, high } = this.picture.bounds;
      const cut = by("cut");
      cut.min = Math.floor(low[kept[0]] + 0.5);
      cut.max = Math.ceil(high[kept[0]] - 0.5);
      cut.value = Math.round((Number(cut.min) + Number(cut.max)) / 2);
    }
    this.redraw();
  }

  nextSection() {
    this.setSection(next(Object.keys(SECTIONS), by("section").value));
  }

  moveSection(cells) {
    by("cut").value = Number(by("cut").value) + cells;
    this.redraw();
  }

  setView(name) {
    if (VIEWS[name]) this.fit(VIEWS[name]);
  }

  nextView() {
    this.setView(next(Object.keys(VIEWS), by("view").value));
  }

  fit(direction) {
    const canvas = by("space");
    this.camera.aspect = canvas.clientWidth / Math.max(canvas.clientHeight, 1);
    this.camera.fit(this.picture.bounds.points, direction);
  }

  /** Names the view, and the section. */
  tellView() {
    const name = this.camera.name() ?? "";
    if (by("view").value !== name) by("view").value = name;
    const section = this.section();
    if (section) by("cut-at").textContent = `${section.last}`;
  }

  /** Moves with a module. */
  follow(id) {
    by("follow").disabled = id === null;
    if (id === null || !by("follow").checked) return;
    const poses = this.picture.poses[id];
    const parts = poses.length / 7;
    this.camera.follow([0, 1, 2].map((k) => poses.reduce((sum, x, i) => (i % 7 === k ? sum + x / parts : sum), 0)));
  }

  time(t) {
    return `${(t / 1e6).toFixed(2)} s`;
  }

  /** Writes the notes on the picture. Axes and scale are drawn only after they have changed. */
  note(t) {
    this.tellView();
    const shown = by("notes").checked;
    by("stamp").hidden = !shown;
    by("stamp").textContent = this.time(t);
    const canvas = by("overlay");
    canvas.hidden = !shown;
    const { camera } = this;
    const height = by("space").clientHeight;
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    const key = [height, ratio, camera.azimuth, camera.height, camera.distance, document.documentElement.dataset.theme].join();
    if (!shown || this.noted === key) return;
    this.noted = key;
    const [width, tall] = [canvas.clientWidth, canvas.clientHeight];
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(tall * ratio);
    const paint = canvas.getContext("2d");
    paint.setTransform(ratio, 0, 0, ratio, 0, 0);
    drawNotes(paint, { x: width, y: tall, height, style: getComputedStyle(canvas), viewpoint: camera });
  }

  /** Returns the picture as it is, with its notes and the entries of the legend, as a PNG. */
  async screen(renderer, draw, { t, entries }) {
    const space = by("space");
    const [width, height] = [space.clientWidth, space.clientHeight];
    const style = getComputedStyle(by("overlay"));
    const below = legendHeight(width, style, entries);
    const canvas = make("canvas", { width: width * SAVED, height: (height + below) * SAVED });
    const paint = canvas.getContext("2d");
    const { sharpness } = renderer;
    renderer.sharpness = SAVED;
    draw();
    paint.drawImage(space, 0, 0, width * SAVED, height * SAVED);
    renderer.sharpness = sharpness;
    paint.setTransform(SAVED, 0, 0, SAVED, 0, 0);
    if (by("notes").checked) {
      drawNotes(paint, { x: width, y: height, height, style, viewpoint: this.camera });
      drawTime(paint, { width, style, time: this.time(t) });
    }
    drawLegend(paint, { top: height, width, style, entries });
    const content = await new Promise((done) => canvas.toBlob(done, "image/png"));
    const name = this.story.scene.title.replaceAll(/[^A-Za-z0-9.-]+/g, "-");
    return { name: `${name}-${Number((t / 1e6).toFixed(3))}s.png`, content };
  }
}
