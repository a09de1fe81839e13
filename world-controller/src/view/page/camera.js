// The camera: orbits a point, zooms and pans, by pointer, wheel, touch and keys.

export class Camera {
  constructor() {
    this.azimuth = -0.9;
    this.height = 0.5;
    this.distance = 40;
    this.target = [0, 0, 0];
    this.aspect = 1;
    this.onChange = () => {};
  }

  /** Brings all of these points into view, from as near as possible. */
  fit(points) {
    this.azimuth = -0.9;
    this.height = 0.46;
    this.target = [0, 1, 2].map((i) => {
      const along = points.map((p) => p[i]);
      return (Math.min(...along) + Math.max(...along)) / 2;
    });
    const { right, up } = this.axes();
    const { out } = this.eye();
    const t = Math.tan(FIELD / 2);
    const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    // Iterated: each round finds the middle of the projection, which is not that of the points.
    for (let i = 0; i < 4; i++) {
      const seen = points.map((c) => c.map((x, k) => x - this.target[k]));
      const far = (axis, wide) => Math.max(...seen.map((c) => Math.abs(dot(c, axis)) / (t * wide) + dot(c, out)));
      this.distance = Math.max(far(right, this.aspect), far(up, 1)) * 1.1;
      const heights = seen.map((c) => dot(c, up) / (this.distance - dot(c, out)));
      const off = ((Math.max(...heights) + Math.min(...heights)) / 2) * this.distance;
      this.target = this.target.map((x, k) => x + up[k] * off);
    }
    this.onChange();
  }

  eye() {
    const [ca, sa] = [Math.cos(this.azimuth), Math.sin(this.azimuth)];
    const [ch, sh] = [Math.cos(this.height), Math.sin(this.height)];
    const out = [ca * ch, sa * ch, sh];
    return { out, position: this.target.map((x, i) => x + out[i] * this.distance) };
  }

  /** Returns right and up of the picture as directions in space. */
  axes() {
    const [ca, sa] = [Math.cos(this.azimuth), Math.sin(this.azimuth)];
    const [ch, sh] = [Math.cos(this.height), Math.sin(this.height)];
    return { right: [-sa, ca, 0], up: [-ca * sh, -sa * sh, ch] };
  }

  orbit(dx, dy) {
    this.azimuth -= dx;
    this.height = Math.max(-1.55, Math.min(1.55, this.height + dy));
    this.onChange();
  }

  pan(dx, dy) {
    const { right, up } = this.axes();
    const by = this.distance * Math.tan(FIELD / 2) * 2;
    this.target = this.target.map((x, i) => x - (right[i] * dx - up[i] * dy) * by);
    this.onChange();
  }

  zoom(by) {
    this.distance = Math.max(2, Math.min(2000, this.distance * by));
    this.onChange();
  }

  /** Returns the matrix from space to the picture, by columns. */
  matrix() {
    const { out, position } = this.eye();
    const { right, up } = this.axes();
    const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    const f = 1 / Math.tan(FIELD / 2);
    const [near, far] = [this.distance / 200, this.distance * 8 + 200];
    const [a, b] = [(far + near) / (near - far), (2 * far * near) / (near - far)];
    const rows = [right, up, out].map((axis) => [...axis, -dot(axis, position)]);
    const m = new Float32Array(16);
    for (let c = 0; c < 4; c++) {
      m[4 * c] = (rows[0][c] * f) / this.aspect;
      m[4 * c + 1] = rows[1][c] * f;
      m[4 * c + 2] = rows[2][c] * a + (c === 3 ? b : 0);
      m[4 * c + 3] = -rows[2][c];
    }
    return m;
  }

  /** Returns the ray through a point of the picture, -1..1 to the right and up. */
  ray(x, y) {
    const { out, position } = this.eye();
    const { right, up } = this.axes();
    const t = Math.tan(FIELD / 2);
    const direction = out.map((o, i) => -o + right[i] * x * t * this.aspect + up[i] * y * t);
    const length = Math.hypot(...direction);
    return { origin: position, direction: direction.map((d) => d / length) };
  }

  /** Listens to pointers on an element; `onTap` receives a press without a drag. */
  listen(element, onTap) {
    const pointers = new Map();
    let moved = 0;
    element.addEventListener("contextmenu", (e) => e.preventDefault());
    element.addEventListener("pointerdown", (e) => {
      element.setPointerCapture(e.pointerId);
      pointers.set(e.pointerId, e);
      if (pointers.size === 1) moved = 0;
    });
    element.addEventListener("pointermove", (e) => {
      const last = pointers.get(e.pointerId);
      if (!last) return;
      const [dx, dy] = [e.clientX - last.clientX, e.clientY - last.clientY];
      moved += Math.abs(dx) + Math.abs(dy);
      const height = element.clientHeight;
      if (pointers.size === 2) {
        const other = [...pointers.values()].find((p) => p.pointerId !== e.pointerId);
        const apart = (p) => Math.hypot(p.clientX - other.clientX, p.clientY - other.clientY);
        this.pan(dx / height / 2, dy / height / 2);
        this.zoom(apart(last) / Math.max(apart(e), 1));
      } else if (e.buttons & 6 || e.shiftKey) {
        this.pan(dx / height, dy / height);
      } else {
        this.orbit(dx / 150, dy / 150);
      }
      pointers.set(e.pointerId, e);
    });
    const up = (e) => {
      if (pointers.delete(e.pointerId) && moved < 5 && e.type === "pointerup") onTap(e);
    };
    element.addEventListener("pointerup", up);
    element.addEventListener("pointercancel", up);
    element.addEventListener(
      "wheel",
      (e) => {
        e.preventDefault();
        this.zoom(Math.exp(Math.max(-60, Math.min(60, e.deltaY)) / 250));
      },
      { passive: false },
    );
  }
}

const FIELD = 0.5;
