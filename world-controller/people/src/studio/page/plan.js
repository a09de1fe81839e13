// A room from above: floor, walls, doors, store and pieces as SVG, and what the pointer does to them. Coordinates of the
// picture are connectors, with y from north to south.

/** @typedef {{ at: [number, number], turn: number }} Place */
/** @typedef {{ name: string, at: [number, number], turn: number, colour: string, form: number, metamodules: number }} Piece */

const SVG = "http://www.w3.org/2000/svg";
/** Edge of a cell, in metres. */
export const EDGE = 0.11;
/** The angle under which the eye sees the width of the picture, in radians: 32 degrees, those of a screen 0.34 m wide at
 * 0.6 m, and of the camera that shows drawings. */
const FIELD = (32 * Math.PI) / 180;
/** Free connectors around the room in the picture. */
const MARGIN = 1.6;

/** Makes an element of the picture. @param {string} tag @param {Record<string, string | number>} attributes @param {...Node} children */
function shape(tag, attributes = {}, ...children) {
  const element = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, String(value));
  element.append(...children);
  return element;
}

/** The size of a piece as it stands. @param {any} room @param {Piece | Place & { form: number }} piece @returns {[number, number]} */
export const sizeOf = (room, piece) => room.forms[piece.form].turns[piece.turn % 4].size;

/** Where a piece stands after a quarter turn about its middle. @param {any} room @param {Piece} piece @param {number} by @returns {Place} */
export function turnedPlace(room, piece, by) {
  const turn = (piece.turn + by + 4) % 4;
  const [before, after] = [sizeOf(room, piece), room.forms[piece.form].turns[turn].size];
  return { turn, at: /** @type {[number, number]} */ (piece.at.map((v, i) => v + Math.trunc((before[i] - after[i]) / 2))) };
}

/** The picture of a room, of which nothing can be chosen. @param {any} room */
export function miniature(room) {
  const [width, depth] = room.size;
  return shape("svg", { viewBox: `${-MARGIN} ${-MARGIN} ${width + 2 * MARGIN} ${depth + 2 * MARGIN}`, class: "plan", "aria-hidden": "true" }, ...background(room), ...room.pieces.map((piece) => bodyOf(room, piece)));
}

function rectangle(room, [x0, y0], [x1, y1], name) {
  return shape("rect", { x: x0, y: room.size[1] - 1 - y1, width: x1 - x0 + 1, height: y1 - y0 + 1, class: name });
}

/** A text of the picture, smaller where there is no room for it. @param {number} room connectors for the text */
function label(text, x, y, room, name) {
  const size = Math.min(0.95, (1.6 * room) / Math.max(1, text.length)).toFixed(3);
  const element = shape("text", { x, y, "font-size": size, "data-most": size, class: name });
  element.textContent = text;
  return element;
}

/** What stays where it is. */
function background(room) {
  const [width, depth] = room.size;
  const parts = [shape("rect", { x: 0, y: 0, width, height: depth, class: "floor" })];
  const [lines, texts] = [[], []];
  for (let x = 1; x < width; x++) lines.push(`M${x} 0V${depth}`);
  for (let y = 1; y < depth; y++) lines.push(`M0 ${y}H${width}`);
  if (room.store) {
    const { min, max } = room.store;
    parts.push(rectangle(room, min, max, "store"));
    texts.push(label("store of metamodules", (min[0] + max[0] + 1) / 2, depth - (min[1] + max[1] + 1) / 2, max[0] - min[0], "of-store"));
  }
  parts.push(shape("path", { d: lines.join(""), class: "connectors" }), ...texts);
  parts.push(shape("rect", { x: -0.3, y: -0.3, width: width + 0.6, height: depth + 0.6, class: "walls" }));
  for (const [x, y] of room.doors) {
    // A gap in the walls that the connector touches.
    const north = depth - 1 - y;
    const gaps = [[x === 0, -0.65, north, 0.7, 1], [x === width - 1, width - 0.05, north, 0.7, 1], [y === 0, x, depth - 0.05, 1, 0.7], [y === depth - 1, x, -0.65, 1, 0.7]];
    for (const [touches, left, top, w, h] of gaps) if (touches) parts.push(shape("rect", { x: left, y: top, width: w, height: h, class: "gap" }));
    parts.push(rectangle(room, [x, y], [x, y], "door"));
  }
  for (const { min, max } of room.keep_out) parts.push(rectangle(room, min, max, "kept-out"));
  return parts;
}

