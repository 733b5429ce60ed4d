// A page's script, styles and texts, /static/setup/TOPIC/ID.*, are loaded when it is first opened.
import { signal } from "../vendor/ui.js";
import { Problem } from "./shared/api.js";
import { learn } from "./shared/texts.js";

const loaded = signal({});
export const pageOf = ({ id }) => loaded.value[id];

const sheets = new Map(); // by id of the page
const styles = (id, href) =>
  new Promise((onload, onerror) => {
    const link = Object.assign(document.createElement("link"), { rel: "stylesheet", href, onload, onerror });
    sheets.set(id, link);
    document.head.append(link);
  });

// A page has the looks of all pages and its own, whatever was opened before it.
/** @param {string} id */
export function wear(id) {
  for (const [page, { sheet }] of sheets) if (sheet) sheet.disabled = page !== id;
}

/** @param {import("./steps.js").Step} step */
export async function enter({ id, topic }) {
  if (loaded.value[id]) return;
  const place = `setup/${topic}/${id}`;
  let page;
  try {
    const [script, isSpoken] = await Promise.all([
      import(`/static/${place}.js`),
      learn(place),
      styles(id, `/static/${place}.css`),
    ]);
    page = isSpoken && script.default;
  } catch {
    page = null;
  }
  if (!page) throw new Problem({ code: "page" });
  loaded.value = { ...loaded.value, [id]: page };
}
