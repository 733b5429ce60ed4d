// Every point or pose with its residual to the others; each can be edited, left out and restored.
import { html, useState } from "../../vendor/ui.js";
import { useUndoKeys } from "../shared/keys.js";
import { mayTake } from "../shared/live.js";
import { Dialog, Shape, say } from "../shared/pieces.js";
import { dashed, number, t } from "../shared/texts.js";
import { Shown } from "./numbers.js";
import { change, current, sampleName } from "./registration.js";

function Bar({ value, limit }) {
  if (!Number.isFinite(value)) return html`<span class="muted">–</span>`;
  const share = Math.min(1, value / (2 * limit));
  return html`<span class="robot-held">
    ${t("robot-mm", { mm: number(value, 3) })} <span class="bar" aria-hidden="true">
      <span class="now ${value > limit ? "soft" : ""}" style=${{ width: `${100 * share}%` }}></span>
      <span class="held" style=${{ left: "50%" }}></span>
    </span>
  </span>`;
}

/** @typedef {import("./numbers.js").Entered} Entered */

const STATE = {
  left_out: "gap",
  not_seen: "gap",
  length: "gap",
  no_numbers: "doubt",
  misfit: "doubt",
  outlier: "gap",
};

export function Samples() {
  const { samples, culprit, limit_mm, can_undo, can_redo, kind } = current.draft.value;
  const [edited, setEdited] = useState(null);
  const [shown, setShown] = useState(/** @type {Entered} */ ({}));
  const step = (way) => async () => (await change("POST", `/${way}`)) && say(t(`robot-${way}ne`));
  useUndoKeys(mayTake.value && can_undo && step("undo"), mayTake.value && can_redo && step("redo"));
  if (!samples.length && !can_redo) return null;
  const write = async () => {
    if (await change("PUT", `/samples/${edited.name}`, shown.body)) setEdited(null);
  };
  const fields = (one) => (one.numbers ?? []).map((value) => String(value));
  return html`<section aria-labelledby="robot-samples">
    <h2 id="robot-samples">${t("robot-samples", { count: samples.length })}</h2>
    <ul class="robot-samples">
      ${samples.map((one) => {
        const { name, text, why, why_text, held_out_mm, held_out_deg, pictures } = one;
        const isWrong = name === culprit;
        const values = { name: sampleName(name) };
        return html`<li key=${name} class="${why ? "unused" : ""} ${isWrong ? "culprit" : ""}">
          <span class="name">
            <${Shape} is=${isWrong ? "gap" : (STATE[why] ?? "tick")} /> ${sampleName(name)}
          </span>
          ${
            pictures &&
            html`<span class="thumbs">
              <img src=${pictures.left} alt="" loading="lazy" />
              <img src=${pictures.right} alt="" loading="lazy" />
            </span>`
          }
          <span class="numbers" translate=${false}>${text ?? "–"}</span>
          <${Bar} value=${held_out_mm} limit=${limit_mm} />
          <span class="muted">
            ${
              isWrong && !["left_out", "not_seen", "length"].includes(why)
                ? t("robot-why-culprit")
                : why
                  ? t(`robot-why-${dashed(why)}`)
                  : Number.isFinite(held_out_deg)
                    ? html`${number(held_out_deg, 3)}°`
                    : ""
            } ${why_text && html`<span translate=${false} lang="en">${why_text}</span>`}
          </span>
          <span class="actions">
            <button
              disabled=${!mayTake.value} aria-label=${t("robot-edit-name", values)}
              onClick=${() => setEdited(one)}
            >
              ${t("robot-edit")}
            </button>
            ${
              why === "left_out"
                ? html`<button
                  disabled=${!mayTake.value} aria-label=${t("robot-restore-name", values)}
                  onClick=${() => change("POST", `/samples/${name}/restore`)}
                >
                  ${t("robot-restore")}
                </button>`
                : html`<button
                  disabled=${!mayTake.value} aria-label=${t("robot-remove-name", values)}
                  onClick=${() => change("DELETE", `/samples/${name}`)}
                >
                  ${t("robot-remove")}
                </button>`
            }
          </span>
        </li>`;
      })}
    </ul>
    <div class="actions">
      <button disabled=${!mayTake.value || !can_undo} onClick=${step("undo")}>${t("robot-undo")}</button>
      <button disabled=${!mayTake.value || !can_redo} onClick=${step("redo")}>${t("robot-redo")}</button>
    </div>
    <p class="hint">${t(kind === "touch" ? "robot-samples-touch" : "robot-samples-poses")}</p>
    <${Dialog}
      title=${edited ? sampleName(edited.name) : t("robot-edit")} isOpen=${edited !== null}
      onClose=${() => setEdited(null)}
    >
      ${
        edited &&
        html`<${Shown} draft=${current.draft.value} first=${fields(edited)} onShown=${setShown} />
          <div class="actions">
            <button onClick=${() => setEdited(null)}>${t("back")}</button>
            <button class="primary" disabled=${!shown.body} onClick=${write}>${t("robot-write")}</button>
          </div>`
      }
    <//>
  </section>`;
}