/** A piece: its columns, darker where they are higher, its outline, its front and its name. */
function bodyOf(room, piece) {
  const { cells } = room.forms[piece.form].turns[piece.turn % 4];
  const [w, d] = sizeOf(room, piece);
  const tops = new Map();
  for (const [x, y, z] of cells) tops.set(`${x},${y}`, Math.max(z, tops.get(`${x},${y}`) ?? 0));
  const south = (y) => d - 1 - y;
  const columns = [...tops].map(([k, z]) => {
    const [x, y] = k.split(",").map(Number);
    return shape("rect", { x, y: south(y), width: 1, height: 1, class: `column high-${Math.min(z, 3)}` });
  });
  const edges = [...tops.keys()].flatMap((k) => {
    const [x, y] = k.split(",").map(Number);
    const sides = [[x - 1, y, `M${x} ${south(y)}v1`], [x + 1, y, `M${x + 1} ${south(y)}v1`], [x, y - 1, `M${x} ${south(y) + 1}h1`], [x, y + 1, `M${x} ${south(y)}h1`]];
    return sides.filter(([i, j]) => !tops.has(`${i},${j}`)).map((side) => side[2]);
  });
  // A wedge where its front is: in the south if it is not turned.
  const front = { 0: `M${w / 2 - 0.45} ${d + 0.12}h.9l-.45 .5z`, 1: `M${w + 0.12} ${d / 2 - 0.45}v.9l.5 -.45z`, 2: `M${w / 2 - 0.45} -.12h.9l-.45 -.5z`, 3: `M-.12 ${d / 2 - 0.45}v.9l-.5 -.45z` }[piece.turn % 4];
  const group = shape("g", { class: "piece", "data-name": piece.name, "data-colour": piece.colour, transform: `translate(${piece.at[0]} ${room.size[1] - piece.at[1] - d})` });
  group.append(...columns, shape("path", { d: edges.join(""), class: "outline" }), shape("path", { d: front, class: "front" }));
  return group;
}

/** The name of a piece, which is above all marks. */
function nameOf(room, piece) {
  const [w, d] = sizeOf(room, piece);
  return label(piece.name, piece.at[0] + w / 2, room.size[1] - piece.at[1] - d / 2, w, "of-piece");
}

export class Plan {
  /** @param {SVGSVGElement} svg @param {any} page the room's page */
  constructor(svg, page) {
    [this.svg, this.page] = [svg, page];
    /** The part of the picture that is seen; null: all of it. @type {{ x: number, y: number, width: number, height: number } | null} */
    this.window = null;
    /** Pointers that are down. @type {Map<number, { x: number, y: number }>} */
    this.down = new Map();
    /** @type {{ x: number, y: number, by: [number, number], moved: boolean } | null} a drag of the chosen pieces */
    this.drag = null;
    /** Whether pieces are drawn anew. */
    this.drawing = false;
    this.pointers();
    new ResizeObserver(() => this.look()).observe(svg);
  }

  /** Shows all of it, because the room is another one. */
  reset() {
    this.window = null;
    this.look();
  }
  fit() {
    this.reset();
    this.page.recorder.look();
  }
  zoom(nearer, at = null) {
    const { x, y, width, height } = this.window ?? this.whole();
    const [cx, cy] = at ?? [x + width / 2, y + height / 2];
    const whole = this.whole();
    const scale = Math.min(Math.max(width / nearer, 8), whole.width * 1.2) / width;
    this.window = { x: cx - (cx - x) * scale, y: cy - (cy - y) * scale, width: width * scale, height: height * scale };
    this.look();
    this.page.recorder.look();
  }
  whole() {
    const [width, depth] = this.page.room?.size ?? [1, 1];
    return { x: -MARGIN, y: -MARGIN, width: width + 2 * MARGIN, height: depth + 2 * MARGIN };
  }
  look() {
    const { x, y, width, height } = this.window ?? this.whole();
    this.svg.setAttribute("viewBox", `${x} ${y} ${width} ${height}`);
    // Names are not larger than other texts of the page, however large a connector is.
    const scale = Math.min(this.svg.clientWidth / width, this.svg.clientHeight / height);
    for (const text of this.svg.querySelectorAll("text")) text.setAttribute("font-size", String(Math.min(Number(text.dataset.most), 17 / (scale || 1))));
  }

