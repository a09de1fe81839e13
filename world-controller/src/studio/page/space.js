// The drawing in space: cubes, modules, ghosts, cursor, mirrors, and what the pointer points at.

import * as three from "./vendor/three.js";
import { bounds, cell, key, outside, plus } from "./cells.js";

/** @typedef {import("./cells.js").Cell} Cell */
/** @typedef {{ at: Cell, face: Cell, onCube: boolean, lift?: number }} Hit what the pointer points at: the cell to fill, and the
 *  direction from the cell (or the floor) behind it; of a stroke, also where the face is, seen from the middle of `at` */

const VERTEX = `
uniform mat4 projectionMatrix, modelViewMatrix;
in vec3 position, normal, instanceColor;
in mat4 instanceMatrix;
out vec3 colour, place, extent;
out float light;
void main() {
  extent = vec3(length(instanceMatrix[0]), length(instanceMatrix[1]), length(instanceMatrix[2]));
  place = position * extent;
  colour = instanceColor;
  light = 0.88 + 0.16 * normal.z - 0.06 * normal.y - 0.16 * max(normal.x, 0.0) - 0.1 * max(-normal.z, 0.0);
  gl_Position = projectionMatrix * modelViewMatrix * instanceMatrix * vec4(position, 1.0);
}`;
const FRAGMENT = `
precision highp float;
in vec3 colour, place, extent;
in float light;
uniform float opacity;
uniform vec3 edge;
out vec4 pixel;
void main() {
  vec3 far = 0.5 * extent - abs(place);
  float low = min(far.x, min(far.y, far.z)), high = max(far.x, max(far.y, far.z));
  float middle = far.x + far.y + far.z - low - high;
  // Of a module, the seam between its two cells.
  float longest = max(extent.x, max(extent.y, extent.z));
  float along = extent.x == longest ? place.x : (extent.y == longest ? place.y : place.z);
  if (longest > 1.5) middle = min(middle, abs(along) + 0.012);
  float width = max(fwidth(middle), 0.001);
  float line = 1.0 - smoothstep(0.02, 0.02 + 1.4 * width, middle);
  pixel = vec4(mix(colour * light, edge, 0.75 * line), opacity);
}`;

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

/** Colours of the picture by the style sheet, so that light and dark are in one place. */
function palette() {
  const style = getComputedStyle(document.documentElement);
  const of = (name) => new three.Color(style.getPropertyValue(name).trim());
  return Object.fromEntries(["sky", "cube", "edge", "grid", "axis", "left", "add", "remove", "selected", "mirror", "along-x", "along-y", "along-z", "cursor", "reason", "touch"].map((n) => [n, of(`--${n}`)]));
}

/** Boxes of one look: many in one call. */
class Boxes {
  constructor(scene, opacity = 1) {
    this.material = new three.RawShaderMaterial({
      vertexShader: VERTEX, fragmentShader: FRAGMENT, glslVersion: three.GLSL3,
      uniforms: { opacity: { value: opacity }, edge: { value: new three.Color(0) } },
      transparent: opacity < 1, depthWrite: opacity === 1,
    });
    [this.scene, this.room, this.mesh] = [scene, 0, null];
    this.geometry = new three.BoxGeometry(1, 1, 1);
  }

