// Draws with three.js: parts of bodies as instances of one shape, ribbons between points, a ground with shadows.
// Independent of swarms. Draws only on request.

import {
  BackSide,
  BufferAttribute,
  BufferGeometry,
  ColorManagement,
  Color,
  DoubleSide,
  FrontSide,
  GLSL3,
  LineSegments,
  LinearSRGBColorSpace,
  Mesh,
  RawShaderMaterial,
  RedFormat,
  Scene,
  Vector3,
  Vector4,
  WebGLRenderTarget,
  WebGLRenderer,
} from "./vendor/three.js";
import { EVERYWHERE, Parts, Ribbons } from "./instances.js";
import {
  FLAT_FRAGMENT,
  GROUND_FRAGMENT,
  GROUND_VERTEX,
  PARTS_FRAGMENT,
  PARTS_VERTEX,
  RIBBON_FRAGMENT,
  RIBBON_VERTEX,
  SHADOW_FRAGMENT,
  SHADOW_VERTEX,
} from "./shaders.js";

// Colours are those of the style sheet, without conversion.
ColorManagement.enabled = false;

/** Side of the texture of shadows, in pixels. */
const SHADE = 1024;
/** The direction towards the light. */
const LIGHT = [0.45, -0.55, 1];

/** What is drawn later is drawn over what was drawn before, where both are transparent. */
const ORDER = { ground: 0, links: 1, ghosts: 2, glow: 3, marks: 4 };

/** Returns true if there is no graphics card. */
function isSoftware() {
  const gl = document.createElement("canvas").getContext("webgl2");
  if (!gl) return false;
  const info = gl.getExtension("WEBGL_debug_renderer_info");
  const name = info ? gl.getParameter(info.UNMASKED_RENDERER_WEBGL) : "";
  gl.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|software|softpipe/i.test(name);
}

const still = (object) => {
  object.frustumCulled = false;
  object.matrixAutoUpdate = object.matrixWorldAutoUpdate = false;
  return object;
};

export class Renderer {
  constructor(canvas) {
    // Without a graphics card antialiasing is too slow while bodies move; a picture at rest is drawn with
    // more pixels instead.
    this.slow = isSoftware();
    const context = canvas.getContext("webgl2", { alpha: false, antialias: !this.slow });
    if (!context) throw new Error("this browser has no WebGL 2. `metamorph render` draws the same run without a browser, from its scenario or its journal");
    this.canvas = canvas;
    this.three = new WebGLRenderer({ canvas, context });
    this.three.outputColorSpace = LinearSRGBColorSpace;
    this.scene = still(new Scene());
    this.shadowScene = still(new Scene());
    this.sharpness = 1;
    this.shadows = true;
    /** True if the shadows match the parts. */
    this.shaded = false;
    const shared = { eyeAt: new Vector4(), eye: new Vector3(), light: new Vector3(...LIGHT), ambient: 1, clock: 0, pixel: 0 };
    /** @type {Record<string, { value: any }>} */
    this.shared = Object.fromEntries(Object.entries(shared).map(([name, value]) => [name, { value }]));
    this.shade = new WebGLRenderTarget(SHADE, SHADE, { format: RedFormat, depthBuffer: false });
    this.makeGround();
    this.links = this.ribbons(true);
    this.marks = this.ribbons(false);
  }

  /** The context of the canvas, for measurements. */
  get gl() {
    return this.three.getContext();
  }

  material(vertexShader, fragmentShader, uniforms, how) {
    const own = Object.fromEntries(Object.entries(uniforms).map(([name, value]) => [name, { value }]));
    return new RawShaderMaterial({ glslVersion: GLSL3, vertexShader, fragmentShader, uniforms: { ...this.shared, ...own }, ...how });
  }

  makeGround() {
    const uniforms = { bounds: new Vector4(), ground: 0, plates: false, fill: new Vector4(), line: new Vector4(), shade: this.shade.texture, shadow: 0 };
    const material = this.material(GROUND_VERTEX, GROUND_FRAGMENT, uniforms, { transparent: true, depthWrite: false });
    const quad = new BufferGeometry();
    quad.setAttribute("position", new BufferAttribute(new Float32Array([0, 0, 1, 0, 1, 1, 0, 0, 1, 1, 0, 1]), 2));
    quad.boundingSphere = EVERYWHERE;
    this.ground = still(new Mesh(quad, material));
    this.ground.renderOrder = ORDER.ground;
    this.scene.add(this.ground);
  }

  ribbons(behind) {
    const ribbons = new Ribbons();
    const how = { transparent: true, depthWrite: false, depthTest: behind, side: DoubleSide };
    const mesh = ribbons.shows(new Mesh(undefined, this.material(RIBBON_VERTEX, RIBBON_FRAGMENT, {}, how)));
    mesh.renderOrder = behind ? ORDER.links : ORDER.marks;
    this.scene.add(mesh);
    return ribbons;
  }

  uniformsOf({ size, facing }, more) {
    return { size: new Vector3(...size), facing, ...more };
  }

