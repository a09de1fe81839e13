// Draws with WebGL 2: parts of bodies as instances of one mesh, ribbons between points, a ground with
// shadows. Independent of swarms. Draws only on request.

export const PATTERN = { plain: 0, dead: 1, paused: 2, stuck: 3 };
/** Number of values of one part: place and size, rotation, colour and pattern, edge colour and visibility. */
export const PART = 16;
/** Number of values of one ribbon: from, width there, to, width there, colour, speed of flow. */
export const RIBBON = 13;

const PARTS_VERTEX = `
in vec3 vertex;
in vec4 place, rotation, paint, edge;
uniform mat4 view;
uniform float grow;
uniform bool facing;
uniform vec3 eyeAt, size;
out vec3 local;
flat out vec4 paintOf, edgeOf;
#ifdef TURNED
flat out vec4 turned;
#endif
vec3 turn(vec4 q, vec3 v) { return v + 2.0 * cross(q.xyz, cross(q.xyz, v) + q.w * v); }
void main() {
  local = vertex;
  // Of an upright box only the three visible sides are drawn.
  if (facing) local *= mix(vec3(-1), vec3(1), step(vec3(0), eyeAt - place.xyz));
  paintOf = paint;
  edgeOf = edge;
  vec3 arm = local * (size * place.w + grow);
#ifdef TURNED
  turned = rotation;
  arm = turn(rotation, arm);
#endif
  vec3 at = place.xyz + arm;
  gl_Position = view * vec4(at, 1.0);
}`;

const SHADOW_VERTEX = `#version 300 es
in vec3 vertex;
in vec4 place, rotation;
uniform vec4 bounds;
uniform float ground;
uniform bool facing;
uniform vec3 light, size;
vec3 turn(vec4 q, vec3 v) { return v + 2.0 * cross(q.xyz, cross(q.xyz, v) + q.w * v); }
void main() {
  vec3 local = facing ? vertex * mix(vec3(-1), vec3(1), step(vec3(0), light)) : vertex;
  vec3 at = place.xyz + turn(rotation, local * size * place.w);
  at += light * ((ground - at.z) / light.z);
  gl_Position = vec4((at.xy - bounds.xy) / (bounds.zw - bounds.xy) * 2.0 - 1.0, 0.0, 1.0);
}`;

const SHADOW_FRAGMENT = `#version 300 es
precision mediump float;
out vec4 colour;
void main() { colour = vec4(1); }`;

/** A single colour, for outlines and wires. */
const FLAT_FRAGMENT = `
precision mediump float;
uniform vec4 flat_;
out vec4 colour;
void main() { colour = flat_; }`;

const PARTS_FRAGMENT = `
precision highp float;
in vec3 local;
flat in vec4 paintOf, edgeOf;
uniform vec3 light, eye, size;
uniform float radius, half_, ambient;
out vec4 colour;
#ifdef TURNED
flat in vec4 turned;
vec3 turn(vec4 q, vec3 v) { return v + 2.0 * cross(q.xyz, cross(q.xyz, v) + q.w * v); }
#endif
void main() {
  int pattern = int(paintOf.w + 0.5);
  vec3 normal;
  vec2 on;
  float line;
#ifdef ROUND
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
    vec3 base = paintOf.rgb, ink = base * 0.42;
#else
    vec3 a = abs(local);
    float most = max(a.x, max(a.y, a.z));
    vec3 s = sign(local);
    vec3 axis = a.x == most ? vec3(s.x, 0, 0) : a.y == most ? vec3(0, s.y, 0) : vec3(0, 0, s.z);
    on = a.x == most ? local.yz : a.y == most ? local.zx : local.xy;
    vec2 gap = (0.5 - abs(on)) * (a.x == most ? size.yz : a.y == most ? size.zx : size.xy);
    float border = min(gap.x, gap.y);
    float blur = fwidth(border) + 1e-5;
    vec3 bevel = normalize(axis + local * 0.9);
    normal = normalize(mix(axis, bevel, smoothstep(0.1, 0.02, border)));
    line = smoothstep(0.035 + blur, 0.03 - blur * 0.5, border) * 0.8;
    vec3 base = paintOf.rgb, ink = edgeOf.rgb;
#endif
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
#ifdef TURNED
  vec3 n = turn(turned, normal);
#else
  vec3 n = normal;
#endif
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
  // A flowing line is at least one pixel wide.
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
uniform sampler2D shade;
uniform float shadow;
out vec4 colour;
void main() {
  // The centres of cells are at whole numbers.
  vec2 blur = fwidth(at);
  vec2 thin = smoothstep(vec2(0.02) + blur, vec2(0.02), abs(fract(at) - 0.5));
  float lines = max(thin.x, thin.y);
  vec2 edge = min(at - bounds.xy, bounds.zw - at);
  float fade = plates ? 1.0 : smoothstep(0.0, 4.0, min(edge.x, edge.y));
  // Far away the lines merge and would flicker.
  float calm = 1.0 - smoothstep(0.15, 0.5, max(blur.x, blur.y));
  float mark = 0.0;
  if (plates) {
    float r = length(fract(at + 0.5) - 0.5);
    mark = smoothstep(0.02 + blur.x, 0.01, abs(r - 0.2)) * 0.8;
  }
  float k = max(lines, mark) * calm;
  colour = mix(fill, vec4(line.rgb, max(line.a, fill.a)), k * line.a);
  colour.a = (plates ? colour.a : mix(fill.a, line.a, k)) * fade;
  // The shadow covers the ground.
  float dark = shadow * texture(shade, (at - bounds.xy) / (bounds.zw - bounds.xy)).r;
  float all = dark + colour.a * (1.0 - dark);
  colour = vec4(colour.rgb * colour.a * (1.0 - dark) / max(all, 1e-4), all);
}`;

