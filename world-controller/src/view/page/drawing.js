// Draws with WebGL 2: parts of bodies as instances of one mesh, ribbons between points, a ground with
// shadows. Knows nothing of swarms. Draws only when asked to.

export const PATTERN = { plain: 0, dead: 1, paused: 2, stuck: 3 };
/** Numbers of one part: place and size, rotation, colour and pattern, edge colour and shrinking. */
export const PART = 16;
/** Numbers of one ribbon: from, width there, to, width there, colour, how fast it flows. */
export const RIBBON = 13;

const PARTS_VERTEX = `#version 300 es
in vec3 vertex;
in vec4 place, rotation, paint, edge;
uniform mat4 view;
uniform float grow, ground;
uniform bool shadow, facing;
uniform vec3 light, eyeAt;
out vec3 local;
flat out vec4 paintOf, edgeOf, turned;
vec3 turn(vec4 q, vec3 v) { return v + 2.0 * cross(q.xyz, cross(q.xyz, v) + q.w * v); }
void main() {
  local = vertex;
  // Of an upright box the three sides that are seen are enough.
  if (facing) local *= mix(vec3(-1), vec3(1), step(vec3(0), shadow ? light : eyeAt - place.xyz));
  paintOf = paint;
  edgeOf = edge;
  turned = rotation;
  vec3 at = place.xyz + turn(rotation, local * (place.w + grow));
  if (shadow) {
    at += light * ((ground - at.z) / light.z);
    at.z = ground;
  }
  gl_Position = view * vec4(at, 1.0);
}`;

const PARTS_FRAGMENT = `#version 300 es
precision highp float;
in vec3 local;
flat in vec4 paintOf, edgeOf, turned;
uniform bool shadow, outline, round;
uniform vec4 flat_;
uniform vec3 light, eye;
uniform float radius, half_, ambient;
out vec4 colour;
vec3 turn(vec4 q, vec3 v) { return v + 2.0 * cross(q.xyz, cross(q.xyz, v) + q.w * v); }
void main() {
  int pattern = int(paintOf.w + 0.5);
  if (shadow || outline) {
    colour = flat_;
    return;
  }
  vec3 a = abs(local), normal;
  vec2 on;
  float line;
  if (round) {
    vec3 u = normalize(local);
    float most = max(u.x, max(u.y, u.z));
    float rim = half_ / radius;
    vec3 axis = u.x == most ? vec3(1, 0, 0) : u.y == most ? vec3(0, 1, 0) : vec3(0, 0, 1);
    float blur = fwidth(most) + 1e-5;
    float plate = smoothstep(rim - blur, rim + blur, most);
    normal = normalize(mix(u, axis, plate));
    vec3 onPlate = local - axis * dot(local, axis);
    float out_ = length(onPlate);
    float ring = smoothstep(0.012, 0.0, abs(out_ - 0.17) - 0.006) * plate;
    float seam = smoothstep(0.055, 0.03, dot(u, vec3(0.57735)));
    line = max(max(ring * 0.55, seam * 0.85), smoothstep(2.0 * blur, 0.0, abs(most - rim)) * 0.35);
    on = axis.x > 0.5 ? local.yz : axis.y > 0.5 ? local.zx : local.xy;
  } else {
    float most = max(a.x, max(a.y, a.z));
    vec3 s = sign(local);
    vec3 axis = a.x == most ? vec3(s.x, 0, 0) : a.y == most ? vec3(0, s.y, 0) : vec3(0, 0, s.z);
    on = a.x == most ? local.yz : a.y == most ? local.zx : local.xy;
    float border = 0.5 - max(abs(on.x), abs(on.y));
    float blur = fwidth(border) + 1e-5;
    vec3 bevel = normalize(axis + local * 0.9);
    normal = normalize(mix(axis, bevel, smoothstep(0.1, 0.02, border)));
    line = smoothstep(0.035 + blur, 0.03 - blur * 0.5, border) * 0.8;
  }
  vec3 base = paintOf.rgb;
  vec3 ink = round ? base * 0.42 : edgeOf.rgb;
  float blurOn = fwidth(on.x) + fwidth(on.y) + 1e-5;
  if (pattern == 1) {
    float cross_ = min(abs(on.x - on.y), abs(on.x + on.y));
    float within = step(max(abs(on.x), abs(on.y)), 0.3);
    base = mix(base, edgeOf.rgb, smoothstep(0.07 + blurOn, 0.07, cross_) * within);
  } else if (pattern == 2) {
    float bars = abs(abs(on.x) - 0.12);
    float within = step(abs(on.y), 0.24);
    base = mix(base, edgeOf.rgb, smoothstep(0.055 + blurOn, 0.055, bars) * within);
  } else if (pattern == 3) {
    base = mix(base, edgeOf.rgb, smoothstep(0.16 + blurOn, 0.16, length(on)));
  }
  vec3 n = turn(turned, normal);
  float lit = max(dot(n, normalize(light)), 0.0);
  float sky = n.z * 0.5 + 0.5;
  float side = max(dot(n, normalize(eye)), 0.0);
  vec3 shade = base * (ambient * (0.55 + 0.45 * sky) + (1.0 - ambient) * lit * 1.1 + 0.1 * side);
  colour = vec4(mix(shade, ink * (0.6 + 0.4 * ambient + 0.2 * lit), line), 1.0);
}`;

