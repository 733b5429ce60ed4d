// The proposed features, in both pictures and as a list; a tap takes or leaves one.
import { html } from "../../vendor/ui.js";
import { mayTake, task } from "../shared/live.js";
import { Shape, say } from "../shared/pieces.js";
import { dashed, has, inWords, number, t } from "../shared/texts.js";
import { change, lit, teaching } from "./teaching.js";
import { lookAt } from "./zoom.js";

const REACH_PX = 24; // of a finger, on the screen
const NAMED_PX = 26; // smaller ones have no room for their names
const path = (outline, end) =>
  outline.length ? `M${outline.map(([x, y]) => `${x} ${y}`).join("L")}${end}` : "";
const isClosed = ({ kind }) => kind === "circle" || kind === "slot";

// --- in the pictures ---

const away = ([x, y], outline) => Math.min(...outline.map(([ox, oy]) => Math.hypot(ox - x, oy - y)));
const area = (outline) =>
  Math.abs(
    outline.reduce(
      (sum, [x, y], i) =>
        sum + x * outline[(i + 1) % outline.length][1] - outline[(i + 1) % outline.length][0] * y,
      0,
    ),
  ) / 2;
function isInside([x, y], outline) {
  let inside = false;
  outline.forEach(([ax, ay], i) => {
    const [bx, by] = outline[(i + 1) % outline.length];
    if (ay > y !== by > y && x < ax + ((bx - ax) * (y - ay)) / (by - ay)) inside = !inside;
  });
  return inside;
}

// The feature with the nearest outline, else the smallest one around the point: holes are tapped in the
// middle.
export function featureAt(at, scale) {
  const seen = teaching.value.features.filter(({ outline }) => outline.left.length);
  const near = seen.map((one) => [away(at, one.outline.left), one]).filter(([px]) => px < REACH_PX * scale);
  if (near.length) return near.reduce((best, one) => (one[0] < best[0] ? one : best))[1];
  const around = seen.filter((one) => isClosed(one) && isInside(at, one.outline.left));
  return around.length
    ? around.reduce((best, one) => (area(one.outline.left) < area(best.outline.left) ? one : best))
    : null;
}

export async function toggle({ key, taken }) {
  was.set(teaching.value.id, teaching.value.predicted);
  if (!(await change("PUT", "/features", { features: { [key]: !taken } }))) return;
  say(t(taken ? "teach-left-said" : "teach-taken-said", { key }));
}
export const was = new Map(); // the prediction before the last tap, by draft

export const Features = ({ side, scale }) => html`<g class="features">
  ${teaching.value.features.map((feature) => {
    const { key, taken, why, outline } = feature;
    const line = outline[side];
    if (!line?.length) return null;
    const d = path(line, isClosed(feature) ? "Z" : "");
    const [x, y] = line.reduce((top, at) => (at[1] < top[1] ? at : top));
    return html`<g
      key=${key}
      class="feature ${taken ? "taken" : "left"} ${why ? "doubtful" : ""} ${lit.value === key ? "lit" : ""}"
      data-key=${key}
    >
      <path class="rim" d=${d} /><path class="line" d=${d} />
      ${
        (extent(line) > NAMED_PX * scale || lit.value === key) &&
        html`<text x=${x} y=${y - 8 * scale} translate=${false}>
          ${taken ? "✓ " : ""}${key}
        </text>`
      }
    </g>`;
  })}
</g>`;

export const Outlines = ({ side }) => html`<g class="contours">
  ${(teaching.value.outlines?.[side] ?? []).map((line, i) => html`<path key=${i} d=${path(line, "")} />`)}
</g>`;