/** Side of the texture of shadows, in pixels. */
const SHADE = 1024;

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
    // Without a graphics card antialiasing is too slow while bodies move; a picture at rest is drawn with
    // more pixels instead.
    this.slow = isSoftware();
    const gl = canvas.getContext("webgl2", { alpha: false, antialias: !this.slow });
    if (!gl) throw new Error("this browser has no WebGL 2");
    this.gl = gl;
    this.canvas = canvas;
    this.sharpness = 1;
    this.shadows = true;
    const variant = (how, text) => `#version 300 es\n${how}${text}`;
    const programs = (how) => [PARTS_FRAGMENT, FLAT_FRAGMENT].map((text) => this.program(variant(how, PARTS_VERTEX), variant(how, text)));
    const turned = "#define TURNED\n";
    [this.boxes, this.flatBoxes] = programs("");
    [this.turnedBoxes, this.flatTurned] = programs(turned);
    this.round = this.program(variant(turned, PARTS_VERTEX), variant(`${turned}#define ROUND\n`, PARTS_FRAGMENT));
    this.shadow = this.program(SHADOW_VERTEX, SHADOW_FRAGMENT);
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
    this.shade = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, this.shade);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.R8, SHADE, SHADE, 0, gl.RED, gl.UNSIGNED_BYTE, null);
    for (const side of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, side, gl.CLAMP_TO_EDGE);
    for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, filter, gl.LINEAR);
    this.shadePlace = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.shadePlace);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, this.shade, 0);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    /** True if the shadows match the parts. */
    this.shaded = false;
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
    // The same locations in every program, so that one mesh can be drawn with each.
    ["vertex", "place", "rotation", "paint", "edge"].forEach((name, i) => gl.bindAttribLocation(program, i, name));
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
   * Returns a mesh whose instances can be drawn, scaled by `size`. `round` is half a ball with plates of this
   * radius and half edge; instances of others may be `turned` or stand upright. `facing` has only three sides
   * of an upright box, mirrored to those that are visible.
   */
  mesh(vertices, { size = [1, 1, 1], round = null, turned = false, facing = false } = {}) {
    const mesh = { count: vertices.length / 3, instances: this.gl.createBuffer(), size, round, turned, facing };
    const shape = this.buffer(vertices);
    mesh.array = this.array(() => {
      this.attribute(this.round, "vertex", 3, shape, 3, 0, 0);
      for (const [name, at] of [["place", 0], ["rotation", 4], ["paint", 8], ["edge", 12]]) {
        this.attribute(this.round, name, 4, mesh.instances, PART, at, 1);
      }
    });
    return mesh;
  }

  fill(buffer, numbers) {
    const gl = this.gl;
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.bufferData(gl.ARRAY_BUFFER, numbers, gl.DYNAMIC_DRAW);
  }

  /** Returns the visible parts, nearest first, so that hidden pixels are not painted. */
  nearestFirst(mesh, numbers, out) {
    if ((mesh.room ?? 0) < numbers.length) {
      mesh.room = numbers.length * 2;
      mesh.sorted = new Float32Array(mesh.room);
      mesh.order = new Uint32Array(mesh.room / PART);
      mesh.depths = new Float32Array(mesh.room / PART);
    }
    const { order, depths, sorted } = mesh;
    let seen = 0;
    for (let i = 0, at = 0; at < numbers.length; i++, at += PART) {
      if (numbers[at + 15] === 0) continue;
      depths[i] = numbers[at] * out[0] + numbers[at + 1] * out[1] + numbers[at + 2] * out[2];
      order[seen++] = i;
    }
    order.subarray(0, seen).sort((a, b) => depths[b] - depths[a]);
    for (let i = 0, to = 0; i < seen; i++) {
      for (let from = order[i] * PART, k = 0; k < PART; k++) sorted[to++] = numbers[from++];
    }
    mesh.seen = seen;
    return sorted.subarray(0, seen * PART);
  }

  /** Paints the shadows of the parts on the ground. */
  paintShadows(groups, ground, light) {
    const gl = this.gl;
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.shadePlace);
    gl.viewport(0, 0, SHADE, SHADE);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.useProgram(this.shadow.program);
    const u = this.shadow.uniform;
    gl.uniform4fv(u("bounds"), ground.bounds);
    gl.uniform1f(u("ground"), ground.z);
    gl.uniform3fv(u("light"), light);
    gl.disable(gl.CULL_FACE);
    gl.disable(gl.DEPTH_TEST);
    for (const { mesh } of groups) {
      gl.uniform1i(u("facing"), mesh.facing);
      gl.uniform3fv(u("size"), mesh.size);
      gl.bindVertexArray(mesh.array);
      gl.drawArraysInstanced(gl.TRIANGLES, 0, mesh.count, mesh.seen);
    }
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.CULL_FACE);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    this.shaded = true;
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
   * Draws one picture: the background `paper`, the `ground`, `groups` of parts (a mesh and its values), the
   * `chosen` ones with an `outline`, `ghosts` as wires, `links` among the parts and `marks` over them.
   */
  draw({ camera, paper, ground, groups, ghosts, chosen, outline, links, marks, light, clock, dark }) {
    const gl = this.gl;
    camera.aspect = this.resize();
    const view = camera.matrix();
    const { out, position } = camera.eye();
    const above = out[2] > 0;
    for (const { mesh, numbers } of groups) this.fill(mesh.instances, this.nearestFirst(mesh, numbers, out));
    if (ground && above && this.shadows && !this.shaded) this.paintShadows(groups, ground, light);

    gl.viewport(0, 0, this.canvas.width, this.canvas.height);
    gl.clearColor(...paper, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    if (ground && above) {
      gl.useProgram(this.ground.program);
      const u = this.ground.uniform;
      gl.uniformMatrix4fv(u("view"), false, view);
      gl.uniform4fv(u("bounds"), ground.bounds);
      gl.uniform1f(u("ground"), ground.z);
      gl.uniform1i(u("plates"), ground.plates);
      gl.uniform4fv(u("fill"), ground.fill);
      gl.uniform4fv(u("line"), ground.line);
      gl.uniform1f(u("shadow"), this.shadows ? (dark ? 0.34 : 0.13) : 0);
      gl.enable(gl.BLEND);
      gl.depthMask(false);
      gl.bindVertexArray(this.groundArray);
      gl.drawArrays(gl.TRIANGLES, 0, 6);
      gl.depthMask(true);
      gl.disable(gl.BLEND);
    }

    const eye = { view, position, out };
    gl.cullFace(gl.FRONT);
    for (const one of chosen) {
      this.fill(one.mesh.instances, one.numbers);
      this.flat(one, eye, 0.12, [...outline, 1]);
    }
    gl.cullFace(gl.BACK);
    for (const { mesh } of groups) {
      const program = mesh.round ? this.round : mesh.turned ? this.turnedBoxes : this.boxes;
      this.look(program, mesh, eye, 0);
      const u = program.uniform;
      gl.uniform3fv(u("light"), light);
      gl.uniform3fv(u("eye"), out);
      gl.uniform1f(u("ambient"), dark ? 0.5 : 0.66);
      if (mesh.round) {
        gl.uniform1f(u("radius"), mesh.round.radius);
        gl.uniform1f(u("half_"), mesh.round.edge);
      }
      this.instances(mesh, mesh.seen);
    }
    this.drawRibbons(links, view, position, clock, true);
    gl.enable(gl.BLEND);
    gl.depthMask(false);
    if (ghosts) {
      this.fill(ghosts.mesh.instances, ghosts.numbers);
      this.flat(ghosts, eye, 0, ghosts.colour, gl.LINES);
    }
    // The chosen module shows through everything.
    gl.disable(gl.DEPTH_TEST);
    for (const one of chosen) this.flat(one, eye, 0.1, [...outline, 0.2]);
    gl.enable(gl.DEPTH_TEST);
    gl.depthMask(true);
    gl.disable(gl.BLEND);
    this.drawRibbons(marks, view, position, clock, false);
    gl.bindVertexArray(null);
  }

  /** Sets the view of a mesh, and by how much it grows. */
  look(program, mesh, { view, position }, grow) {
    const gl = this.gl;
    gl.useProgram(program.program);
    gl.uniformMatrix4fv(program.uniform("view"), false, view);
    gl.uniform3fv(program.uniform("eyeAt"), position);
    gl.uniform1i(program.uniform("facing"), mesh.facing);
    gl.uniform1f(program.uniform("grow"), grow);
    gl.uniform3fv(program.uniform("size"), mesh.size);
  }

  flat({ mesh, numbers }, eye, grow, colour, what = this.gl.TRIANGLES) {
    const program = mesh.turned ? this.flatTurned : this.flatBoxes;
    this.look(program, mesh, eye, grow);
    this.gl.uniform4fv(program.uniform("flat_"), colour);
    this.instances(mesh, numbers.length / PART, what);
  }

  instances(mesh, count, what = this.gl.TRIANGLES) {
    const gl = this.gl;
    // Mirroring reverses the winding of sides.
    if (mesh.facing) gl.disable(gl.CULL_FACE);
    gl.bindVertexArray(mesh.array);
    gl.drawArraysInstanced(what, 0, mesh.count, count);
    if (mesh.facing) gl.enable(gl.CULL_FACE);
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