  /** Where the eye is, in metres: above the middle of what is seen, looking down. */
  eye() {
    const { x, y, width, height } = this.window ?? this.whole();
    const { clientWidth, clientHeight } = this.svg;
    // The picture keeps its proportions, so more of it may be seen to the sides.
    const across = clientHeight ? Math.max(width, (height * clientWidth) / clientHeight) : width;
    const at = [x + width / 2 - 0.5, this.page.room.size[1] - y - height / 2 - 0.5, across / 2 / Math.tan(FIELD / 2)];
    return { at: at.map((v) => Math.round(v * EDGE * 1000) / 1000), direction: [0, 0, -1] };
  }
  /** Where a place of the page is in the picture. @returns {[number, number]} */
  at(clientX, clientY) {
    const inverse = this.svg.getScreenCTM()?.inverse();
    const point = new DOMPoint(clientX, clientY).matrixTransform(inverse);
    return [point.x, point.y];
  }
  /** Where a connector is on the page, for tests. @param {[number, number]} at */
  project([x, y]) {
    const point = new DOMPoint(x + 0.5, this.page.room.size[1] - y - 0.5).matrixTransform(this.svg.getScreenCTM());
    return { x: point.x, y: point.y };
  }

  /** Draws everything anew. */
  draw() {
    const { room, chosen, proposal, marked } = this.page;
    if (!room) return;
    const focus = document.activeElement?.closest?.("#plan .piece")?.getAttribute("data-name");
    const bodies = room.pieces.map((piece) => {
      const group = bodyOf(room, piece);
      const isChosen = chosen.includes(piece.name);
      const wrong = room.violations.some((v) => !v.wish && v.pieces.includes(piece.name) && !["walkway", "reach"].includes(v.rule));
      for (const [name, value] of Object.entries({ tabindex: 0, role: "button", "aria-pressed": isChosen, "aria-label": `${piece.name}, ${piece.colour}, at ${piece.at.join(", ")}, turned ${piece.turn * 90} degrees${wrong ? ", violates a constraint" : ""}` })) group.setAttribute(name, String(value));
      group.classList.toggle("chosen", isChosen);
      group.classList.toggle("marked", marked.pieces.includes(piece.name));
      return group;
    });
    // What is chosen is on top.
    bodies.sort((a, b) => Number(a.classList.contains("chosen")) - Number(b.classList.contains("chosen")));
    const areas = room.constraints.filter((c) => c.area).map((c) => {
      const area = rectangle(room, c.area.min, c.area.max, "clear");
      area.setAttribute("data-state", c.state);
      return area;
    });
    this.svg.replaceChildren(...background(room), ...areas, ...bodies, ...this.violations(), ...this.proposed(proposal), ...room.pieces.map((piece) => nameOf(room, piece)));
    this.look();
    this.drawing = true;
    if (focus) this.focus(focus);
    this.drawing = false;
  }

  /** Marks the columns where constraints are violated, with a cross. */
  violations() {
    const { room, marked } = this.page;
    const columns = new Map();
    for (const violation of room.violations) {
      const name = `violation${violation.wish ? " wish" : ""}${marked.violation === violation ? " marked" : ""}`;
      for (const [x, y] of violation.cells) if (!violation.wish || !columns.has(`${x},${y}`)) columns.set(`${x},${y}`, name);
    }
    return [...columns].map(([k, name]) => {
      const [x, y] = k.split(",").map(Number);
      const top = room.size[1] - 1 - y;
      return shape("g", { class: name }, shape("rect", { x, y: top, width: 1, height: 1 }), shape("path", { d: `M${x + 0.25} ${top + 0.25}l.5 .5m0 -.5l-.5 .5` }));
    });
  }