const RIBBON_VERTEX = `#version 300 es
in vec2 corner;
in vec4 begin, end, tint;
in float flow;
uniform mat4 view;
uniform vec3 eyeAt;
uniform float pixel;
out vec4 tintOf;
out vec2 along;
out float flowOf, long_;
void main() {
  vec3 span = end.xyz - begin.xyz;
  vec3 at = mix(begin.xyz, end.xyz, corner.x);
  vec3 side = normalize(cross(span, eyeAt - at) + vec3(1e-6));
  float wide = mix(begin.w, end.w, corner.x);
  // A line that flows stays at least a line.
  if (flow > 0.0) wide = max(wide, pixel * length(eyeAt - at));
  at += side * corner.y * wide;
  tintOf = tint;
  along = corner;
  flowOf = flow;
  long_ = length(span);
  gl_Position = view * vec4(at, 1.0);
}`;

const RIBBON_FRAGMENT = `#version 300 es
precision highp float;
in vec4 tintOf;
in vec2 along;
in float flowOf, long_;
uniform float clock;
out vec4 colour;
void main() {
  float soft = smoothstep(1.0, 0.55, abs(along.y));
  float pulse = 1.0;
  if (flowOf > 0.0) {
    float wave = fract(along.x - clock * 0.7);
    pulse = 0.55 + 0.45 * smoothstep(0.5, 1.0, wave);
  }
  colour = vec4(tintOf.rgb, tintOf.a * soft * pulse);
}`;

const GROUND_VERTEX = `#version 300 es
in vec2 corner;
uniform mat4 view;
uniform vec4 bounds;
uniform float ground;
out vec2 at;
void main() {
  at = mix(bounds.xy, bounds.zw, corner);
  gl_Position = view * vec4(at, ground, 1.0);
}`;

const GROUND_FRAGMENT = `#version 300 es
precision highp float;
in vec2 at;
uniform vec4 bounds;
uniform bool plates;
uniform vec4 fill, line;
out vec4 colour;
void main() {
  // Cells have their middles at whole numbers.
  vec2 blur = fwidth(at);
  vec2 thin = smoothstep(vec2(0.02) + blur, vec2(0.02), abs(fract(at) - 0.5));
  float lines = max(thin.x, thin.y);
  vec2 edge = min(at - bounds.xy, bounds.zw - at);
  float fade = plates ? 1.0 : smoothstep(0.0, 4.0, min(edge.x, edge.y));
  // Far away the lines run into each other and would flicker.
  float calm = 1.0 - smoothstep(0.15, 0.5, max(blur.x, blur.y));
  float mark = 0.0;
  if (plates) {
    float r = length(fract(at + 0.5) - 0.5);
    mark = smoothstep(0.02 + blur.x, 0.01, abs(r - 0.2)) * 0.8;
  }
  float k = max(lines, mark) * calm;
  colour = mix(fill, vec4(line.rgb, max(line.a, fill.a)), k * line.a);
  colour.a = (plates ? colour.a : mix(fill.a, line.a, k)) * fade;
}`;

