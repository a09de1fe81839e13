// The faces of cells that can be seen, in one mesh: what lies between two cells is not drawn. Software renderers take a
// draw call for each instance, so instances of boxes would take many times as long.

import * as three from "./vendor/three.js";
import { BESIDE, cell } from "./cells.js";

/** @typedef {{ key: number, colour: any, partner?: number, pinned?: boolean }} Drawn a cell, the other cell of its module, and
 *  whether a pin joins them */

const VERTEX = `
uniform mat4 projectionMatrix, modelViewMatrix;
in vec3 position;
in vec4 tint, seams;
out vec3 colour;
flat out float pinned;
out vec2 place;
flat out vec4 inner;
void main() {
  // The corners of a face are vertices one after the other.
  int corner = gl_VertexID & 3;
  place = vec2(corner == 1 || corner == 2, corner > 1);
  colour = tint.rgb;
  pinned = tint.a;
  inner = seams;
  gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
}`;
const FRAGMENT = `
precision highp float;
in vec3 colour;
in vec2 place;
flat in vec4 inner;
flat in float pinned;
uniform float opacity;
uniform vec3 edge;
out vec4 pixel;
void main() {
  // The seam between the two cells of a module is thinner than the outline of the module.
  vec4 far = vec4(place, 1.0 - place) + 0.025 * inner;
  float middle = min(min(far.x, far.y), min(far.z, far.w));
  float width = max(fwidth(middle), 0.001);
  float line = 1.0 - smoothstep(0.035, 0.035 + 1.4 * width, middle);
  // A pinned module has a rhomb on each face of its cells.
  float out_of_centre = abs(place.x - 0.5) + abs(place.y - 0.5);
  float rhomb = pinned * (1.0 - smoothstep(0.17, 0.17 + 1.4 * max(fwidth(out_of_centre), 0.001), out_of_centre));
  pixel = vec4(mix(colour, edge, 0.75 * max(line, rhomb)), opacity);
}`;

/** How bright the faces along and against x, y and z are. */
const LIGHT = [0.72, 0.88, 0.82, 0.94, 1.04, 0.62];

/** The faces of many cells of one look. */
export class Faces {
  /** @param {any} scene @param {number} size the edge of a cell @param {number} opacity */
  constructor(scene, size = 1, opacity = 1) {
    this.material = new three.RawShaderMaterial({
      vertexShader: VERTEX, fragmentShader: FRAGMENT, glslVersion: three.GLSL3,
      uniforms: { opacity: { value: opacity }, edge: { value: new three.Color(0) } },
      transparent: opacity < 1, depthWrite: opacity === 1,
    });
    [this.half, this.room] = [size / 2, 0];
    this.geometry = new three.BufferGeometry();
    this.mesh = new three.Mesh(this.geometry, this.material);
    this.mesh.frustumCulled = false;
    scene.add(this.mesh);
    this.reserve(64);
  }

  /** Makes room for a number of faces. */
  reserve(faces) {
    if (faces <= this.room) return;
    this.room = 2 ** Math.ceil(Math.log2(faces));
    // Frees the buffers of the old size.
    this.geometry.dispose();
    const corners = 4 * this.room;
    this.geometry.setAttribute("position", new three.BufferAttribute(new Float32Array(3 * corners), 3));
    this.geometry.setAttribute("seams", new three.BufferAttribute(new Uint8Array(4 * corners), 4));
    this.geometry.setAttribute("tint", new three.BufferAttribute(new Uint8Array(4 * corners), 4, true));
    const index = new Uint32Array(6 * this.room);
    for (let i = 0; i < this.room; i++) index.set([0, 1, 2, 0, 2, 3].map((corner) => 4 * i + corner), 6 * i);
    this.geometry.setIndex(new three.BufferAttribute(index, 1));
  }

  /** Shows cells. @param {Drawn[]} drawn @param {Set<number>} filled all cells that hide faces of others */
  fill(drawn, filled) {
    const seen = [];
    for (const one of drawn) {
      for (let side = 0; side < 6; side++) if (!filled.has(one.key + BESIDE[side])) seen.push(side, one);
    }
    this.reserve(seen.length / 2);
    const [position, seams, tint] = ["position", "seams", "tint"].map((name) => this.geometry.getAttribute(name));
    for (let i = 0; i < seen.length; i += 2) {
      const [side, { key, colour, partner, pinned }] = [seen[i], seen[i + 1]];
      const centre = cell(key);
      const axis = side >> 1, out = side & 1 ? -1 : 1;
      // Seen from outside, the corners of every face turn the same way.
      const u = (axis + (out > 0 ? 1 : 2)) % 3, v = (axis + (out > 0 ? 2 : 1)) % 3;
      const inner = [2 * u + 1, 2 * v + 1, 2 * u, 2 * v].map((to) => Number(partner === key + BESIDE[to]));
      const rgb = [colour.r, colour.g, colour.b].map((part) => Math.min(255, Math.round(255 * part * LIGHT[side])));
      rgb.push(pinned ? 255 : 0);
      for (let corner = 0; corner < 4; corner++) {
        const n = 2 * i + corner;
        position.array[3 * n + axis] = centre[axis] + out * this.half;
        position.array[3 * n + u] = centre[u] + (corner === 1 || corner === 2 ? this.half : -this.half);
        position.array[3 * n + v] = centre[v] + (corner > 1 ? this.half : -this.half);
        seams.array.set(inner, 4 * n);
        tint.array.set(rgb, 4 * n);
      }
    }
    for (const attribute of [position, seams, tint]) attribute.needsUpdate = true;
    this.geometry.setDrawRange(0, 3 * seen.length);
  }
}