export const Places = ({ side, scale }) => {
  const { reference, gripping, warnings } = teaching.value;
  const arm = 12 * scale;
  const cross = (name, at) =>
    at &&
    html`<g class="place ${name}">
      <path class="rim" d="M${at[0] - arm} ${at[1]}h${2 * arm}M${at[0]} ${at[1] - arm}v${2 * arm}" />
      <path class="line" d="M${at[0] - arm} ${at[1]}h${2 * arm}M${at[0]} ${at[1] - arm}v${2 * arm}" />
      <text x=${at[0]} y=${at[1] + 2.3 * arm}>${t(`teach-place-${name}`)}</text>
    </g>`;
  return html`${cross("reference", reference?.[side])} ${cross("gripping", gripping?.[side])}
    ${
      side === "left" &&
      warnings.map(
        ({ at }, i) =>
          at &&
          html`<g key=${i} class="place warning">
            <circle cx=${at[0]} cy=${at[1]} r=${11 * scale} /><text x=${at[0]} y=${at[1]}>${i + 1}</text>
          </g>`,
      )
    }`;
};

// --- as a list ---

const SIZES = ["diameter_mm", "length_mm", "width_mm"];
export const sized = ({ size }) =>
  SIZES.filter((name) => Number.isFinite(size?.[name]))
    .map((name) => t(`teach-size-${name.replace("_mm", "")}`, { mm: number(size[name], 3) }))
    .join(", ");

const light = (key) => ({
  onMouseEnter: () => (lit.value = key),
  onMouseLeave: () => (lit.value = null),
  onFocusin: () => (lit.value = key),
  onFocusout: () => (lit.value = null),
});

export function FeatureList({ size }) {
  const { features, proposing, trouble } = teaching.value;
  const taken = features.filter((feature) => feature.taken).length;
  const all = (isTaken) =>
    change("PUT", "/features", { features: Object.fromEntries(features.map(({ key }) => [key, isTaken])) });
  return html`<section aria-labelledby="teach-features">
    <h2 id="teach-features">${t("teach-features", { taken, count: features.length })}</h2>
    <p class="hint">${t("teach-features-what")}</p>
    ${
      !features.length &&
      !proposing &&
      !trouble &&
      html`<p>
        <${Shape} is="none" /> ${t("teach-no-features")}
      </p>`
    }
    <ul class="list features-list">
      ${features.map((feature) => {
        const { key, kind, sigma_um, why, outline } = feature;
        return html`<li key=${key} class=${lit.value === key ? "lit" : ""} ...${light(key)}>
          <label class="choice">
            <input
              type="checkbox" checked=${feature.taken} disabled=${!mayTake.value}
              onChange=${() => toggle(feature)}
            />
            <span>
              <strong translate=${false}>${key}</strong> ${t(`teach-kind-${kind}`)}${" "}
              <span class="figures">
                ${sized(feature)}
                ${
                  Number.isFinite(sigma_um) &&
                  html`${" "}<span class="nowrap" translate=${false}>
                      ± ${number(sigma_um, 1)} µm
                    </span>`
                }
              </span>
              ${why && html`<span class="why"><${Shape} is="doubt" /> ${inWords("teach-why", why)}</span>`}
            </span>
          </label>
          ${
            outline.left.length > 0 &&
            html`<button
              class="quiet" aria-label=${t("teach-look-at", { key })}
              onClick=${() => lookAt(size, centre(outline.left), 3 * extent(outline.left))}
            >
              ${t("teach-look")}
            </button>`
          }
        </li>`;
      })}
    </ul>
    ${
      features.length > 1 &&
      html`<div class="actions">
        <button disabled=${!mayTake.value || taken === features.length} onClick=${() => all(true)}>
          ${t("teach-take-all")}
        </button>
      </div>`
    }
  </section>`;
}
// Outline points of all features, raw px of the left picture.
export const around = (features) => features.flatMap(({ outline }) => outline.left);
export const extent = (line) =>
  Math.max(...[0, 1].map((i) => Math.max(...line.map((at) => at[i])) - Math.min(...line.map((at) => at[i]))));
export const centre = (line) =>
  [0, 1].map((i) => (Math.max(...line.map((at) => at[i])) + Math.min(...line.map((at) => at[i]))) / 2);

// --- predicted precision ---

const AXES = ["x", "y", "z"];
const TURNS = ["a", "b", "c"];
const digits = (value) => (value < 0.995 ? 2 : value < 9.95 ? 1 : 0);
const LESS = 0.995; // smaller changes are not shown