  /** @param {number} count @param {(i: number, set: (centre: number[], size: number[], colour: any) => void) => void} each */
  fill(count, each) {
    if (count > this.room || !this.mesh) {
      if (this.mesh) {
        this.scene.remove(this.mesh);
        this.mesh.dispose();
      }
      this.room = Math.max(64, 2 ** Math.ceil(Math.log2(Math.max(count, 1))));
      this.mesh = new three.InstancedMesh(this.geometry, this.material, this.room);
      this.mesh.instanceColor = new three.InstancedBufferAttribute(new Float32Array(3 * this.room), 3);
      this.mesh.frustumCulled = false;
      this.scene.add(this.mesh);
    }
    const matrix = new three.Matrix4();
    const [places, colours] = [this.mesh.instanceMatrix.array, this.mesh.instanceColor.array];
    for (let i = 0; i < count; i++) {
      each(i, (centre, size, colour) => {
        matrix.makeScale(size[0], size[1], size[2]).setPosition(centre[0], centre[1], centre[2]).toArray(places, 16 * i);
        colour.toArray(colours, 3 * i);
      });
    }
    this.mesh.count = count;
    this.mesh.instanceMatrix.needsUpdate = true;
    this.mesh.instanceColor.needsUpdate = true;
    this.mesh.boundingSphere = null;
  }
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
    [this.cubes, this.modules, this.ghosts] = [new Boxes(this.scene), new Boxes(this.scene), new Boxes(this.scene, 0.5)];
    /** What the picture shows: `cubes`, `modules`, or `both` side by side. */
    this.mode = "modules";
    /** @type {[Cell, Cell][]} the modules, in the order of building; `shown` of them are drawn */
    this.pairs = [];
    this.shown = Infinity;
    /** @type {Cell[]} */
    this.left = [];
    /** @type {{ add: Cell[], remove: Cell[], cells: Cell[], near: Cell[] }} */
    this.marks = { add: [], remove: [], cells: [], near: [] };
    this.wires();
    /** @type {Set<number> | null} the cells that are drawn, until the drawing changes, and in the order of their boxes */
    this.open = null;
    /** @type {Cell[]} */
    this.order = [];
    this.frames = 0;
    this.asked = false;
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
    for (const boxes of [this.cubes, this.modules, this.ghosts]) boxes.material.uniforms.edge.value = this.colours.edge;
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
    const b = bounds(this.structure.list()) ?? { low: [-1, -1, 0], high: [1, 1, 1] };
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
    [this.pairs, this.left] = [pairs, left];
    this.redraw();
  }

  redraw() {
    this.stale = true;
    this.ask();
  }

  /** Asks for a frame. */
  ask() {
    if (this.asked) return;
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
    const { cells, selected, cursor } = this.structure;
    // What is enclosed by others on all sides is neither seen nor pointed at.
    if (!this.open) {
      this.open = outside(cells);
      this.order = [...this.open].map(cell);
    }
    const { open } = this;
    const left = new Set(this.left.map(key));
    const [reason, near] = [new Set(this.marks.cells.map(key)), new Set(this.marks.near.map(key))];
    const colourOf = (c, plain) => {
      const k = key(c);
      if (reason.has(k)) return this.colours.reason;
      if (near.has(k)) return this.colours.touch;
      if (selected.has(k)) return this.colours.selected;
      return left.has(k) ? this.colours.left : plain;
    };
    this.cubes.fill(this.order.length, (i, set) => set(this.order[i], [0.98, 0.98, 0.98], colourOf(this.order[i], this.colours.cube)));
    // A pair that has lost a cell since it was computed, and a cell without a pair, are drawn as cubes.
    const isWhole = this.shown >= this.pairs.length;
    const there = this.pairs.filter(([a, b]) => this.structure.has(a) && this.structure.has(b));
    // While modules are put together one sees into the drawing.
    const isSeen = isWhole ? ([a, b]) => open.has(key(a)) || open.has(key(b)) : () => true;
    const pairs = (isWhole ? there : this.pairs.slice(0, this.shown).filter(([a, b]) => this.structure.has(a) && this.structure.has(b))).filter(isSeen);
    const paired = new Set(there.flatMap(([a, b]) => [key(a), key(b)]));
    const single = isWhole ? this.order.filter((c) => !paired.has(key(c))) : [];
    const along = [this.colours["along-x"], this.colours["along-y"], this.colours["along-z"]];
    this.modules.fill(pairs.length + single.length, (i, set) => {
      if (i < pairs.length) {
        const [a, b] = pairs[i];
        const axis = a.findIndex((v, n) => v !== b[n]);
        const size = [0.94, 0.94, 0.94];
        size[axis] = 1.94;
        set(a.map((v, n) => (v + b[n]) / 2), size, [a, b].map((c) => colourOf(c, null)).find(Boolean) ?? along[axis]);
      } else {
        const c = single[i - pairs.length];
        set(c, [0.94, 0.94, 0.94], colourOf(c, this.colours.cube));
      }
    });
    const ghosts = [...this.marks.add.map((c) => [c, this.colours.add]), ...this.marks.remove.map((c) => [c, this.colours.remove])];
    this.ghosts.fill(ghosts.length, (i, set) => set(ghosts[i][0], [1.03, 1.03, 1.03], ghosts[i][1]));
    this.cursor.position.set(...cursor);
    this.drawFloor();
  }

  drawFloor() {
    const { floor, high } = this.extent();
    const [x0, y0, x1, y1] = [floor.low[0] - 0.5, floor.low[1] - 0.5, floor.high[0] + 0.5, floor.high[1] + 0.5];
    this.floor = { x0, y0, x1, y1 };
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
    this.ray.setFromCamera(new three.Vector2(2 * u - 1, 1 - (2 * (y - frame.top)) / frame.height), this.camera);
  }

  /** What is at a place of the page: a cube, or the floor; null beside it. @returns {Hit | null} */
  pick(x, y) {
    if (this.stale) this.frame();
    this.aim(x, y);
    const [hit] = this.ray.intersectObject(this.cubes.mesh, false);
    if (hit && hit.instanceId !== undefined) {
      const face = /** @type {Cell} */ (hit.face.normal.toArray().map(Math.round));
      return { at: plus(this.order[hit.instanceId], face), face, onCube: true };
    }
    const floor = this.ray.ray.intersectPlane(new three.Plane(new three.Vector3(0, 0, 1), 0.5), new three.Vector3());
    if (!floor || floor.x < this.floor.x0 || floor.x > this.floor.x1 || floor.y < this.floor.y0 || floor.y > this.floor.y1) return null;
    return { at: [Math.round(floor.x), Math.round(floor.y), 0], face: [0, 0, 1], onCube: false };
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
    const v = new three.Vector3(...at).project(this.camera);
    return { x: frame.left + ((v.x + 1) / 2) * frame.width, y: frame.top + ((1 - v.y) / 2) * frame.height };
  }
}
