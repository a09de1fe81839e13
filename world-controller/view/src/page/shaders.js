// The shaders of the page, in GLSL 3: parts of bodies with their patterns, outlines, ribbons between points, the
// ground and the shadows on it. They light each body once by its place and side, so that a picture without a graphics
// card is quick.

/** Turns a vector by a quaternion. */
const TURN = "vec3 turn(vec4 q, vec3 v) { return v + 2.0 * cross(q.xyz, cross(q.xyz, v) + q.w * v); }";

/** Parts of bodies. `TURNED` is defined for those with a rotation, `ROUND` for half balls with plates. */
export const PARTS_VERTEX = `
in vec3 position;
in vec4 place, rotation, paint, edge;
uniform mat4 projectionMatrix, viewMatrix;
uniform float grow;
uniform bool facing;
uniform vec4 eyeAt;
uniform vec3 size;
out vec3 local;
flat out vec4 paintOf, edgeOf;
#ifdef TURNED
flat out vec4 turned;
#endif
${TURN}
void main() {
  local = position;
  // Of an upright box only the three visible sides are drawn.
  if (facing) local *= mix(vec3(-1), vec3(1), step(vec3(0), eyeAt.xyz - eyeAt.w * place.xyz));
  paintOf = paint;
  edgeOf = edge;
  vec3 arm = local * (size * place.w + grow);
#ifdef TURNED
  turned = rotation;
  arm = turn(rotation, arm);
#endif
  vec3 at = place.xyz + arm;
  gl_Position = projectionMatrix * viewMatrix * vec4(at, 1.0);
}`;

export const PARTS_FRAGMENT = `
precision highp float;
in vec3 local;
flat in vec4 paintOf, edgeOf;
uniform vec3 light, eye, size;
uniform float radius, half_, ambient;
out vec4 colour;
#ifdef TURNED
flat in vec4 turned;
${TURN}
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

/** A single colour, for outlines and wires. */
export const FLAT_FRAGMENT = `
precision mediump float;
uniform vec4 flat_;
out vec4 colour;
void main() { colour = flat_; }`;

export const SHADOW_VERTEX = `
in vec3 position;
in vec4 place, rotation;
uniform vec4 bounds;
uniform float ground;
uniform bool facing;
uniform vec3 light, size;
${TURN}
void main() {
  vec3 local = facing ? position * mix(vec3(-1), vec3(1), step(vec3(0), light)) : position;
  vec3 at = place.xyz + turn(rotation, local * size * place.w);
  at += light * ((ground - at.z) / light.z);
  gl_Position = vec4((at.xy - bounds.xy) / (bounds.zw - bounds.xy) * 2.0 - 1.0, 0.0, 1.0);
}`;

export const SHADOW_FRAGMENT = `
precision mediump float;
out vec4 colour;
void main() { colour = vec4(1); }`;

export const RIBBON_VERTEX = `
in vec2 position;
in vec4 begin, end, tint;
in float flow;
uniform mat4 projectionMatrix, viewMatrix;
// The eye; in parallel projection the direction towards it, and 0.
uniform vec4 eyeAt;
uniform float pixel;
out vec4 tintOf;
out vec2 along;
out float flowOf, long_;
void main() {
  vec3 span = end.xyz - begin.xyz;
  vec3 at = mix(begin.xyz, end.xyz, position.x);
  vec3 side = normalize(cross(span, eyeAt.xyz - eyeAt.w * at) + vec3(1e-6));
  float wide = mix(begin.w, end.w, position.x);
  // A flowing line is at least one pixel wide.
  if (flow > 0.0) wide = max(wide, pixel * mix(1.0, length(eyeAt.xyz - at), eyeAt.w));
  at += side * position.y * wide;
  tintOf = tint;
  along = position;
  flowOf = flow;
  long_ = length(span);
  gl_Position = projectionMatrix * viewMatrix * vec4(at, 1.0);
}`;

export const RIBBON_FRAGMENT = `
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

export const GROUND_VERTEX = `
in vec2 position;
uniform mat4 projectionMatrix, viewMatrix;
uniform vec4 bounds;
uniform float ground;
out vec2 at;
void main() {
  at = mix(bounds.xy, bounds.zw, position);
  gl_Position = projectionMatrix * viewMatrix * vec4(at, ground, 1.0);
}`;

export const GROUND_FRAGMENT = `
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
