// The drawing in space: cubes, modules, ghosts, cursor, mirrors, and what the pointer points at.

import * as three from "./vendor/three.js";
import { BESIDE, cell, firstOn, key, outside, plus } from "./cells.js";
import { Faces } from "./faces.js";

/** @typedef {import("./cells.js").Cell} Cell */
/** @typedef {{ at: Cell, face: Cell, onCube: boolean, lift?: number }} Hit what the pointer points at: the cell to fill, and the
 *  direction from the cell (or the floor) behind it; of a stroke, also where the face is, seen from the middle of `at` */

/** True if pictures are drawn by the processor, where smooth outlines take several times as long. */
function isSoftware() {
  const context = document.createElement("canvas").getContext("webgl2");
  const about = context?.getExtension("WEBGL_debug_renderer_info");
  const name = about ? String(context.getParameter(about.UNMASKED_RENDERER_WEBGL)) : "";
  context?.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|software|basic render/i.test(name);
}

// Colours are those of the style sheet, as they are.
three.ColorManagement.enabled = false;

/** The axis along which two cells touch. @param {number} a @param {number} b */
const axisOf = (a, b) => BESIDE.findIndex((by) => Math.abs(by) === Math.abs(b - a)) >> 1;

/** Colours of the picture by the style sheet, so that light and dark are in one place. */
function palette() {
  const style = getComputedStyle(document.documentElement);
  const of = (name) => new three.Color(style.getPropertyValue(name).trim());
  return Object.fromEntries(["sky", "cube", "edge", "grid", "axis", "left", "add", "remove", "selected", "mirror", "along-x", "along-y", "along-z", "cursor", "reason", "touch"].map((n) => [n, of(`--${n}`)]));
}

export class Space {
  /** @param {HTMLCanvasElement} canvas @param {import("./structure.js").Structure} structure */
  constructor(canvas, structure) {
    [this.canvas, this.structure] = [canvas, structure];
    this.renderer = new three.WebGLRenderer({ canvas, antialias: !isSoftware() });
    this.renderer.outputColorSpace = three.LinearSRGBColorSpace;
    this.renderer.autoClear = false;
    this.scene = new three.Scene();
    this.camera = new three.PerspectiveCamera(32, 1, 0.1, 4000);
    this.camera.up.set(0, 0, 1);
    this.controls = new three.OrbitControls(this.camera, canvas);
    this.controls.mouseButtons = { LEFT: null, MIDDLE: three.MOUSE.ROTATE, RIGHT: null };
    this.controls.touches = { ONE: null, TWO: three.TOUCH.DOLLY_ROTATE };
    this.controls.minDistance = 3;
    this.controls.maxDistance = 2000;
    this.controls.addEventListener("change", () => this.ask());
    this.ray = new three.Raycaster();
    [this.cubes, this.modules, this.ghosts] = [new Faces(this.scene), new Faces(this.scene), new Faces(this.scene, 1.03, 0.5)];
    /** What the picture shows: `cubes`, `modules`, or `both` side by side. */
    this.mode = "modules";
    /** @type {[Cell, Cell][]} the modules, in the order of building; `shown` of them are drawn */
    this.pairs = [];
    this.shown = Infinity;
    /** The cells without a partner, and the partners of the others. */
    this.left = new Set();
    /** @type {Map<number, number>} */
    this.partner = new Map();
    /** @type {{ add: Cell[], remove: Cell[] }} what is drawn as ghosts */
    this.marks = { add: [], remove: [] };
    /** The cells of a reason, and those that they touch. */
    this.marked = { cells: new Set(), near: new Set() };
    this.wires();
    /** @type {Set<number> | null} the cells that others do not enclose, until the drawing changes */
    this.open = null;
    this.frames = 0;
    this.asked = false;
    /** True while no frame is drawn. */
    this.held = false;
    this.theme();
    new ResizeObserver(() => this.resize()).observe(canvas);
    structure.addEventListener("change", () => {
      this.open = null;
      this.redraw();
    });
    structure.addEventListener("look", () => this.redraw());
    this.preset("iso");
  }

