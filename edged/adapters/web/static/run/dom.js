// Helpers to build DOM nodes; the Run page uses no framework.
const SVG = "http://www.w3.org/2000/svg";
export const SIDES = ["left", "right"];
export const AXES = ["X", "Y", "Z"];
/** @type {(id: string) => any} */
export const $ = (id) => document.getElementById(id);

export function element(tag, attributes = {}, ...children) {
  const node = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
  node.append(...children);
  return node;
}

export function drawing(tag, attributes) {
  const node = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
  return node;
}

export function row(tag, cells) {
  const attributes = (i) => (i && tag === "td" ? { class: "number" } : {});
  return element("tr", {}, ...cells.map((cell, i) => element(tag, attributes(i), cell)));
}

export const muted = (...children) => element("span", { class: "muted" }, ...children);
export const note = (...children) => element("p", { class: "muted" }, ...children);

// A name or a value, which is not translated.
export const data = (text, attributes = {}) =>
  element("span", { translate: "no", ...attributes }, String(text));
// A message of the cell, which is English.
export const detail = (text) => data(text, { lang: "en", class: "muted" });
