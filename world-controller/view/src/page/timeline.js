// The timeline under the picture: progress of the goal, moves, messages by class, faults. One row each, with a
// line at the time of the picture; a press or drag goes to a time.

import { UNSEEN } from "./legend.js";

const ROWS = [
  { key: "filled", title: "goal", share: 0.8 },
  { key: "moves", title: "", share: 0.8 },
  { key: "messages", title: "messages/s", share: 1.4 },
];
const LEFT = 76;
const RIGHT = 14;
const TOP = 16;
const BOTTOM = 20;

export class Timeline {
  constructor(canvas, head, tip, story) {
    this.canvas = canvas;
    this.head = head;
    this.tip = tip;
    this.story = story;
    this.shown = story.scene.classes.map(() => true);
    /** @type {(t: number) => void} */
    this.onSeek = () => {};
    this.drawn = false;
    const seek = (e) => this.onSeek(this.timeAt(e.offsetX));
    canvas.addEventListener("pointerdown", (e) => {
      canvas.setPointerCapture(e.pointerId);
      seek(e);
    });
    canvas.addEventListener("pointermove", (e) => {
      if (e.buttons & 1) seek(e);
      this.hover(e);
    });
    canvas.addEventListener("pointerleave", () => (this.tip.hidden = true));
  }

  get span() {
    return Math.max(this.story.now, 1);
  }
  x(t) {
    return LEFT + (t / this.span) * (this.canvas.clientWidth - LEFT - RIGHT);
  }
  timeAt(x) {
    const share = (x - LEFT) / (this.canvas.clientWidth - LEFT - RIGHT);
    return Math.max(0, Math.min(1, share)) * this.span;
  }

  title({ key, title }) {
    return key === "moves" ? `${this.story.scene.words.actions}/s` : title;
  }

  hover(e) {
    const t = this.timeAt(e.offsetX);
    const { story } = this;
    const near = story.faults.filter((f) => Math.abs(this.x(f.t) - e.offsetX) < 5).slice(0, 4);
    const bin = story.totals[story.binAt(t)];
    if (!bin) return;
    const seconds = story.width / 1e6;
    const rate = (n) => (n / seconds).toLocaleString("en", { maximumFractionDigits: 1 });
    const lines = [
      `${(t / 1e6).toFixed(2)} s`,
      `${bin[2].toLocaleString("en")} of ${bin[3].toLocaleString("en")} filled`,
      `${rate(bin[1])} ${this.title(ROWS[1])}`,
      ...story.scene.classes
        .map((name, i) => [name, bin[0][i]])
        .filter(([, n]) => n > 0)
        .map(([name, n]) => `${rate(n)} ${name}/s`),
      ...near.map((f) => `${f.what}: ${f.effect}`),
    ];
    this.tip.replaceChildren(...lines.map((line) => Object.assign(document.createElement("div"), { textContent: line })));
    this.tip.hidden = false;
    const box = this.canvas.getBoundingClientRect();
    const width = this.tip.offsetWidth;
    this.tip.style.left = `${Math.max(4, Math.min(window.innerWidth - width - 8, e.clientX + 12))}px`;
    this.tip.style.top = `${box.top - this.tip.offsetHeight - 6}px`;
  }

  /** Makes the next call draw everything. */
  refresh() {
    this.drawn = false;
  }

