// Lines between modules: the messages that they send, and who waits for whom. Independent of how bodies look.

/** Adds a ribbon. */
function ribbon(into, a, wa, b, wb, rgba, flow) {
  into.push(...a, wa, ...b, wb, ...rgba, flow);
}

/** Adds a line for each contact, a pair of modules. */
export function contactLines(into, contacts, middles, colour) {
  for (const [a, b] of contacts) {
    if (middles[a] && middles[b]) ribbon(into, middles[a], 0.03, middles[b], 0.03, [...colour, 1], 0);
  }
}

/** Adds a bent arrow from one point to another. */
export function arrow(into, a, b, rgba, width) {
  if (!a || !b) return;
  const length = Math.hypot(...a.map((x, i) => x - b[i]));
  const rise = 0.5 + length * 0.22;
  const at = (s) => a.map((x, i) => x + (b[i] - x) * s + (i === 2 ? rise * 4 * s * (1 - s) : 0));
  const pieces = 12;
  const neck = 1 - Math.min(0.35, (width * 5) / Math.max(length, 0.1));
  for (let i = 0; i < pieces; i++) {
    ribbon(into, at((i / pieces) * neck), width, at(((i + 1.08) / pieces) * neck), width, rgba, 0);
  }
  ribbon(into, at(neck - 0.01), width * 3.2, at(1), 0, rgba, 0);
}

/**
 * Adds the messages of a time bin of this many seconds. `edges` has sender, receiver and a count for each class;
 * `shown` says which classes count. Each line has the colour of its most frequent class, and is raised by `lift`. Lines
 * between modules of two hosts, of which `homes` has the numbers, are twice as wide.
 */
export function messageLines(into, { edges, middles, shown, colours, seconds, lift, homes }) {
  const n = shown.length;
  for (let i = 0; i < edges.length; i += 2 + n) {
    const [from, to] = [middles[edges[i]], middles[edges[i + 1]]];
    let [sum, top, which] = [0, 0, 0];
    for (let k = 0; k < n; k++) {
      const count = shown[k] ? edges[i + 2 + k] : 0;
      sum += count;
      if (count > top) [top, which] = [count, k];
    }
    if (sum === 0 || !from || !to) continue;
    const often = Math.log2(1 + sum / seconds);
    const strong = Math.min(1, 0.5 + 0.2 * often);
    const crosses = homes && homes[edges[i]] !== homes[edges[i + 1]];
    const width = (0.03 + 0.05 * Math.min(1, often / 5)) * (crosses ? 2 : 1);
    // The two directions are drawn side by side.
    const d = to.map((x, k) => x - from[k]);
    const across = [d[1] - d[2], d[2] - d[0], d[0] - d[1]];
    const length = Math.hypot(...across) || 1;
    const aside = across.map((x) => (x / length) * 0.09);
    const place = (p) => p.map((x, k) => x + aside[k] + (k === 2 ? lift : 0));
    ribbon(into, place(from), width, place(to), width, [...colours[which], strong], 1);
  }
}
