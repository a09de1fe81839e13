// What colours mean: the scales, and the entries of the legend.

import { sizes } from "./hosts.js";

/** The meanings of colours, and their names. */
export const MEANINGS = {
  state: "state",
  level: "level of the goal",
  gradient: "gradient",
  locks: "locks",
  host: "host",
};

/** Number of hosts in the legend. */
const HOSTS = 12;

/** Meanings that depend on messages between modules. */
export const TOLD = ["gradient", "locks"];
export const UNSEEN = "messages between modules are not available while processes run";

/** A scale of colours from near to far, readable in grey and without colour vision (viridis). */
const SCALE = [
  [0.267, 0.005, 0.329],
  [0.231, 0.318, 0.545],
  [0.128, 0.567, 0.551],
  [0.369, 0.789, 0.383],
  [0.993, 0.906, 0.144],
];

export function scale(x) {
  const at = Math.max(0, Math.min(0.9999, x)) * (SCALE.length - 1);
  const i = Math.floor(at);
  return SCALE[i].map((c, k) => c + (SCALE[i + 1][k] - c) * (at - i));
}

export const css = (rgb) => `rgb(${rgb.map((c) => Math.round(c * 255)).join(" ")})`;

/** Returns a distinct colour for every module, for locks. */
export const ownColour = (id) => {
  const hue = (id * 0.618034) % 1;
  return [0, 1 / 3, 2 / 3].map((o) => 0.5 + 0.32 * Math.cos(2 * Math.PI * (hue + o)));
};

/** Returns the entries of the legend of a picture: text, colour and pattern. `seen` is what `Picture.build` returned. */
export function legend(scene, colour, meaning, { farthest, circle, arrows, counts, talk }) {
  const swatch = (text, rgb, pattern) => ({ text, colour: css(rgb), pattern });
  const told = talk || !TOLD.includes(meaning);
  const entries = told ? meanings(scene, meaning, farthest, swatch, colour, counts) : [swatch(scene.messages ? "loading" : UNSEEN, colour.none)];
  if (circle.size) entries.push(swatch("wait for each other in a circle", colour.bad));
  if (arrows) entries.push(swatch("waits for", colour.wait));
  return entries;
}

function meanings({ words: { roles, levels, distance }, hosts }, meaning, farthest, swatch, colour, counts) {
  const lives = [];
  if (counts.unheard) lives.push(swatch("not heard of yet", colour.none));
  if (counts.dead) lives.push(swatch("dead", colour.dead, "dead"));
  if (counts.paused) lives.push(swatch("paused", colour.paused, "paused"));
  if (counts.stuck) lives.push(swatch("stuck", colour.none, "stuck"));
  const ramp = (from, to, near, far) => ({
    ramp: [0, 0.25, 0.5, 0.75, 1].map((x) => css(scale(from + (to - from) * x))),
    near,
    far,
  });
  switch (meaning) {
    case "state": {
      const named = roles.filter(({ legend }, i) => roles.findIndex((other) => other.legend === legend) === i);
      return [...named.map((role) => swatch(role.legend, colour[role.colour])), ...lives];
    }
    case "level":
      return [ramp(0.08, 0.96, ...levels), swatch("not in the goal", colour.none)];
    case "gradient":
      return [ramp(1, 0, "at a target", `${farthest} ${distance[1]}`), swatch("knows no target", colour.none)];
    case "host": {
      const modules = sizes(hosts);
      return [...hosts.names.slice(0, HOSTS).map((name, i) => swatch(`${name}: ${modules[i]}`, ownColour(i))), ...lives];
    }
    default:
      return [swatch("locks a module, or is locked by one", ownColour(3)), swatch("no lock", colour.none)];
  }
}
