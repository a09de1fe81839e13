// Figures to be saved: the program draws them, by the same code as `metamorph render`.

/** Frames of a moving picture, about. */
const FRAMES = 60;

/** The round times between two frames, in milliseconds: 1, 2, 5, 10 and so on. */
function roundTime(micros) {
  const least = Math.max(1, micros / 1000);
  const power = 10 ** Math.floor(Math.log10(least));
  return [1, 2, 5, 10].map((n) => n * power).find((n) => n >= least);
}

/** Returns the options of a figure that shows what the page shows. */
export function figureOf({ story, t, camera, meaning, messages, waits, goal, only, sections, notes, dark, width, moving }) {
  const degrees = (radians) => Math.round((radians * 180) / Math.PI * 100) / 100;
  const turn = (((degrees(camera.azimuth) + 90) % 360) + 360) % 360;
  const links = [messages && "messages", waits && "waits"].filter(Boolean).join(",");
  const at = story.over && t >= story.now ? "end" : `${Math.round(t) / 1e6}s`;
  return {
    at,
    ...(moving && { every: `${roundTime(t / FRAMES)}ms` }),
    ...(only !== "all" && { only }),
    ...(sections.length && { section: sections.map(String).join() }),
    ...(notes ? { title: "{t}" } : { axes: "off", scale: "off" }),
    camera: `${Math.round(turn * 100) / 100},${degrees(camera.height)}`,
    // The program draws no homes.
    color: meaning === "host" ? "state" : meaning,
    goal: goal ? "ghost" : "off",
    ...(links && { links }),
    theme: dark ? "dark" : "paper",
    width,
  };
}

/** Returns the options as they are typed. */
export function renderLine(options, format) {
  const quoted = (value) => (/[<>]/.test(value) ? `'${value}'` : value);
  const words = Object.entries(options).map(([name, value]) => `--${name} ${quoted(value)}`);
  return `metamorph render … ${words.join(" ")} --out figure.${format}`;
}

/** Returns the file that the program draws: its name and its content. */
export async function fetchFigure(options, format) {
  const query = Object.entries(options).map(([name, value]) => `${name}=${encodeURIComponent(value)}`);
  const response = await fetch(`figure.${format}?${query.join("&")}`);
  if (!response.ok) throw new Error((await response.text()).trim());
  const name = /filename="([^"]+)"/.exec(response.headers.get("content-disposition") ?? "");
  return { name: name?.[1] ?? `figure.${format}`, content: await response.blob() };
}

/** Lets the browser save a file. */
export function saveAs({ name, content }) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(content);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
}
