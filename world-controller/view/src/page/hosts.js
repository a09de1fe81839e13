// The hosts of a run: homes of modules, what crosses between two hosts, and which links are cut. Empty for one host.

import { by, make } from "./dom.js";

/** Number of links shown. */
const SHOWN = 15;

/** Returns the number of modules of each host. */
export function sizes({ homes, names }) {
  const count = names.map(() => 0);
  for (const home of homes) count[home]++;
  return count;
}

/** Returns true if the link between two hosts is cut at a time. */
export function isCut({ cuts }, a, b, t) {
  return cuts.some(([x, y, from, until]) => Math.min(a, b) === x && Math.max(a, b) === y && from <= t && t < until);
}

/** Returns the messages from each host to each other in a time bin, by `from` and `to`. `classes` is the number of classes. */
export function crossings({ homes, names }, edges, classes) {
  const sums = names.map(() => names.map(() => 0));
  for (let i = 0; i < edges.length; i += 2 + classes) {
    const [from, to] = [homes[edges[i]], homes[edges[i + 1]]];
    if (from !== to) for (let k = 0; k < classes; k++) sums[from][to] += edges[i + 2 + k];
  }
  return sums;
}

export class HostsTable {
  constructor(story) {
    this.story = story;
    this.text = "";
  }

  /** Shows the links between hosts at a time. `talk` has the messages of the moment, or is null. */
  show(t, talk) {
    const { hosts, classes } = this.story.scene;
    by("hosts-section").hidden = !hosts;
    if (!hosts) return;
    const sums = talk && crossings(hosts, talk.edges, classes.length);
    const seconds = this.story.width / 1e6;
    const rows = this.links(hosts).map(([a, b]) => this.row(hosts, a, b, t, sums, seconds));
    const busiest = rows.sort((x, y) => y.order - x.order || x.at - y.at).slice(0, SHOWN);
    const text = JSON.stringify(busiest);
    if (text === this.text) return;
    this.text = text;
    const over = this.story.report?.hosts;
    const heads = ["link", "state", "messages/s", ...(over ? ["messages", "lost"] : [])];
    const cell = (value) => make("td", {}, value);
    by("hosts").replaceChildren(
      make("thead", {}, make("tr", {}, ...heads.map((head) => make("th", { scope: "col" }, head)))),
      make("tbody", {}, ...busiest.map(({ link, state, cells }) => make("tr", { "data-state": state }, ...[link, state, ...cells].map(cell)))),
    );
  }

  links({ names }) {
    return names.flatMap((_, b) => names.slice(0, b).map((_, a) => [a, b]));
  }

  row(hosts, a, b, t, sums, seconds) {
    const number = (n) => n.toLocaleString("en", { maximumFractionDigits: 0 });
    const now = sums ? (sums[a][b] + sums[b][a]) / seconds : null;
    const both = (this.story.report?.hosts?.crossed ?? []).filter(
      ({ from, to }) => [hosts.names[a], hosts.names[b]].includes(from) && [hosts.names[a], hosts.names[b]].includes(to),
    );
    const total = (of) => both.reduce((sum, { all }) => sum + all[of], 0);
    const over = this.story.report?.hosts ? [number(total("sent")), number(total("lost"))] : [];
    return {
      at: a + b * b,
      order: (now ?? 0) + total("sent"),
      link: `${hosts.names[a]} – ${hosts.names[b]}`,
      state: isCut(hosts, a, b, t) ? "cut" : "up",
      cells: [now === null ? "–" : number(now), ...over],
    };
  }
}
