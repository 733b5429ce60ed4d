// The kind of board and its number of marks; their size has a field of its own.
import { html } from "../../vendor/ui.js";
import { NumberField } from "./pieces.js";
import { t } from "./texts.js";

export const KINDS = ["chessboard", "charuco", "dots", "circles"];
export const SIZE = { kind: KINDS[0], columns: 11, rows: 8, marker: 3, dictionary: "5X5_250" };
export const specOf = ({ kind, columns, rows, marker, dictionary }, mm) =>
  [kind, `${columns}x${rows}`, mm, ...(kind === "charuco" ? [marker, dictionary] : [])].join(":");
const isPitched = ({ kind }) => kind === "dots" || kind === "circles";

export function BoardFields({ size, onSize }) {
  const set = (values) => onSize({ ...size, ...values });
  const count = (name) => html`<${NumberField}
    label=${t(`board-${name}`)} unit="" digits=${0} low=${3} high=${99} value=${size[name]}
    onValue=${(value) => set({ [name]: Math.round(value) })} name=${name} isForm
  />`;
  return html`<div class="row">
    <label class="field">
      <span>${t("board-kind")}</span>
      <select value=${size.kind} onChange=${(event) => set({ kind: event.currentTarget.value })}>
        ${KINDS.map(
          (one) => html`<option value=${one} selected=${one === size.kind}>${t(`kind-${one}`)}</option>`,
        )}
      </select>
    </label>
    ${count("columns")} ${count("rows")}
    ${
      size.kind === "charuco" &&
      html`<${NumberField}
          label=${t("board-marker")} unit="mm" digits=${3} low=${0.001} high=${10000} value=${size.marker}
          onValue=${(marker) => set({ marker })} isForm
        />
        <label class="field">
          <span>${t("board-dictionary")}</span>
          <input
            value=${size.dictionary}
            onInput=${(event) => set({ dictionary: event.currentTarget.value.trim() })}
          />
        </label>`
    }
  </div>`;
}

export const PitchField = ({ size, mm, onMm }) => html`<${NumberField}
  label=${t(isPitched(size) ? "board-pitch" : "board-mm")} unit="mm" digits=${3} low=${0.001} high=${10000}
  value=${mm} onValue=${onMm} name="mm" isForm
/>`;