  /** Where pieces would stand, with an arrow from where they do. */
  proposed(proposal) {
    const { room } = this.page;
    return (proposal?.moves ?? []).flatMap(({ piece, place }) => {
      const ghost = { ...piece, ...place };
      const body = bodyOf(room, ghost);
      body.classList.add("ghost");
      const middle = (p) => {
        const [w, d] = sizeOf(room, p);
        return [p.at[0] + w / 2, room.size[1] - p.at[1] - d / 2];
      };
      const [[x0, y0], [x1, y1]] = [middle(piece), middle(ghost)];
      return [body, shape("path", { d: `M${x0} ${y0}L${x1} ${y1}`, class: "way" }), shape("circle", { cx: x1, cy: y1, r: 0.35, class: "way-end" })];
    });
  }

  pointers() {
    const { svg, page } = this;
    svg.addEventListener("contextmenu", (event) => event.preventDefault());
    svg.addEventListener("focusin", (event) => {
      const name = /** @type {Element} */ (event.target).closest(".piece")?.getAttribute("data-name");
      // A click has chosen already, perhaps several; and what is drawn anew keeps the focus without being chosen.
      if (name && !this.down.size && !this.drawing && !page.chosen.includes(name)) page.choose([name]);
    });
    svg.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(event.deltaY < 0 ? 1.15 : 1 / 1.15, this.at(event.clientX, event.clientY));
    }, { passive: false });
    svg.addEventListener("pointerdown", (event) => {
      if (!page.room) return;
      this.down.set(event.pointerId, { x: event.clientX, y: event.clientY });
      // A second finger moves the picture.
      if (this.down.size > 1) return this.cancel();
      const name = /** @type {Element} */ (event.target).closest(".piece:not(.ghost)")?.getAttribute("data-name");
      svg.setPointerCapture(event.pointerId);
      if (!name) {
        if (!event.shiftKey) page.choose([]);
        return;
      }
      event.preventDefault();
      if (event.shiftKey) page.choose(page.chosen.includes(name) ? page.chosen.filter((n) => n !== name) : [...page.chosen, name]);
      else if (!page.chosen.includes(name)) page.choose([name]);
      const [x, y] = this.at(event.clientX, event.clientY);
      this.drag = { x, y, by: [0, 0], moved: false };
      this.focus(name);
    });
    svg.addEventListener("pointermove", (event) => {
      const before = this.down.get(event.pointerId);
      if (!before) return;
      this.down.set(event.pointerId, { x: event.clientX, y: event.clientY });
      if (this.drag) {
        const [x, y] = this.at(event.clientX, event.clientY);
        const by = /** @type {[number, number]} */ ([Math.round(x - this.drag.x), -Math.round(y - this.drag.y)]);
        if (String(by) === String(this.drag.by)) return;
        this.drag.by = by;
        this.drag.moved = true;
        return page.dragged(by);
      }
      this.pan(event.pointerId, before);
    });
    const end = (event) => {
      this.down.delete(event.pointerId);
      const drag = this.drag;
      this.drag = null;
      if (!drag?.moved) return;
      if (event.type === "pointerup") page.dropped(drag.by);
      else page.dragged(null);
    };
    svg.addEventListener("pointerup", end);
    svg.addEventListener("pointercancel", end);
  }
  cancel() {
    if (this.drag?.moved) this.page.dragged(null);
    this.drag = null;
  }
  focus(name) {
    [...this.svg.querySelectorAll(".piece:not(.ghost)")].find((g) => g.getAttribute("data-name") === name)?.focus({ preventScroll: true });
  }

  /** Moves the picture with one pointer, and zooms with two. */
  pan(id, before) {
    const now = this.down.get(id);
    const others = [...this.down].filter(([other]) => other !== id).map(([, at]) => at);
    const [[ax, ay], [bx, by]] = [this.at(before.x, before.y), this.at(now.x, now.y)];
    const seen = this.window ?? this.whole();
    if (others.length) {
      const far = (at) => Math.hypot(at.x - others[0].x, at.y - others[0].y);
      if (far(before) > 8) this.zoom(far(now) / far(before), this.at((now.x + others[0].x) / 2, (now.y + others[0].y) / 2));
    } else this.window = { ...seen, x: seen.x - (bx - ax), y: seen.y - (by - ay) };
    this.look();
    this.page.recorder.look();
  }
}
