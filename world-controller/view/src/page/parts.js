// Rigid parts of bodies: their poses during a motion, and the meshes of their shapes. view/parts.rs has the
// same rules.

const S = Math.SQRT1_2;

function multiply([ax, ay, az, aw], [bx, by, bz, bw]) {
  return [
    aw * bx + ax * bw + ay * bz - az * by,
    aw * by - ax * bz + ay * bw + az * bx,
    aw * bz + ax * by - ay * bx + az * bw,
    aw * bw - ax * bx - ay * by - az * bz,
  ];
}

function turn([x, y, z, w], [vx, vy, vz]) {
  const tx = 2 * (y * vz - z * vy);
  const ty = 2 * (z * vx - x * vz);
  const tz = 2 * (x * vy - y * vx);
  return [
    vx + w * tx + y * tz - z * ty,
    vy + w * ty + z * tx - x * tz,
    vz + w * tz + x * ty - y * tx,
  ];
}

/** @param {number[]} axis */
function about([x, y, z], angle) {
  const s = Math.sin(angle / 2);
  return [x * s, y * s, z * s, Math.cos(angle / 2)];
}

export const UPRIGHT = [0, 0, 0, 1];
const DIAGONAL = [1 / Math.sqrt(3), 1 / Math.sqrt(3), 1 / Math.sqrt(3)];

/** Number of values of the pose of one part: its centre and its rotation. */
export const POSE = 7;

const ease = (x) => x * x * (3 - 2 * x);

/** Returns the poses of all parts after a share of a motion. */
export function carried(poses, segments, part) {
  const out = [...poses];
  let begin = 0;
  for (const [until, steps] of segments) {
    const share = ease(Math.max(0, Math.min(1, (part - begin) / (until - begin))));
    for (const [first, last, ...by] of share > 0 ? steps : []) {
      if (by.length === 3) slide(out, first, last, by.map((x) => x * share));
      else {
        const [a, b, c, degrees, ...through] = by;
        const length = Math.hypot(a, b, c);
        const axis = [a / length, b / length, c / length];
        const point = through.map((x, k) => poses[k] + x);
        rotate(out, first, last, about(axis, (degrees * share * Math.PI) / 180), point);
      }
    }
    begin = until;
  }
  return out;
}

function slide(poses, first, last, by) {
  for (let at = POSE * first; at < POSE * last; at += POSE) for (let k = 0; k < 3; k++) poses[at + k] += by[k];
}

function rotate(poses, first, last, rotation, point) {
  for (let at = POSE * first; at < POSE * last; at += POSE) {
    const arm = turn(rotation, point.map((x, k) => poses[at + k] - x));
    arm.forEach((x, k) => (poses[at + k] = point[k] + x));
    multiply(rotation, poses.slice(at + 3, at + POSE)).forEach((x, k) => (poses[at + 3 + k] = x));
  }
}

/** Returns the poses of the parts of a body between two stances. */
export function posesAt({ from, to, part, motion }) {
  if (part <= 0 || !motion) return from.poses;
  return part >= 1 ? to.poses : carried(from.poses, motion.segments, part);
}

/** Returns the corners of a box of edge 1, by triangles; or only of its sides towards +x, +y and +z. */
export function box(half) {
  const vertices = [];
  for (let axis = 0; axis < 3; axis++) {
    for (const sign of half ? [1] : [-1, 1]) {
      const [u, v] = [(axis + 1) % 3, (axis + 2) % 3];
      const corner = (a, b) => {
        const p = [0, 0, 0];
        p[axis] = sign / 2;
        p[u] = a / 2;
        p[v] = b / 2;
        return p;
      };
      const quad = [corner(-1, -1), corner(1, -1), corner(1, 1), corner(-1, 1)];
      const order = sign > 0 ? [0, 1, 2, 0, 2, 3] : [0, 2, 1, 0, 3, 2];
      order.forEach((i) => vertices.push(...quad[i]));
    }
  }
  return new Float32Array(vertices);
}

/** Returns the edges of a box of edge 1, as lines. */
export function wires() {
  const vertices = [];
  for (let axis = 0; axis < 3; axis++) {
    for (const a of [-0.5, 0.5]) {
      for (const b of [-0.5, 0.5]) {
        for (const end of [-0.5, 0.5]) {
          const p = [0, 0, 0];
          p[axis] = end;
          p[(axis + 1) % 3] = a;
          p[(axis + 2) % 3] = b;
          vertices.push(...p);
        }
      }
    }
  }
  return new Float32Array(vertices);
}

/** Returns half a ball, cut by three plates and by the plane across the diagonal between them. */
export function halfCube(radius, edge) {
  const [d, a] = [DIAGONAL, [S, -S, 0]];
  const b = [d[1] * a[2] - d[2] * a[1], d[2] * a[0] - d[0] * a[2], d[0] * a[1] - d[1] * a[0]];
  const [rings, around] = [14, 42];
  const point = (i, j) => {
    const [theta, phi] = [(i / rings) * (Math.PI / 2), (j / around) * 2 * Math.PI];
    const [st, ct] = [Math.sin(theta), Math.cos(theta)];
    const u = d.map((x, k) => x * ct + st * (a[k] * Math.cos(phi) + b[k] * Math.sin(phi)));
    const reach = Math.min(radius, edge / Math.max(...u, 1e-9));
    return u.map((x) => x * reach);
  };
  const vertices = [];
  for (let i = 0; i < rings; i++) {
    for (let j = 0; j < around; j++) {
      const quad = [point(i, j), point(i + 1, j), point(i + 1, j + 1), point(i, j + 1)];
      [0, 1, 2, 0, 2, 3].forEach((k) => vertices.push(...quad[k]));
    }
  }
  return new Float32Array(vertices);
}