  /** Adds parts of a shape that stand as bodies, and cast shadows. */
  bodies(corners, how) {
    const parts = new Parts(corners, how);
    const { round, turned, facing } = parts;
    const defines = { ...(turned && { TURNED: 1 }), ...(round && { ROUND: 1 }) };
    const uniforms = this.uniformsOf(parts, { grow: 0, radius: round?.radius ?? 1, half_: round?.edge ?? 1 });
    // Mirroring reverses the winding of sides.
    const side = facing ? DoubleSide : FrontSide;
    this.scene.add(parts.shows(new Mesh(undefined, this.material(PARTS_VERTEX, PARTS_FRAGMENT, uniforms, { defines, side }))));
    const shadow = this.uniformsOf(parts, { bounds: this.ground.material.uniforms.bounds.value, ground: 0 });
    const flat = { side: DoubleSide, depthTest: false, depthWrite: false };
    this.shadowScene.add(parts.shows(new Mesh(undefined, this.material(SHADOW_VERTEX, SHADOW_FRAGMENT, shadow, flat))));
    return parts;
  }

  /** Adds parts of a shape that outline a body, and show through everything. */
  outlines(corners, how) {
    const parts = new Parts(corners, how);
    const defines = parts.turned ? { TURNED: 1 } : {};
    const hull = this.uniformsOf(parts, { grow: 0.12, flat_: new Vector4() });
    const glow = this.uniformsOf(parts, { grow: 0.1, flat_: new Vector4() });
    const through = { transparent: true, depthTest: false, depthWrite: false, defines };
    parts.also.hull = parts.shows(new Mesh(undefined, this.material(PARTS_VERTEX, FLAT_FRAGMENT, hull, { side: BackSide, defines })));
    parts.also.glow = parts.shows(new Mesh(undefined, this.material(PARTS_VERTEX, FLAT_FRAGMENT, glow, through)));
    parts.also.glow.renderOrder = ORDER.glow;
    this.scene.add(parts.also.hull, parts.also.glow);
    return parts;
  }

  /** Adds parts that are drawn as wires. */
  wires(corners) {
    const parts = new Parts(corners);
    const uniforms = this.uniformsOf(parts, { grow: 0, flat_: new Vector4() });
    const how = { transparent: true, depthWrite: false };
    parts.also.lines = parts.shows(new LineSegments(undefined, this.material(PARTS_VERTEX, FLAT_FRAGMENT, uniforms, how)));
    parts.also.lines.renderOrder = ORDER.ghosts;
    this.scene.add(parts.also.lines);
    return parts;
  }

  resize() {
    const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight].map((x) =>
      Math.max(1, Math.round(x * this.sharpness)),
    );
    if (this.canvas.width !== width || this.canvas.height !== height) this.three.setSize(width, height, false);
    return width / height;
  }

  /** Paints the shadows of the parts on the ground. */
  paintShadows(camera, z) {
    for (const { material } of this.shadowScene.children) material.uniforms.ground.value = z;
    this.three.setRenderTarget(this.shade);
    this.three.setClearColor(new Color(0, 0, 0), 1);
    this.three.render(this.shadowScene, camera);
    this.three.setRenderTarget(null);
    this.shaded = true;
  }

  /**
   * Draws one picture: the background `paper`, the `ground`, `groups` of bodies (parts and their numbers), the
   * `chosen` ones with an `outline`, `ghosts` as wires, `links` among the bodies and `marks` over them.
   */
  draw({ viewpoint, paper, ground, groups, ghosts, chosen, outline, links, marks, clock, dark }) {
    const { shared, three } = this;
    const camera = viewpoint.camera(this.resize());
    const { out, position, parallel } = viewpoint.eye();
    shared.eye.value.set(...out);
    if (parallel) shared.eyeAt.value.set(...out, 0);
    else shared.eyeAt.value.set(...position, 1);
    shared.ambient.value = dark ? 0.5 : 0.66;
    shared.clock.value = clock;
    shared.pixel.value = (0.7 / this.canvas.clientHeight) * (parallel ? viewpoint.distance : 1);
    for (const { shape, numbers } of groups) shape.fillNearestFirst(numbers, out);
    for (const { shape, numbers } of chosen) {
      shape.fill(numbers);
      shape.also.hull.material.uniforms.flat_.value.set(...outline, 1);
      shape.also.glow.material.uniforms.flat_.value.set(...outline, 0.2);
    }
    ghosts.shape.fill(ghosts.numbers);
    ghosts.shape.also.lines.material.uniforms.flat_.value.set(...ghosts.colour);
    this.links.fill(links);
    this.marks.fill(marks);

    const above = out[2] > 0;
    this.ground.visible = above;
    if (above) {
      const u = this.ground.material.uniforms;
      u.bounds.value.set(...ground.bounds);
      u.ground.value = ground.z;
      u.plates.value = ground.plates;
      u.fill.value.set(...ground.fill);
      u.line.value.set(...ground.line);
      u.shadow.value = this.shadows ? (dark ? 0.34 : 0.13) : 0;
      if (this.shadows && !this.shaded) this.paintShadows(camera, ground.z);
    }
    three.setClearColor(new Color(...paper), 1);
    three.render(this.scene, camera);
  }
}
