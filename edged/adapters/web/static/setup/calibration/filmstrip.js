// The views taken, with their residuals; each can be left out, and that undone.
import { html, useEffect, useRef } from "../../vendor/ui.js";
import { useUndoKeys } from "../shared/keys.js";
import { draft, mayTake, SIDES } from "../shared/live.js";
import { Shape, say } from "../shared/pieces.js";
import { number, t } from "../shared/texts.js";

// "view_003" is view 3.
export const short = (name) => name.replace(/^view_0*/, "");

export function Filmstrip({ change, why }) {
  const { views, can_undo, can_redo } = draft.value;
  const strip = useRef(null);
  useEffect(() => {
    if (strip.current) strip.current.scrollLeft = strip.current.scrollWidth; // the newest
  }, [views.length]);
  const remove = async (name) =>
    (await change("DELETE", `/views/${encodeURIComponent(name)}`)) &&
    say(t("view-removed", { name: short(name) }));
  const step = (way) => async () =>
    (await change("POST", `/${way}`)) && say(t(way === "undo" ? "undone" : "redone"));
  useUndoKeys(mayTake.value && can_undo && step("undo"), mayTake.value && can_redo && step("redo"));
  if (!views.length && !can_redo) return null;
  return html`<section aria-labelledby="views">
    <h2 id="views">${t("views-title", { count: views.length })}</h2>
    <ul class="strip" ref=${strip} tabindex="0" aria-label=${t("views-title", { count: views.length })}>
      ${views.map(
        ({ name, used, why: code, rms_px, heldout_px, thumbnails }) =>
          html`<li key=${name} class=${used ? "" : "unused"}>
            <span class="thumbs">
              ${SIDES.map((side) => html`<img src=${thumbnails?.[side]} alt="" loading="lazy" />`)}
            </span>
            <span class="name">
              <${Shape} is=${used ? "tick" : "gap"} /> ${t("view", { name: short(name) })}
            </span>
            <span class="muted">
              ${
                !used
                  ? why(code)
                  : Number.isFinite(rms_px)
                    ? t("view-rms", { rms: number(rms_px, 3) })
                    : t("view-new")
              }
            </span>
            <span class="muted">
              ${
                used && Number.isFinite(heldout_px)
                  ? t("view-heldout", { heldout: number(heldout_px, 3) })
                  : ""
              }
            </span>
            ${
              used &&
              html`<button
                disabled=${!mayTake.value} aria-label=${t("view-remove-name", { name: short(name) })}
                onClick=${() => remove(name)}
              >
                ${t("view-remove")}
              </button>`
            }
          </li>`,
      )}
    </ul>
    <div class="actions">
      <button disabled=${!can_undo || !mayTake.value} onClick=${step("undo")}>${t("undo")}</button>
      <button disabled=${!can_redo || !mayTake.value} onClick=${step("redo")}>${t("redo")}</button>
    </div>
  </section>`;
}