  /** Marks a time. The rest is drawn only after a change. */
  draw(t) {
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight];
    if (width === 0) return;
    if (!this.drawn) {
      this.drawn = true;
      this.canvas.width = Math.round(width * ratio);
      this.canvas.height = Math.round(height * ratio);
      this.background(this.canvas.getContext("2d"), width, height, ratio);
    }
    this.head.style.transform = `translateX(${this.x(t).toFixed(1)}px)`;
  }

  background(paint, width, height, ratio) {
    const style = getComputedStyle(this.canvas);
    const colour = (name) => style.getPropertyValue(name).trim();
    const { story } = this;
    paint.setTransform(ratio, 0, 0, ratio, 0, 0);
    paint.font = `11px ${style.fontFamily}`;
    const shares = ROWS.reduce((sum, row) => sum + row.share, 0);
    const gap = 9;
    const room = height - TOP - BOTTOM - gap * (ROWS.length - 1);
    let top = TOP;
    const seconds = story.width / 1e6;
    this.times(paint, height, colour);
    for (const cut of story.scene.partitions) {
      paint.fillStyle = colour("--cut");
      paint.fillRect(this.x(cut[1]), TOP, this.x(cut[2]) - this.x(cut[1]), height - TOP - BOTTOM);
    }
    for (const row of ROWS) {
      const tall = (room * row.share) / shares;
      const base = top + tall;
      const parts = this.rows(row.key, seconds);
      // A single high peak, as at the beginning, would flatten the rest; it is cut, and marked as such.
      const sorted = [...parts.tops].sort((a, b) => a - b);
      const usual = sorted[Math.floor(sorted.length * 0.97)] ?? 0;
      const cut = usual > 0 && parts.most > 2.5 * usual;
      const most = Math.max(cut ? usual * 1.25 : parts.most, 1e-9);
      const y = (v) => base - Math.min(v / most, 1) * tall;
      for (const { colour: name, low, high } of parts.areas) {
        paint.fillStyle = colour(name);
        paint.beginPath();
        this.outline(high, (i, v) => paint.lineTo(i, y(v)), false);
        this.outline(low, (i, v) => paint.lineTo(i, y(v)), true);
        paint.fill();
      }
      paint.fillStyle = colour("--line");
      paint.fillRect(LEFT, base, width - LEFT - RIGHT, 1);
      paint.textAlign = "right";
      paint.textBaseline = "bottom";
      paint.fillStyle = colour("--ink");
      paint.fillText(this.title(row), LEFT - 8, base + 2);
      paint.fillStyle = colour("--soft");
      paint.textBaseline = "top";
      if (parts.most > 0) paint.fillText(short(most), LEFT - 8, top - 3);
      else if (row.key === "messages" && !story.scene.messages) {
        paint.textAlign = "left";
        paint.fillText(`not known: ${UNSEEN}`, LEFT + 6, top + tall / 2 - 6);
      }
      if (cut) {
        paint.textAlign = "left";
        const peak = parts.tops.indexOf(parts.most);
        const x = this.x(Math.min((peak + 1) * story.width, this.span));
        paint.fillText(`peak ${short(parts.most)}`, Math.min(x + 14, width - 80), top - 2);
      }
      top = base + gap;
    }
    this.faults(paint, height, colour);
  }

  /** Returns the areas of a row, from bottom to top, and the highest value. */
  rows(key, seconds) {
    const { totals, scene } = this.story;
    if (key === "filled") {
      const high = totals.map((b) => b[2]);
      const goal = totals.map((b) => b[3]);
      const most = Math.max(0, ...goal);
      return { most, tops: goal, areas: [{ colour: "--goal", low: high.map(() => 0), high: goal }, { colour: "--filled", low: high.map(() => 0), high }] };
    }
    if (key === "moves") {
      const high = totals.map((b) => b[1] / seconds);
      return { most: Math.max(0, ...high), tops: high, areas: [{ colour: "--moves", low: high.map(() => 0), high }] };
    }
    let low = totals.map(() => 0);
    const areas = [];
    scene.classes.forEach((name, i) => {
      if (!this.shown[i]) return;
      const high = totals.map((b, k) => low[k] + b[0][i] / seconds);
      areas.push({ colour: `--c-${name}`, low, high });
      low = high;
    });
    return { most: Math.max(0, ...low), tops: low, areas };
  }

  /** Traces values from left to right, one step for each time bin, or back. */
  outline(values, line, back) {
    const width = this.story.width;
    const corner = (i) => {
      const [a, b] = [this.x(i * width), this.x(Math.min((i + 1) * width, this.span))];
      if (back) {
        line(b, values[i]);
        line(a, values[i]);
      } else {
        line(a, values[i]);
        line(b, values[i]);
      }
    };
    if (back) for (let i = values.length - 1; i >= 0; i--) corner(i);
    else for (let i = 0; i < values.length; i++) corner(i);
  }

  times(paint, height, colour) {
    const seconds = this.span / 1e6;
    const rough = seconds / Math.max((this.canvas.clientWidth - LEFT) / 90, 2);
    const power = 10 ** Math.floor(Math.log10(rough));
    const step = [1, 2, 5, 10].map((n) => n * power).find((n) => n >= rough) ?? power * 10;
    paint.textBaseline = "bottom";
    paint.textAlign = "center";
    for (let s = 0; s <= seconds + 1e-9; s += step) {
      const x = this.x(s * 1e6);
      paint.fillStyle = colour("--grid");
      paint.fillRect(x, TOP, 1, height - TOP - BOTTOM);
      paint.fillStyle = colour("--soft");
      const label = Number(s.toFixed(6)).toLocaleString("en");
      if (x < this.canvas.clientWidth - 24) paint.fillText(`${label} s`, Math.max(x, LEFT + 8), height - 4);
    }
  }

  faults(paint, height, colour) {
    for (const { t, what } of this.story.faults) {
      const x = this.x(t);
      const mends = /^(resume |unstick |unblock |restart |heal$)/.test(what);
      paint.fillStyle = colour(this.story.isPlan ? "--soft" : mends ? "--mend" : "--bad");
      paint.globalAlpha = 0.5;
      paint.fillRect(x - 0.5, TOP, 1, height - TOP - BOTTOM);
      paint.globalAlpha = 1;
      paint.beginPath();
      paint.moveTo(x, TOP - 7);
      paint.lineTo(x + 4, TOP - 3);
      paint.lineTo(x, TOP + 1);
      paint.lineTo(x - 4, TOP - 3);
      paint.fill();
    }
  }
}

function short(n) {
  if (n >= 1e4) return `${(n / 1000).toFixed(0)}k`;
  if (n >= 1e3) return `${(n / 1000).toFixed(1)}k`;
  return n >= 10 || n === Math.round(n) ? n.toFixed(0) : n.toFixed(1);
}
