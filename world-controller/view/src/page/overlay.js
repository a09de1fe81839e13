// What is written on the picture: the time, the directions of the axes, a scale bar; and the legend below saved pictures.

/** The numbers of cells that a scale bar can have. */
const LENGTHS = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000];
/** The longest scale bar, in pixels. */
const LONGEST = 110;
/** The length of an axis in the plane of the picture, in pixels. */
const ARM = 26;
const AXES = [["x", "--axis-x"], ["y", "--axis-y"], ["z", "--axis-z"]];

/** Returns the scale bar: its number of cells and its length, if a cell in the plane of the target has this many pixels. */
export function scaleBar(pixelsOfACell) {
  const cells = LENGTHS.findLast((n) => n * pixelsOfACell <= LONGEST) ?? 1;
  return { cells, length: cells * pixelsOfACell };
}

/** Draws axes and scale into the lower right corner, at `x` and `y`, of a picture of this height. */
export function drawNotes(paint, { x, y, height, style, viewpoint }) {
  const colour = (name) => style.getPropertyValue(name).trim();
  const font = style.fontFamily;
  paint.lineCap = paint.lineJoin = "round";
  drawAxes(paint, { x: x - 46, y: y - 44, font, colour, viewpoint });
  drawScale(paint, { x: x - 100, y: y - 24, font, colour, pixels: viewpoint.pixelsOfACell(height) });
}

/** Writes the time into the upper right corner of a picture of this width. */
export function drawTime(paint, { width, style, time }) {
  paint.fillStyle = style.getPropertyValue("--ink").trim();
  paint.font = `600 15px ${style.fontFamily}`;
  paint.textAlign = "right";
  paint.textBaseline = "top";
  paint.fillText(time, width - 14, 12);
}

function drawAxes(paint, { x, y, font, colour, viewpoint }) {
  const { right, up } = viewpoint.axes();
  const { out } = viewpoint.eye();
  const arms = AXES.map(([name, tone], i) => ({ name, tone, dx: right[i] * ARM, dy: -up[i] * ARM, towards: out[i] }));
  paint.font = `600 12px ${font}`;
  paint.textAlign = "center";
  paint.textBaseline = "middle";
  paint.lineWidth = 2.5;
  // Those towards the eye are drawn last.
  for (const { name, tone, dx, dy } of arms.sort((a, b) => a.towards - b.towards)) {
    paint.strokeStyle = paint.fillStyle = colour(tone);
    paint.beginPath();
    paint.moveTo(x, y);
    paint.lineTo(x + dx, y + dy);
    paint.stroke();
    // An axis that points at the eye is named beside its end.
    const length = Math.hypot(dx, dy);
    const beyond = length < 4 ? [8, -8] : [(dx / length) * 10, (dy / length) * 10];
    paint.fillText(name, x + dx + beyond[0], y + dy + beyond[1]);
  }
}

function drawScale(paint, { x, y, font, colour, pixels }) {
  const { cells, length } = scaleBar(pixels);
  paint.strokeStyle = paint.fillStyle = colour("--ink");
  paint.lineWidth = 1.5;
  paint.beginPath();
  for (const [dx, dy] of [[0, -4], [0, 0], [-length, 0], [-length, -4]]) paint.lineTo(x + dx, y + dy);
  paint.stroke();
  paint.font = `12px ${font}`;
  paint.textAlign = "right";
  paint.textBaseline = "bottom";
  paint.fillText(cells === 1 ? "1 cell" : `${cells} cells`, x, y - 6);
}

const ROW = 20;
const RAMP = 110;

/** Returns the entries of a legend in rows of this width, each with its place. */
function rowsOf(paint, width, entries) {
  const left = 14;
  const rows = [[]];
  let at = 0;
  for (const entry of entries) {
    const words = entry.ramp ? [entry.near, entry.far] : [entry.text];
    const wide = words.reduce((sum, text) => sum + paint.measureText(text).width, 0) + (entry.ramp ? RAMP + 40 : 36);
    if (at > 0 && left + at + wide > width) {
      rows.push([]);
      at = 0;
    }
    rows[rows.length - 1].push({ ...entry, x: left + at });
    at += wide;
  }
  return rows;
}

function writes(paint, style) {
  paint.font = `13px ${style.fontFamily}`;
  paint.textAlign = "left";
  paint.textBaseline = "middle";
}

/** Returns the height that a legend needs in a picture of this width. */
export function legendHeight(width, style, entries) {
  const paint = document.createElement("canvas").getContext("2d");
  writes(paint, style);
  return rowsOf(paint, width, entries).length * ROW + 14;
}

/** Draws a legend below a picture. */
export function drawLegend(paint, { top, width, style, entries }) {
  const colour = (name) => style.getPropertyValue(name).trim();
  paint.fillStyle = colour("--sky");
  paint.fillRect(0, top, width, legendHeight(width, style, entries));
  writes(paint, style);
  const ink = colour("--ink");
  rowsOf(paint, width, entries).forEach((row, i) => {
    const y = top + 7 + ROW * (i + 0.5);
    for (const { x, ramp, near, far, text, colour: fill } of row) {
      const label = (said, at) => {
        paint.fillStyle = ink;
        paint.fillText(said, at, y);
      };
      if (!ramp) {
        paint.fillStyle = fill;
        paint.fillRect(x, y - 6, 12, 12);
        label(text, x + 18);
        continue;
      }
      label(near, x);
      const from = x + paint.measureText(near).width + 6;
      const shade = paint.createLinearGradient(from, 0, from + RAMP, 0);
      ramp.forEach((tone, k) => shade.addColorStop(k / (ramp.length - 1), tone));
      paint.fillStyle = shade;
      paint.fillRect(from, y - 6, RAMP, 12);
      label(far, from + RAMP + 6);
    }
  });
}
