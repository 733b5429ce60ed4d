// A DXF drawing of the part's face, to learn the job from.
import { html, useState } from "../../vendor/ui.js";
import { attempt, Problem } from "../shared/api.js";
import { mayTake } from "../shared/live.js";
import { NumberField, Shape, say } from "../shared/pieces.js";
import { number, t } from "../shared/texts.js";
import { change, teaching } from "./teaching.js";

const MOST_BYTES = 2 * 1024 * 1024;
const UNITS = ["mm", "cm", "m", "in"];

const inBase64 = (file) =>
  new Promise((done, failed) => {
    if (file.size > MOST_BYTES) failed(new Problem({ code: "teach_drawing_large" }));
    const reader = new FileReader();
    reader.onload = () => done(String(reader.result).replace(/^[^,]*,/, ""));
    reader.onerror = () => failed(new Problem({ code: "teach_drawing_unread" }));
    reader.readAsDataURL(file);
  });

export function Drawing() {
  const { drawing, proposing } = teaching.value;
  const [unit, setUnit] = useState("");
  const [depth, setDepth] = useState(null);
  const [layers, setLayers] = useState("");
  const [isSending, setSending] = useState(false);
  const named = layers
    .split(",")
    .map((one) => one.trim())
    .filter(Boolean);
  const send = async (input) => {
    const [file] = input.files;
    if (!file) return;
    setSending(true);
    const data = await attempt(() => inBase64(file));
    input.value = ""; // so that choosing the same file again counts as a change
    const stated = {
      ...(unit ? { unit } : {}),
      ...(depth ? { depth_mm: depth } : {}),
      ...(named.length ? { layers: named } : {}),
    };
    const isLearnt = data && (await change("POST", "/dxf", { name: file.name.slice(-64), data, ...stated }));
    if (isLearnt) say(t("teach-drawing-said", { name: file.name }));
    setSending(false);
  };
  return html`<section aria-labelledby="teach-drawing">
    <h2 id="teach-drawing">${t("teach-drawing")}</h2>
    <p class="hint">${t("teach-drawing-what")}</p>
    ${
      drawing &&
      html`<p class="verdict small">
          <${Shape} is=${proposing ? "none" : "tick"} />${" "}
          ${t("teach-drawing-is", { name: drawing.name, depth: number(drawing.depth_mm, 1) })}
        </p><p class="hint">${t("teach-drawing-back")}</p>`
    }
    <details class="drawing-more">
      <summary>${t("teach-drawing-more")}</summary>
      <div class="row">
        <label class="field">
          <span>${t("teach-drawing-unit")}</span>
          <select
            name="unit" disabled=${!mayTake.value}
            onChange=${({ currentTarget }) => setUnit(currentTarget.value)}
          >
            <option value="" selected=${!unit}>${t("teach-drawing-unit-own")}</option>
            ${UNITS.map(
              (one) => html`<option key=${one} value=${one} translate=${false} selected=${unit === one}>
                ${one}
              </option>`,
            )}
          </select>
        </label>
        <${NumberField}
          name="depth" label=${t("teach-drawing-depth")} unit="mm" digits=${1} low=${1} high=${100000}
          value=${depth ?? drawing?.depth_mm} disabled=${!mayTake.value} onValue=${setDepth}
        />
      </div>
      <label class="field">
        <span>${t("teach-drawing-layers")}</span>
        <input
          name="layers" autocomplete="off" maxlength="400" value=${layers} disabled=${!mayTake.value}
          onInput=${({ currentTarget }) => setLayers(currentTarget.value)}
        />
      </label>
    </details>
    <div class="actions">
      <label class="button upload ${mayTake.value && !isSending ? "" : "closed"}">
        <span>${t(isSending ? "teach-drawing-reading" : "teach-drawing-choose")}</span>
        <input
          type="file" name="dxf" accept=".dxf" disabled=${!mayTake.value || isSending}
          onChange=${({ currentTarget }) => send(currentTarget)}
        />
      </label>
    </div>
  </section>`;
}
