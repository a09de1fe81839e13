// From where the swarm is seen: orbits a point, zooms and pans, by pointer, wheel, touch and keys; views along the axes;
// perspective or parallel projection.

import { MOUSE, OrbitControls, OrthographicCamera, PerspectiveCamera, Vector3 } from "./vendor/three.js";

/** The angle of the picture from bottom to top. */
const FIELD = 0.5;
/** The steepest view; straight from above, left and right would be undefined. */
const STEEPEST = 1.55;
/** A press that moves the pointer by less, in pixels, is a tap. */
const TAP = 5;

/** Directions to look from: azimuth and height, as angles. With y away from the eye, x is to the right. */
export const VIEWS = {
  corner: [-0.9, 0.46],
  above: [-Math.PI / 2, STEEPEST],
  front: [-Math.PI / 2, 0],
  right: [0, 0],
  back: [Math.PI / 2, 0],
  left: [Math.PI, 0],
};

const SLACK = 1e-3;
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

export class Viewpoint {
  constructor(element) {
    this.aspect = 1;
    this.parallel = false;
    this.onChange = () => {};
    this.perspective = new PerspectiveCamera((FIELD * 180) / Math.PI, 1, 0.1, 1000);
    this.orthographic = new OrthographicCamera(-1, 1, 1, -1, 0.1, 1000);
    for (const camera of [this.perspective, this.orthographic]) camera.up.set(0, 0, 1);
    // The controls move the camera in perspective; the other one takes its place from it.
    this.controls = new OrbitControls(this.perspective, element);
    this.controls.mouseButtons = { LEFT: MOUSE.ROTATE, MIDDLE: MOUSE.PAN, RIGHT: MOUSE.PAN };
    this.controls.minPolarAngle = Math.PI / 2 - STEEPEST;
    this.controls.maxPolarAngle = Math.PI / 2 + STEEPEST;
    this.controls.minDistance = 2;
    this.controls.maxDistance = 2000;
    this.place([0, 0, 0], VIEWS.corner, 40);
    this.controls.addEventListener("change", () => this.onChange());
  }

  get target() {
    return this.controls.target.toArray();
  }

  get distance() {
    return this.perspective.position.distanceTo(this.controls.target);
  }

  /** The direction of the eye, as seen from the target. */
  get azimuth() {
    const [x, y] = this.arm();
    return Math.atan2(y, x);
  }

  get height() {
    const [x, y, z] = this.arm();
    return Math.atan2(z, Math.hypot(x, y));
  }

  arm() {
    return this.perspective.position.clone().sub(this.controls.target).toArray();
  }

  /**
   * Looks at a target from a direction and a distance.
   * @param {number[]} target
   * @param {number[]} direction azimuth and height
   * @param {number} distance
   */
  place(target, [azimuth, height], distance) {
    const steep = Math.max(-STEEPEST, Math.min(STEEPEST, height));
    const [ca, sa, ch, sh] = [Math.cos(azimuth), Math.sin(azimuth), Math.cos(steep), Math.sin(steep)];
    this.controls.target.fromArray(target);
    this.perspective.position.set(ca * ch, sa * ch, sh).multiplyScalar(distance).add(this.controls.target);
    this.controls.update();
  }

  orbit(dx, dy) {
    this.place(this.target, [this.azimuth - dx, this.height + dy], this.distance);
  }

  pan(dx, dy) {
    const { right, up } = this.axes();
    const by = this.distance * Math.tan(FIELD / 2) * 2;
    this.moveTo(this.target.map((x, i) => x - (right[i] * dx - up[i] * dy) * by));
  }

  zoom(by) {
    this.place(this.target, [this.azimuth, this.height], Math.max(2, Math.min(2000, this.distance * by)));
  }

  /** Looks at another point, from the same direction and distance. */
  moveTo(target) {
    this.place(target, [this.azimuth, this.height], this.distance);
  }

  setParallel(parallel) {
    this.parallel = parallel;
    this.onChange();
  }

  /** Returns the name of the view that this is, if it has one. */
  name() {
    const is = ([azimuth, height]) =>
      Math.abs(Math.sin((azimuth - this.azimuth) / 2)) < SLACK && Math.abs(height - this.height) < SLACK;
    return Object.keys(VIEWS).find((name) => is(VIEWS[name])) ?? null;
  }

