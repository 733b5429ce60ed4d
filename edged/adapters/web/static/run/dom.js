// What the page is built with. No framework: it draws anew what has changed, cycle after cycle.
const SVG = "http://www.w3.org/2000/svg";
export const SIDES = ["left", "right"];
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
  const line = element("tr");
  cells.forEach((cell, i) => line.append(element(tag, i && tag === "td" ? { class: "number" } : {}, cell)));
  return line;
}

// A name or a value: the same in every language.
export const data = (text, attributes = {}) => element("span", { translate: "no", ...attributes }, String(text));
// What only the cell's own words say: they are English.
export const detail = (text) => data(text, { lang: "en", class: "muted" });
