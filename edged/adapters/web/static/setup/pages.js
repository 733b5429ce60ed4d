// A page's script, styles and texts, /static/setup/TOPIC/ID.*, are loaded when it is first opened.
import { signal } from "../vendor/ui.js";
import { Problem } from "./shared/api.js";
import { learn } from "./shared/texts.js";

const loaded = signal({});
export const pageOf = ({ id }) => loaded.value[id];

const styles = (href) =>
  new Promise((onload, onerror) => {
    document.head.append(
      Object.assign(document.createElement("link"), { rel: "stylesheet", href, onload, onerror }),
    );
  });

/** @param {import("./steps.js").Step} step */
export async function enter({ id, topic }) {
  if (loaded.value[id]) return;
  const place = `setup/${topic}/${id}`;
  let page;
  try {
    [{ default: page }] = await Promise.all([
      import(`/static/${place}.js`),
      learn(place),
      styles(`/static/${place}.css`),
    ]);
  } catch {
    throw new Problem({ code: "page" });
  }
  loaded.value = { ...loaded.value, [id]: page };
}