  wires() {
    const lines = (colour) => new three.LineSegments(new three.BufferGeometry(), new three.LineBasicMaterial({ color: colour }));
    [this.grid, this.axes, this.cursor] = [lines(0), lines(0), lines(0)];
    const box = new three.EdgesGeometry(new three.BoxGeometry(1.06, 1.06, 1.06));
    this.cursor.geometry = box;
    this.mirrors = [0, 1].map(() => new three.Mesh(new three.PlaneGeometry(1, 1), new three.MeshBasicMaterial({ transparent: true, opacity: 0.16, side: three.DoubleSide, depthWrite: false })));
    this.scene.add(this.grid, this.axes, this.cursor, ...this.mirrors);
  }

  theme() {
    this.colours = palette();
    for (const faces of [this.cubes, this.modules, this.ghosts]) faces.material.uniforms.edge.value = this.colours.edge;
    this.grid.material.color = this.colours.grid;
    this.axes.material.color = this.colours.axis;
    this.cursor.material.color = this.colours.cursor;
    for (const mirror of this.mirrors) mirror.material.color = this.colours.mirror;
    this.renderer.setClearColor(this.colours.sky);
    this.redraw();
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!width || !height) return;
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.renderer.setSize(width, height, false);
    this.ask();
  }

  /** The corners of what is drawn and of the floor around it. */
  extent() {
    const b = this.structure.bounds() ?? { low: [-1, -1, 0], high: [1, 1, 1] };
    return { ...b, floor: { low: [Math.min(b.low[0] - 3, -4), Math.min(b.low[1] - 3, -4)], high: [Math.max(b.high[0] + 3, 4), Math.max(b.high[1] + 3, 4)] } };
  }

  /** Looks from a direction at the whole drawing. @param {string} name */
  preset(name) {
    const b = this.extent();
    const centre = b.low.map((v, i) => (v + b.high[i]) / 2);
    const size = Math.max(4, ...b.high.map((v, i) => v - b.low[i] + 1));
    const from = { iso: [0.8, -1.25, 0.8], front: [0, -1, 0.12], side: [1, 0, 0.12], top: [0, -0.001, 1] }[name] ?? [0.8, -1.25, 0.8];
    const halves = this.mode === "both" ? 2 : 1;
    const narrow = Math.min(1, this.canvas.clientWidth / halves / Math.max(1, this.canvas.clientHeight));
    const far = (2.6 * size + 3) / (narrow || 1) / Math.hypot(...from);
    this.controls.target.set(...centre);
    this.camera.position.set(...centre.map((v, i) => v + from[i] * far));
    this.controls.update();
    this.ask();
  }

  /** Turns the camera about the drawing and comes nearer. @param {number} right @param {number} up @param {number} nearer */
  turn(right, up, nearer = 1) {
    const ball = new three.Spherical();
    const arm = this.camera.position.clone().sub(this.controls.target);
    const y = new three.Quaternion().setFromUnitVectors(this.camera.up, new three.Vector3(0, 1, 0));
    ball.setFromVector3(arm.applyQuaternion(y));
    ball.theta += right;
    ball.phi = Math.min(Math.max(ball.phi - up, 0.05), Math.PI - 0.05);
    ball.radius = Math.min(Math.max(ball.radius / nearer, this.controls.minDistance), this.controls.maxDistance);
    this.camera.position.copy(this.controls.target).add(new three.Vector3().setFromSpherical(ball).applyQuaternion(y.invert()));
    this.controls.update();
    this.ask();
  }

  /** Shows an answer of the server. @param {[Cell, Cell][]} pairs @param {Cell[]} left */
  show(pairs, left) {
    [this.pairs, this.left, this.partner] = [pairs, new Set(left.map(key)), new Map()];
    for (const pair of pairs) {
      const [a, b] = pair.map(key);
      this.partner.set(a, b).set(b, a);
    }
    this.redraw();
  }

  /** The other cell of the module of a cell, as far as is known. @param {Cell} c @returns {Cell | null} */
  partnerOf(c) {
    const other = this.partner.get(key(c));
    return other === undefined ? null : cell(other);
  }

  redraw() {
    this.stale = true;
    this.ask();
  }

  /** Asks for a frame. */
  ask() {
    if (this.asked || this.held) return;
    this.asked = true;
    requestAnimationFrame(() => this.frame());
  }

  frame() {
    this.asked = false;
    if (this.stale) this.rebuild();
    this.stale = false;
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!width || !height) return;
    this.renderer.setScissorTest(false);
    this.renderer.clear();
    const halves = this.mode === "both" ? ["cubes", "modules"] : [this.mode];
    halves.forEach((mode, i) => {
      const part = width / halves.length;
      this.camera.aspect = part / height;
      this.camera.updateProjectionMatrix();
      this.renderer.setViewport(i * part, 0, part, height);
      this.renderer.setScissor(i * part, 0, part, height);
      this.renderer.setScissorTest(true);
      this.cubes.mesh.visible = mode === "cubes";
      this.modules.mesh.visible = mode === "modules";
      this.renderer.render(this.scene, this.camera);
    });
    this.frames += 1;
  }

  rebuild() {
    const { cells } = this.structure;
    this.open ??= outside(cells);
    const plain = [...this.open].map((k) => ({ key: k, pinned: this.structure.pins.has(k), colour: this.colourOf(k) ?? this.colours.cube }));
    if (this.mode !== "modules") this.cubes.fill(plain, cells);
    if (this.mode !== "cubes") this.fillModules();
    const ghosts = /** @type {[Cell[], any][]} */ ([[this.marks.add, this.colours.add], [this.marks.remove, this.colours.remove]]);
    const drawn = ghosts.flatMap(([list, colour]) => list.map((c) => ({ key: key(c), colour })));
    this.ghosts.fill(drawn, new Set(drawn.map((one) => one.key)));
    this.cursor.position.set(...this.structure.cursor);
    this.drawFloor();
  }

  fillModules() {
    const { cells } = this.structure;
    const isWhole = this.shown >= this.pairs.length;
    // While modules are put together one sees into the drawing.
    const filled = isWhole ? cells : new Set(this.pairs.slice(0, this.shown).flatMap((pair) => pair.map(key)).filter((k) => cells.has(k)));
    const seen = isWhole ? this.open : outside(filled);
    const along = [this.colours["along-x"], this.colours["along-y"], this.colours["along-z"]];
    const drawn = [...seen].map((k) => {
      // A pair that has lost a cell since it was computed, and a cell without a pair, are drawn as cubes.
      const partner = this.partner.get(k);
      if (partner === undefined || !filled.has(partner)) return { key: k, colour: this.colourOf(k) ?? this.colours.cube };
      return { key: k, partner, pinned: this.structure.pins.get(k) === partner, colour: this.colourOf(k) ?? this.colourOf(partner) ?? along[axisOf(k, partner)] };
    });
    this.modules.fill(drawn, filled);
  }

  /** The colour of a cell that is marked, chosen or left over. */
  colourOf(k) {
    if (this.marked.cells.has(k)) return this.colours.reason;
    if (this.marked.near.has(k)) return this.colours.touch;
    if (this.structure.selected.has(k)) return this.colours.selected;
    return this.left.has(k) ? this.colours.left : null;
  }

  drawFloor() {
    const { floor, high } = this.extent();
    const [x0, y0, x1, y1] = [floor.low[0] - 0.5, floor.low[1] - 0.5, floor.high[0] + 0.5, floor.high[1] + 0.5];
    const points = [];
    for (let x = x0; x <= x1; x++) points.push(x, y0, -0.5, x, y1, -0.5);
    for (let y = y0; y <= y1; y++) points.push(x0, y, -0.5, x1, y, -0.5);
    this.grid.geometry.setAttribute("position", new three.BufferAttribute(new Float32Array(points), 3));
    this.grid.geometry.computeBoundingSphere();
    // A shadow of the cursor on the floor says where it is.
    const [x, y] = this.structure.cursor;
    const shadow = [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]].flatMap(([a, b], i, all) => [x + a, y + b, -0.49, x + all[(i + 1) % 4][0], y + all[(i + 1) % 4][1], -0.49]);
    this.axes.geometry.setAttribute("position", new three.BufferAttribute(new Float32Array(shadow), 3));
    this.axes.geometry.computeBoundingSphere();
    this.mirrors.forEach((mirror, axis) => {
      mirror.visible = this.structure.mirror[axis] !== "off";
      const middle = this.structure.middle[axis] / 2;
      const tall = high[2] + 2;
      if (axis === 0) {
        mirror.rotation.set(Math.PI / 2, Math.PI / 2, 0);
        mirror.position.set(middle, (y0 + y1) / 2, tall / 2 - 0.5);
        mirror.scale.set(y1 - y0, tall, 1);
      } else {
        mirror.rotation.set(Math.PI / 2, 0, 0);
        mirror.position.set((x0 + x1) / 2, middle, tall / 2 - 0.5);
        mirror.scale.set(x1 - x0, tall, 1);
      }
    });
  }

  /** Points the ray at a place of the page. */
  aim(x, y) {
    const frame = this.canvas.getBoundingClientRect();
    const halves = this.mode === "both" ? 2 : 1;
    const part = frame.width / halves;
    const u = ((x - frame.left) % part) / part;
    this.camera.updateMatrixWorld();
    this.ray.setFromCamera(new three.Vector2(2 * u - 1, 1 - (2 * (y - frame.top)) / frame.height), this.camera);
  }

  /** What is at a place of the page: a cube, or the floor; null beside it. @returns {Hit | null} */
  pick(x, y) {
    this.aim(x, y);
    const { origin, direction } = this.ray.ray;
    const box = this.structure.bounds();
    const hit = box && firstOn(origin.toArray(), direction.toArray(), this.structure.cells, box);
    if (hit) return { at: plus(hit.at, hit.face), face: hit.face, onCube: true };
    const at = this.ray.ray.intersectPlane(new three.Plane(new three.Vector3(0, 0, 1), 0.5), new three.Vector3());
    const { floor } = this.extent();
    const isOn = (v, i) => v >= floor.low[i] - 0.5 && v <= floor.high[i] + 0.5;
    if (!at || !isOn(at.x, 0) || !isOn(at.y, 1)) return null;
    return { at: [Math.round(at.x), Math.round(at.y), 0], face: [0, 0, 1], onCube: false };
  }

  /** The cell of the layer through `hit`, across its face, that is at a place of the page. @param {Hit} hit @returns {Cell | null} */
  across(hit, x, y) {
    this.aim(x, y);
    const normal = new three.Vector3(...hit.face);
    const plane = new three.Plane().setFromNormalAndCoplanarPoint(normal, new three.Vector3(...hit.at.map((v, i) => v + hit.lift * hit.face[i])));
    const at = this.ray.ray.intersectPlane(plane, new three.Vector3());
    if (!at) return null;
    return /** @type {Cell} */ (at.toArray().map((v, i) => (hit.face[i] ? hit.at[i] : Math.round(v))));
  }

  /** Where a cell is on the page, for tests. @param {number[]} at */
  project(at) {
    const frame = this.canvas.getBoundingClientRect();
    this.camera.updateMatrixWorld();
    const v = new three.Vector3(...at).project(this.camera);
    return { x: frame.left + ((v.x + 1) / 2) * frame.width, y: frame.top + ((1 - v.y) / 2) * frame.height };
  }
}