function Figure({ name, value, before, unit, places }) {
  const isKnown = Number.isFinite(value);
  const share = isKnown && Number.isFinite(before) && before > 0 ? value / before : 1;
  const isSame =
    isKnown && Number.isFinite(before) && number(value, places(value)) === number(before, places(before));
  const way = isSame ? null : share < LESS ? "better" : share > 1 / LESS ? "worse" : null;
  return html`<div class="figure-of ${way ?? ""}">
    <dt translate=${false}>${name.toUpperCase()}</dt>
    <dd>
      ${
        isKnown
          ? html`<span class="nowrap" translate=${false}>
            ± ${number(value, places(value))} <span class="unit" translate=${false}>${unit}</span>
          </span>`
          : html`<span class="unknown">${t("teach-free")}</span>`
      }
      ${
        way &&
        html`<span class="before">
          <span aria-hidden="true">${way === "better" ? "▼" : "▲"}</span>${" "}
          ${t(`teach-${way}`, { before: number(before, places(before)) })}
        </span>`
      }
    </dd>
  </div>`;
}

export function Predicted() {
  const { predicted, id, features, proposing } = teaching.value;
  // on top, so that nothing moves under a finger
  const busy =
    proposing &&
    html`<label class="busy">
      <span>${t("teach-proposing")}</span>
      <progress
        max="1" value=${task.value?.id === proposing ? (task.value.done ?? undefined) : undefined}
      ></progress>
    </label>`;
  if (!predicted)
    return html`<div class="big figure predicted" role="status">
      ${t(features.length ? "teach-predicted-none" : "teach-predicted-later")} ${busy}
    </div>`;
  const before = was.get(id);
  return html`<section class="predicted" aria-label=${t("teach-predicted")}>
    <h2>${t("teach-predicted")}</h2> ${busy}
    <div role="status">
      <dl class="figures-of">
        ${AXES.map(
          (axis) => html`<${Figure}
            key=${axis} name=${axis} unit="µm" value=${predicted.sigma_um?.[axis]}
            before=${before?.sigma_um?.[axis]} places=${digits}
          />`,
        )}
        ${TURNS.map(
          (turn) => html`<${Figure}
            key=${turn} name=${turn} unit="°" value=${predicted.sigma_deg?.[turn]}
            before=${before?.sigma_deg?.[turn]} places=${() => 3}
          />`,
        )}
      </dl>
    </div>
    <${Rivals} />
  </section>`;
}

const CONFUSABLE = 90; // percent
function Rivals() {
  const rivals = [...teaching.value.rivals]
    .sort((one, other) => other.alike_percent - one.alike_percent)
    .slice(0, 3);
  if (!rivals.length) return html`<p><${Shape} is="tick" /> ${t("teach-no-rivals")}</p>`;
  return rivals.map(
    ({ angle_deg, alike_percent }) =>
      html`<p key=${angle_deg}>
        <${Shape} is=${alike_percent >= CONFUSABLE ? "doubt" : "tick"} /> ${t(
          alike_percent >= CONFUSABLE ? "teach-rival" : "teach-far-rival",
          { angle: number(angle_deg), percent: number(alike_percent) },
        )}
      </p>`,
  );
}

export function Warnings({ size }) {
  const { warnings } = teaching.value;
  if (!warnings.length) return null;
  return html`<section aria-labelledby="teach-warnings">
    <h2 id="teach-warnings">${t("teach-warnings")}</h2>
    <ol class="list warnings">
      ${warnings.map(({ code, text, at }, i) => {
        const id = `teach-warning-${dashed(code)}`;
        return html`<li key=${i}>
          <p>
            <${Shape} is="doubt" /> ${at && html`<span class="count">${i + 1}</span>`}${" "}
            ${has(id) && html`${t(id)} `}
            <span class=${has(id) ? "hint" : ""} translate=${false} lang="en">${text}</span>
          </p>
          ${
            at &&
            html`<button
              class="quiet" aria-label=${t("teach-look-at", { key: String(i + 1) })}
              onClick=${() => lookAt(size, at)}
            >
              ${t("teach-look")}
            </button>`
          }
        </li>`;
      })}
    </ol>
  </section>`;
}
