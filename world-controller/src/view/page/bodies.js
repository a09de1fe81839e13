// Where the parts of bodies are: cubes that slide, and the eight half cubes of a metamodule, from the
// angles of its joints. The model is that of the Roombots in protocol/src/roombots, in floating point.

const S = Math.SQRT1_2;

export function multiply([ax, ay, az, aw], [bx, by, bz, bw]) {
  return [
    aw * bx + ax * bw + ay * bz - az * by,
    aw * by - ax * bz + ay * bw + az * bx,
    aw * bz + ax * by - ay * bx + az * bw,
    aw * bw - ax * bx - ay * by - az * bz,
  ];
}

export function turn([x, y, z, w], [vx, vy, vz]) {
  const tx = 2 * (y * vz - z * vy);
  const ty = 2 * (z * vx - x * vz);
  const tz = 2 * (x * vy - y * vx);
  return [
    vx + w * tx + y * tz - z * ty,
    vy + w * ty + z * tx - x * tz,
    vz + w * tz + x * ty - y * tx,
  ];
}

function about([x, y, z], angle) {
  const s = Math.sin(angle / 2);
  return [x * s, y * s, z * s, Math.cos(angle / 2)];
}

export const UPRIGHT = [0, 0, 0, 1];
const UP = [0, 0, 1];
const DIAGONAL = [1 / Math.sqrt(3), 1 / Math.sqrt(3), 1 / Math.sqrt(3)];
/** Half a turn about x = -y: takes the upper half of a cube to the lower one. */
const FLIP = [S, -S, 0, 0];

const ease = (x) => x * x * (3 - 2 * x);

const FACES = [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]];

/** The middle of a cube between two cells: straight, or around the corner, which it does not cut. */
export function cubeAt({ from, to, part, what }) {
  if (part <= 0 || !what) return from;
  if (part >= 1) return to;
  const [kind, support, heading] = what;
  const [s, h] = [FACES[support], FACES[heading]];
  const along = ease(kind === 1 ? Math.min(part * 2, 1) : part);
  const around = kind === 1 ? ease(Math.max(part * 2 - 1, 0)) : 0;
  return from.map((x, i) => x + h[i] * along + s[i] * around);
}

const isMiddle = (joint) => joint % 3 === 1;
const steps = (joint) => (isMiddle(joint) ? 4 : 3);
const angleOf = (joint) => (2 * Math.PI) / steps(joint);

/** The eight half cubes of a metamodule, from the end that holds on: middles and rotations. */
export function halvesAt({ from, to, part, what }, quarterTurns) {
  // Joints turn; when an end grips or lets go the body stays where it is.
  const turning = what && what[0] === 0 && part > 0;
  const stance = turning ? from : part >= 1 ? to : from;
  const angles = stance.slice(5).map((count, joint) => {
    if (!turning) return count * angleOf(joint);
    const n = steps(joint);
    const by = (to[5 + joint] - count + n) % n;
    const signed = by === n - 1 ? -1 : by;
    return (count + signed * ease(Math.min(part, 1))) * angleOf(joint);
  });
  const [x, y, quarter] = stance;
  let rotation = about(UP, (quarter * Math.PI) / 2);
  let origin = [x, y, 0];
  // A rotation about an axis through `pivot`, both in the frame of the zero posture.
  const move = (axis, pivot, angle) => {
    const at = turn(rotation, pivot).map((v, i) => v + origin[i]);
    rotation = multiply(rotation, about(axis, angle));
    const moved = turn(rotation, pivot);
    origin = at.map((v, i) => v - moved[i]);
  };
  const halves = [];
  const half = (height, turned, lower) => {
    const middle = turn(rotation, [0, 0, height]).map((v, i) => v + origin[i]);
    const own = multiply(rotation, turned);
    halves.push({ middle, rotation: lower ? multiply(own, FLIP) : own });
  };
  for (const module of [0, 1]) {
    const turned = about(UP, module * quarterTurns * (Math.PI / 2));
    const axis = turn(turned, DIAGONAL);
    const base = 2 * module;
    half(base + 0.5, turned, true);
    move(axis, [0, 0, base + 0.5], angles[3 * module]);
    half(base + 0.5, turned, false);
    move(UP, [0, 0, base + 1], angles[3 * module + 1]);
    half(base + 1.5, turned, true);
    move(axis, [0, 0, base + 1.5], angles[3 * module + 2]);
    half(base + 1.5, turned, false);
  }
  return halves;
}

/** The corners of a box of edge 1, by triangles; or only of its sides towards +x, +y and +z. */
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

/** The edges of a box of edge 1, as lines. */
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

/** The upper half of a cube of the Roombots: a ball cut by three plates and the plane of the joint. */
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
