// Further pairs of the part: tilted, or in other light, they settle what its edge breaks are.
import { html, useState } from "../../vendor/ui.js";
import { holds, mayTake, SIDES, sign, token } from "../shared/live.js";
import { Shape, say } from "../shared/pieces.js";
import { number, t } from "../shared/texts.js";
import { change, teaching } from "./teaching.js";

function Form() {
  const { break_mm: width, break_end: end, features, proposing } = teaching.value;
  if (proposing || features.length === 0) return null;
  if (width === null) return html`<p class="hint">${t("teach-further-open")}</p>`;
  const text = width === 0 ? "none" : (end ?? "either");
  return html`<p class="verdict small">
    <${Shape} is="tick" /> ${t(`teach-further-${text}`, { width: number(width, 2) })}
  </p>`;
}

export function FurtherPairs() {
  const [isTaking, setTaking] = useState(false);
  const { id, drawing, further } = teaching.value;
  if (drawing) return null;
  const add = async () => {
    sign();
    setTaking(true);
    if (await change("POST", "/further", { token: token.value })) say(t("teach-further-said"));
    setTaking(false);
  };
  const remove = async (pair) => {
    const stay = further.filter((other) => other !== pair);
    if (await change("PUT", "/further", { further: stay })) say(t("teach-further-removed"));
  };
  return html`<section aria-labelledby="teach-further">
    <h2 id="teach-further">${t("teach-further")}</h2>
    <p class="hint">${t("teach-further-what")}</p>
    <${Form} />
    ${
      further.length > 0 &&
      html`<ul class="tiles">${further.map(
        (pair, i) => html`<li class="tile" key=${pair}>
          <h3>${t("teach-further-pair", { number: i + 2 })}</h3>
          <div class="pair">${SIDES.map(
            (side) => html`<img
              key=${side} src=${`/api/v1/teachings/${id}/${pair}-${side}.jpg`} alt=${t(side)} loading="lazy"
            />`,
          )}</div>
          <button
            disabled=${!mayTake.value} aria-label=${t("teach-further-remove-pair", { number: i + 2 })}
            onClick=${() => remove(pair)}
          >
            ${t("teach-remove")}
          </button>
        </li>`,
      )}</ul>`
    }
    <div class="actions">
      <button disabled=${!holds.value || isTaking} onClick=${add}>
        ${t(isTaking ? "teach-taking" : "teach-further-add")}
      </button>
    </div>
    ${!holds.value && html`<p class="hint">${t("teach-take-cell")}</p>`}
  </section>`;
}
