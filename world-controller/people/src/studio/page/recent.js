// What was drawn or furnished lately, kept by the browser.

import { make } from "./panel.js";

/** Named things, the latest first. @template {{ name: string }} T */
export class Recent {
  /**
   * @param {string} key where the browser keeps them
   * @param {number} most
   * @param {HTMLElement} list shows them
   * @param {(thing: T) => string} label
   * @param {(thing: T) => void} open
   */
  constructor(key, most, list, label, open) {
    Object.assign(this, { key, most, list, label, open });
  }
  /** @returns {T[]} */
  all() {
    try {
      return JSON.parse(localStorage.getItem(this.key) ?? "[]");
    } catch {
      return [];
    }
  }
  /** Puts a thing in front, in place of another one of its name. @param {T} thing */
  add(thing) {
    const others = this.all().filter((other) => other.name !== thing.name);
    localStorage.setItem(this.key, JSON.stringify([thing, ...others].slice(0, this.most)));
    this.show();
  }
  show() {
    const row = (thing) => make("li", {}, make("button", { type: "button", className: "link", onclick: () => this.open(thing) }, this.label(thing)));
    this.list.replaceChildren(...this.all().map(row));
  }
}