function isSoftware() {
  const gl = document.createElement("canvas").getContext("webgl2");
  if (!gl) return false;
  const info = gl.getExtension("WEBGL_debug_renderer_info");
  const name = info ? gl.getParameter(info.UNMASKED_RENDERER_WEBGL) : "";
  gl.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|software|softpipe/i.test(name);
}

export class Drawing {
  constructor(canvas) {
    // Without a graphics card smooth edges are too slow while things move; when the picture rests,
    // it is drawn with more pixels instead.
    this.slow = isSoftware();
    const gl = canvas.getContext("webgl2", { alpha: false, antialias: !this.slow, stencil: true });
    if (!gl) throw new Error("this browser has no WebGL 2");
    this.gl = gl;
    this.canvas = canvas;
    this.sharpness = 1;
    this.shadows = true;
    this.unculled = false;
    this.parts = this.program(PARTS_VERTEX, PARTS_FRAGMENT);
    this.ribbons = this.program(RIBBON_VERTEX, RIBBON_FRAGMENT);
    this.ground = this.program(GROUND_VERTEX, GROUND_FRAGMENT);
    this.quad = this.buffer(new Float32Array([0, 0, 1, 0, 1, 1, 0, 0, 1, 1, 0, 1]));
    this.strip = this.buffer(new Float32Array([0, -1, 1, -1, 1, 1, 0, -1, 1, 1, 0, 1]));
    this.groundArray = this.array(() => this.attribute(this.ground, "corner", 2, this.quad, 2, 0, 0));
    this.ribbonBuffer = gl.createBuffer();
    this.ribbonArray = this.array(() => {
      this.attribute(this.ribbons, "corner", 2, this.strip, 2, 0, 0);
      for (const [name, size, at] of [["begin", 4, 0], ["end", 4, 4], ["tint", 4, 8], ["flow", 1, 12]]) {
        this.attribute(this.ribbons, name, size, this.ribbonBuffer, RIBBON, at, 1);
      }
    });
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.CULL_FACE);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
  }

  program(vertex, fragment) {
    const gl = this.gl;
    const program = gl.createProgram();
    for (const [type, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(type);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost()) {
        throw new Error(gl.getShaderInfoLog(shader));
      }
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) {
      throw new Error(gl.getProgramInfoLog(program));
    }
    const places = new Map();
    const uniform = (name) => {
      if (!places.has(name)) places.set(name, gl.getUniformLocation(program, name));
      return places.get(name);
    };
    return { program, uniform };
  }

  buffer(data) {
    const gl = this.gl;
    const buffer = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.bufferData(gl.ARRAY_BUFFER, data, gl.STATIC_DRAW);
    return buffer;
  }

  array(fill) {
    const array = this.gl.createVertexArray();
    this.gl.bindVertexArray(array);
    fill();
    this.gl.bindVertexArray(null);
    return array;
  }

  attribute({ program }, name, size, buffer, stride, at, divisor) {
    const gl = this.gl;
    const place = gl.getAttribLocation(program, name);
    if (place < 0) return;
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.enableVertexAttribArray(place);
    gl.vertexAttribPointer(place, size, gl.FLOAT, false, stride * 4, at * 4);
    gl.vertexAttribDivisor(place, divisor);
  }

  /**
   * A mesh whose instances can be drawn. `round` is a half cube of the Roombots of this size; `facing`
   * are the three sides of a box that are mirrored to where they are seen.
   */
  mesh(vertices, { round = null, facing = false } = {}) {
    const mesh = { count: vertices.length / 3, instances: this.gl.createBuffer(), round, facing };
    const shape = this.buffer(vertices);
    mesh.array = this.array(() => {
      this.attribute(this.parts, "vertex", 3, shape, 3, 0, 0);
      for (const [name, at] of [["place", 0], ["rotation", 4], ["paint", 8], ["edge", 12]]) {
        this.attribute(this.parts, name, 4, mesh.instances, PART, at, 1);
      }
    });
    return mesh;
  }

  fill(buffer, numbers) {
    const gl = this.gl;
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.bufferData(gl.ARRAY_BUFFER, numbers, gl.DYNAMIC_DRAW);
  }

  /** The same parts, the nearest first: what is behind them need not be painted. */
  nearestFirst(numbers, out) {
    const count = numbers.length / PART;
    if (this.order?.length !== count) {
      this.order = Uint32Array.from({ length: count }, (_, i) => i);
      this.depths = new Float32Array(count);
      this.sorted = new Float32Array(numbers.length);
    }
    for (let i = 0; i < count; i++) {
      const at = i * PART;
      this.depths[i] = numbers[at] * out[0] + numbers[at + 1] * out[1] + numbers[at + 2] * out[2];
    }
    this.order.sort((a, b) => this.depths[b] - this.depths[a]);
    for (let i = 0; i < count; i++) {
      const at = this.order[i] * PART;
      this.sorted.set(numbers.subarray(at, at + PART), i * PART);
    }
    return this.sorted;
  }

  resize() {
    const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight].map((x) =>
      Math.max(1, Math.round(x * this.sharpness)),
    );
    if (this.canvas.width !== width || this.canvas.height !== height) {
      this.canvas.width = width;
      this.canvas.height = height;
    }
    return width / height;
  }

  /**
   * Draws one picture: `paper` behind, the `ground`, `groups` of parts (a mesh and its numbers), what is
   * `chosen` with an outline, `ghosts` as wires, `links` among the parts and `marks` over them.
   */
  draw({ camera, paper, ground, groups, ghosts, chosen, links, marks, light, clock, dark }) {
    const gl = this.gl;
    camera.aspect = this.resize();
    const view = camera.matrix();
    const { out, position } = camera.eye();
    gl.viewport(0, 0, this.canvas.width, this.canvas.height);
    gl.clearColor(...paper, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT | gl.STENCIL_BUFFER_BIT);
    const above = out[2] > 0;

    if (ground && above) {
      gl.useProgram(this.ground.program);
      const u = this.ground.uniform;
      gl.uniformMatrix4fv(u("view"), false, view);
      gl.uniform4fv(u("bounds"), ground.bounds);
      gl.uniform1f(u("ground"), ground.z);
      gl.uniform1i(u("plates"), ground.plates);
      gl.uniform4fv(u("fill"), ground.fill);
      gl.uniform4fv(u("line"), ground.line);
      gl.enable(gl.BLEND);
      gl.depthMask(false);
      gl.bindVertexArray(this.groundArray);
      gl.drawArrays(gl.TRIANGLES, 0, 6);
      gl.depthMask(true);
      gl.disable(gl.BLEND);
    }

    gl.useProgram(this.parts.program);
    const u = this.parts.uniform;
    gl.uniformMatrix4fv(u("view"), false, view);
    gl.uniform3fv(u("light"), light);
    gl.uniform3fv(u("eye"), out);
    gl.uniform3fv(u("eyeAt"), position);
    gl.uniform1f(u("ambient"), dark ? 0.5 : 0.66);
    gl.uniform1f(u("ground"), (ground?.z ?? 0) + 0.004);
    for (const { mesh, numbers } of groups) this.fill(mesh.instances, this.nearestFirst(numbers, out));

    if (ground && above && this.shadows) {
      // Each place of the ground is darkened once, however many shadows meet there.
      gl.enable(gl.BLEND);
      gl.enable(gl.STENCIL_TEST);
      gl.stencilFunc(gl.EQUAL, 0, 255);
      gl.stencilOp(gl.KEEP, gl.KEEP, gl.INCR);
      gl.disable(gl.CULL_FACE);
      this.unculled = true;
      gl.depthMask(false);
      gl.uniform1i(u("shadow"), 1);
      gl.uniform4f(u("flat_"), 0, 0, 0, dark ? 0.34 : 0.13);
      groups.forEach((group) => this.instances(group));
      gl.uniform1i(u("shadow"), 0);
      gl.depthMask(true);
      this.unculled = false;
      gl.enable(gl.CULL_FACE);
      gl.disable(gl.STENCIL_TEST);
      gl.disable(gl.BLEND);
    }
    gl.uniform1i(u("shadow"), 0);

    if (chosen) {
      gl.uniform1i(u("outline"), 1);
      gl.uniform1f(u("grow"), 0.12);
      gl.uniform4f(u("flat_"), ...chosen.colour, 1);
      gl.cullFace(gl.FRONT);
      this.fill(chosen.mesh.instances, chosen.numbers);
      this.instances(chosen);
      gl.cullFace(gl.BACK);
      gl.uniform1i(u("outline"), 0);
    }
    gl.uniform1f(u("grow"), 0);
    groups.forEach((group) => this.instances(group));
    this.drawRibbons(links, view, position, clock, true);
    if (ghosts) {
      gl.useProgram(this.parts.program);
      gl.enable(gl.BLEND);
      gl.depthMask(false);
      gl.uniform1i(u("outline"), 1);
      gl.uniform4f(u("flat_"), ...ghosts.colour);
      this.fill(ghosts.mesh.instances, ghosts.numbers);
      this.instances(ghosts, gl.LINES);
      gl.uniform1i(u("outline"), 0);
      gl.depthMask(true);
      gl.disable(gl.BLEND);
    }
    if (chosen) {
      // What is chosen is seen through everything.
      gl.useProgram(this.parts.program);
      gl.enable(gl.BLEND);
      gl.disable(gl.DEPTH_TEST);
      gl.uniform1i(u("outline"), 1);
      gl.uniform1f(u("grow"), 0.1);
      gl.uniform4f(u("flat_"), ...chosen.colour, 0.2);
      this.fill(chosen.mesh.instances, chosen.numbers);
      this.instances(chosen);
      gl.uniform1i(u("outline"), 0);
      gl.uniform1f(u("grow"), 0);
      gl.enable(gl.DEPTH_TEST);
      gl.disable(gl.BLEND);
    }
    this.drawRibbons(marks, view, position, clock, false);
    gl.bindVertexArray(null);
  }

  instances({ mesh, numbers }, what = this.gl.TRIANGLES) {
    const gl = this.gl;
    const u = this.parts.uniform;
    gl.uniform1i(u("round"), mesh.round !== null);
    gl.uniform1i(u("facing"), mesh.facing);
    // Mirrored sides have no inside and outside.
    if (mesh.facing) gl.disable(gl.CULL_FACE);
    if (mesh.round) {
      gl.uniform1f(u("radius"), mesh.round.radius);
      gl.uniform1f(u("half_"), mesh.round.edge);
    }
    gl.bindVertexArray(mesh.array);
    gl.drawArraysInstanced(what, 0, mesh.count, numbers.length / PART);
    if (mesh.facing && !this.unculled) gl.enable(gl.CULL_FACE);
  }

  drawRibbons(numbers, view, position, clock, behind) {
    if (numbers.length === 0) return;
    const gl = this.gl;
    gl.useProgram(this.ribbons.program);
    const u = this.ribbons.uniform;
    gl.uniformMatrix4fv(u("view"), false, view);
    gl.uniform3fv(u("eyeAt"), position);
    gl.uniform1f(u("clock"), clock);
    gl.uniform1f(u("pixel"), 0.7 / this.canvas.clientHeight);
    gl.enable(gl.BLEND);
    gl.disable(gl.CULL_FACE);
    gl.depthMask(false);
    if (!behind) gl.disable(gl.DEPTH_TEST);
    this.fill(this.ribbonBuffer, numbers);
    gl.bindVertexArray(this.ribbonArray);
    gl.drawArraysInstanced(gl.TRIANGLES, 0, 6, numbers.length / RIBBON);
    gl.enable(gl.DEPTH_TEST);
    gl.depthMask(true);
    gl.enable(gl.CULL_FACE);
    gl.disable(gl.BLEND);
  }
}
