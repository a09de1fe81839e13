// Elements of the page.

/**
 * Returns an element of the page by its name. Which kind it is, the caller knows.
 * @type {(id: string) => any}
 */
export const by = (id) => document.getElementById(id);

/**
 * Makes an element. Texts are inserted as texts, never as HTML; attributes that begin with `on` are listeners.
 * @param {string} tag
 * @param {Record<string, any>} [attributes]
 * @param {...(Node | string | null | undefined)} inside
 * @returns {any}
 */
export function make(tag, attributes = {}, ...inside) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (value === false || value === null || value === undefined) continue;
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else element.setAttribute(name, value === true ? "" : value);
  }
  element.append(...inside.filter((x) => x !== null && x !== undefined));
  return element;
}