  /** Brings all of these points into view, from as near as possible. */
  fit(points, direction = [this.azimuth, this.height]) {
    const middle = [0, 1, 2].map((i) => {
      const along = points.map((p) => p[i]);
      return (Math.min(...along) + Math.max(...along)) / 2;
    });
    this.place(middle, direction, this.distance);
    const { right, up } = this.axes();
    const { out, parallel } = this.eye();
    const t = Math.tan(FIELD / 2);
    let [target, distance] = [middle, this.distance];
    // Iterated: each round finds the middle of the projection, which is not that of the points.
    for (let i = 0; i < 4; i++) {
      const seen = points.map((c) => c.map((x, k) => x - target[k]));
      const towards = (c) => (parallel ? 0 : dot(c, out));
      const far = (axis, wide) => Math.max(...seen.map((c) => Math.abs(dot(c, axis)) / (t * wide) + towards(c)));
      distance = Math.max(far(right, this.aspect), far(up, 1)) * 1.1;
      const heights = seen.map((c) => dot(c, up) / (distance - towards(c)));
      const off = ((Math.max(...heights) + Math.min(...heights)) / 2) * distance;
      target = target.map((x, k) => x + up[k] * off);
    }
    this.place(target, direction, distance);
  }

  /** Returns the number of pixels of an edge of a cell in the plane of the target, in a picture of this height. */
  pixelsOfACell(height) {
    return height / (2 * this.distance * Math.tan(FIELD / 2));
  }

  /** Looks at another point, without telling. */
  follow(target) {
    const { onChange } = this;
    this.onChange = () => {};
    this.moveTo(target);
    this.onChange = onChange;
  }

  eye() {
    const { distance, parallel } = this;
    return { out: this.arm().map((x) => x / distance), position: this.perspective.position.toArray(), parallel };
  }

  /** Returns right and up of the picture as directions in space. */
  axes() {
    const [ca, sa] = [Math.cos(this.azimuth), Math.sin(this.azimuth)];
    const [ch, sh] = [Math.cos(this.height), Math.sin(this.height)];
    return { right: [-sa, ca, 0], up: [-ca * sh, -sa * sh, ch] };
  }

  /** Returns the camera for a picture of this aspect. */
  camera(aspect = this.aspect) {
    this.aspect = aspect;
    const { perspective, orthographic, distance } = this;
    const camera = this.parallel ? orthographic : perspective;
    // What is in front of the target by more than its distance would be cut off in parallel projection.
    camera.near = this.parallel ? -(distance * 8 + 200) : distance / 200;
    camera.far = distance * 8 + 200;
    if (this.parallel) {
      const half = distance * Math.tan(FIELD / 2);
      Object.assign(camera, { left: -half * aspect, right: half * aspect, top: half, bottom: -half });
      camera.position.copy(perspective.position);
      camera.quaternion.copy(perspective.quaternion);
    } else {
      perspective.aspect = aspect;
    }
    camera.updateProjectionMatrix();
    camera.updateMatrixWorld();
    return camera;
  }

  /** Returns the matrix from space to the picture, by columns. */
  matrix() {
    const camera = this.camera();
    return camera.projectionMatrix.clone().multiply(camera.matrixWorldInverse).toArray();
  }

  /** Returns the ray through a point of the picture, -1..1 to the right and up. */
  ray(x, y) {
    const camera = this.camera();
    const [near, far] = [-1, 1].map((z) => new Vector3(x, y, z).unproject(camera));
    const origin = this.parallel ? near : camera.position.clone();
    return { origin: origin.toArray(), direction: far.sub(origin).normalize().toArray() };
  }

  /** Calls `onTap` after each press without a drag. */
  listen(element, onTap) {
    let pressed = null;
    element.addEventListener("pointerdown", (e) => (pressed = e.isPrimary ? e : null));
    element.addEventListener("pointerup", (e) => {
      if (!pressed || pressed.pointerId !== e.pointerId || e.button !== 0) return;
      if (Math.hypot(e.clientX - pressed.clientX, e.clientY - pressed.clientY) < TAP) onTap(e);
      pressed = null;
    });
  }
}
