// Points to touch, in their picture: one is under the cross-hairs, and the robot's numbers there are entered.
import { html, useState } from "../../vendor/ui.js";
import { holds, mayTake, sign, token } from "../shared/live.js";
import { Pair } from "../shared/picture.js";
import { Shape, say } from "../shared/pieces.js";
import { number, t } from "../shared/texts.js";
import { Shown } from "./numbers.js";
import { change, current, placeName } from "./registration.js";

/** @typedef {import("./numbers.js").Entered} Entered */

// The chosen point is under the cross-hairs, touched ones have a tick. A tap takes the nearest.
function Picture({ chosen, onChoose }) {
  const { looked, places } = current.draft.value;
  const { width, height } = looked;
  const tap = (event) => {
    const box = event.currentTarget.getBoundingClientRect();
    const [x, y] = [
      ((event.clientX - box.left) * width) / box.width,
      ((event.clientY - box.top) * height) / box.height,
    ];
    const off = ({ left }) => Math.hypot(left[0] - x, left[1] - y);
    onChoose(places.reduce((best, one) => (off(one) < off(best) ? one : best)).key);
  };
  const [r, tick] = [width / 70, width / 90];
  return html`<div class="view robot-look" style=${{ aspectRatio: `${width} / ${height}` }}>
    <img src=${looked.left} alt=${t("robot-picture")} />
    <svg viewBox="0 0 ${width} ${height}" aria-hidden="true" onClick=${tap}>
      ${places.map(({ key, left: [x, y], sample }) => {
        const d = `M${x - tick} ${y}l${0.7 * tick} ${0.7 * tick}l${1.3 * tick} ${-1.5 * tick}`;
        return html`<g key=${key} class="place ${key === chosen ? "chosen" : ""} ${sample ? "touched" : ""}">
          <circle cx=${x} cy=${y} r=${key === chosen ? 1.6 * r : r} />${sample && html`<path d=${d} />`}
          ${
            key === chosen &&
            html`<path
              d="M${x - 3.2 * r} ${y}h${1.4 * r}M${x + 1.8 * r} ${y}h${1.4 * r}M${x} ${y - 3.2 * r}v${
                1.4 * r
              }M${x} ${y + 1.8 * r}v${1.4 * r}"
            />`
          }
        </g>`;
      })}
    </svg>
  </div>`;
}

// Adds a sample; folded once the registration is solved.
export function More({ title: text, children }) {
  const [isOpen, setOpen] = useState(false);
  if (current.draft.value.solved)
    return html`<section>
      <details class="robot-more" onToggle=${(event) => setOpen(event.currentTarget.open)}>
        <summary>${t("robot-more")}</summary>${isOpen && children}
      </details>
    </section>`;
  return html`<section aria-labelledby="robot-more"><h2 id="robot-more">${text}</h2>${children}</section>`;
}
export const titleOf = (kind, count, wanted) =>
  count <= wanted ? t(`robot-${kind}-title`, { number: count, wanted }) : t("robot-more");

// isProof: choose only. isStill: no new picture. given, choose: the choice, where the parent holds it.
export function Places({ isProof, isStill, chosen: given, onChoose: choose }) {
  const {
    places,
    looked,
    look_reason,
    look_length_percent: longer,
    samples,
    wanted,
    board,
  } = current.draft.value;
  const [own, setOwn] = useState(null);
  const [shown, setShown] = useState(/** @type {Entered} */ ({}));
  const [isTaking, setTaking] = useState(false);
  const [isLive, setLive] = useState(false);
  const onChoose = choose ?? setOwn;
  const key = given ?? own;
  const place = places.find((one) => one.key === key) ?? places.find((one) => one.wanted) ?? places[0];
  const job = board ? null : current.job.value;
  const isLooking = isLive || (!looked && !isProof);
  const take = async () => {
    sign();
    setTaking(true);
    const done = await change("POST", "/looks", { token: token.value, ...(job ? { job } : {}) });
    setTaking(false);
    if (!done) return;
    setOwn(null);
    setLive(false);
    say(
      done.look_reason
        ? t(done.look_length_percent ? "robot-look-wrong" : "robot-look-none")
        : t("robot-look-found", { count: done.places.length }),
    );
  };
  const add = async () => {
    const done = await change("POST", "/samples", { place: place.key, ...shown.body });
    if (!done) return;
    shown.clear?.();
    setOwn(null);
    say(t("robot-point-taken", { count: done.samples.length }));
  };
  const picture =
    !isStill &&
    html`${isLooking && html`<${Pair} />`}
      <div class="actions">
        <button
          class=${places.length || isProof ? "" : "primary"} disabled=${!holds.value || isTaking}
          onClick=${take}
        >
          ${t(isTaking ? "robot-taking" : looked && !look_reason ? "robot-look-again" : "robot-look")}
        </button>
        ${
          looked &&
          html`<button aria-pressed=${isLive} onClick=${() => setLive(!isLive)}>${t("robot-live")}</button>`
        }
      </div>
      ${!holds.value && html`<p class="hint">${t("robot-take-cell")}</p>`}
      ${
        look_reason &&
        html`<p>
            <${Shape} is="gap" />${" "}
            ${longer ? t("robot-look-length", { percent: number(longer, 2) }) : t("robot-look-none")}
          </p><p class="hint" translate=${false} lang="en">${look_reason}</p>`
      }`;
  const choice =
    place &&
    html`<${Picture} chosen=${place.key} onChoose=${onChoose} />
      <label class="field robot-place">
        <span>${t("robot-place")}</span>
        <select
          name="place" disabled=${!mayTake.value}
          onChange=${(event) => onChoose(event.currentTarget.value)}
        >
          ${places.map(
            (one) => html`<option key=${one.key} value=${one.key} selected=${one.key === place.key}>
              ${placeName(one)}${one.sample ? ` (${t("robot-touched")})` : ""}
            </option>`,
          )}
        </select>
      </label>`;
  if (isProof) return html`${picture}${choice}`;
  return html`<${More} title=${titleOf("touch", samples.length + 1, wanted)}>
    <p class="lead">${t("robot-touch-what")}</p>
    <div class="robot-beside"><div>${picture}${choice}</div>
    ${
      place &&
      html`<div><p><strong>${t("robot-touch-now")}</strong></p>
        <${Shown} draft=${current.draft.value} point=${place} onShown=${setShown} />
        <div class="actions">
          <button class="primary" disabled=${!mayTake.value || !shown.body} onClick=${add}>
            ${t("robot-add")}
          </button>
        </div></div>`
    }</div>
  <//>`;
}
