// Exposure, gain and focus of both cameras, with the precision they cost.
import { html, signal, useEffect } from "../../vendor/ui.js";
import { ask, attempt } from "../shared/api.js";
import {
  cameras,
  hasObject,
  holds,
  keepSettings,
  lookAtCameras,
  pictures,
  quality,
  rawSize,
  SIDES,
  sayObject,
  token,
  useFresh,
} from "../shared/live.js";
import { Pair } from "../shared/picture.js";
import { NumberField, Shape, Slider } from "../shared/pieces.js";
import { dashed, number, t } from "../shared/texts.js";
import { Keep } from "./keepsettings.js";

const READ_PX = 480;
const CLIPPED = 252; // JPEG turns 255 into 252 and more
const DARK = 12; // the cell's limit
const STRIPE_PX = 5;

// Stripes where nothing can be measured: clipped lean right, dark lean left.
function stripe(bitmap, canvas) {
  const width = Math.min(READ_PX, bitmap.width);
  const height = Math.round((bitmap.height * width) / bitmap.width);
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  const context = canvas.getContext("2d", { willReadFrequently: true });
  context.drawImage(bitmap, 0, 0, width, height);
  const image = context.getImageData(0, 0, width, height);
  const pixels = new Uint32Array(image.data.buffer);
  for (let y = 0, i = 0; y < height; y++)
    for (let x = 0; x < width; x++, i++) {
      const grey = pixels[i] & 255;
      if (grey >= CLIPPED) pixels[i] = (x + y) % (2 * STRIPE_PX) < STRIPE_PX ? 0xff1a1aff : 0xff000000;
      else if (grey <= DARK) pixels[i] = (x - y + 10 * READ_PX) % (2 * STRIPE_PX) < 2 ? 0xffff9a3c : 0;
      else pixels[i] = 0;
    }
  context.putImageData(image, 0, 0);
}

const SETTINGS = [
  { name: "exposure_us", unit: "µs", digits: 0, isLogarithmic: true },
  { name: "gain_db", unit: "dB", digits: 1, isLogarithmic: false },
];
const SOFT = 1.25; // sigma relative to a sharp picture
const WIDEST_PX = 3;
const best = signal({});

// One request per side at a time, then the newest values: a slider is faster than a camera.
const wanted = {};
const isAsking = {};
async function set(side, values) {
  wanted[side] = { ...wanted[side], ...values };
  if (isAsking[side]) return true;
  isAsking[side] = true;
  let read = null;
  while (wanted[side]) {
    const asked = wanted[side];
    wanted[side] = null;
    read = await attempt(() => ask("PUT", `cameras/${side}`, { token: token.value, ...asked }));
    if (read) keepSettings(side, read);
  }
  isAsking[side] = false;
  return read;
}

function Settings({ side }) {
  const settings = cameras.value?.settings?.[side];
  const limits = cameras.value?.limits?.[side];
  if (!holds.value) return null;
  if (!settings || !limits) return html`<p class="muted">${t("light-no-settings")}</p>`;
  return html`<div class="settings" role="group" aria-label=${t(`settings-${side}`)}>
    ${SETTINGS.filter(({ name }) => limits[name]).map(({ name, unit, digits, isLogarithmic }) => {
      const [low, high] = limits[name];
      const label = t(`setting-${name.replace("_", "-")}`);
      const common = {
        label,
        value: settings[name],
        low,
        high,
        disabled: !holds.value,
        onValue: (value) => set(side, { [name]: value }),
      };
      return html`<div class="setting" key=${name}>
        <${NumberField} ...${common} unit=${unit} digits=${digits} name="${side}-${name}" />
        <${Slider}
          ...${common} isLogarithmic=${isLogarithmic}
          describe=${(value) => `${number(value, digits)} ${unit}`}
        />
      </div>`;
    })}
  </div>`;
}

function hold() {
  const held = { ...best.value };
  for (const side of SIDES) {
    const spread = quality.value?.[side]?.edge_spread_px.median;
    if (Number.isFinite(spread)) held[side] = Math.min(spread, held[side] ?? Infinity);
  }
  if (SIDES.some((side) => held[side] !== best.value[side])) best.value = held;
}

const percent = (share) => number(100 * share, share > 0 && share < 0.1 ? 1 : 0);
const isSoft = (figures) => (figures.sigma_z_factor ?? 1) > SOFT;

function Focus({ side, figures }) {
  const spread = figures.edge_spread_px.median;
  const held = best.value[side];
  const width = (px) => `${Math.min(100, (100 * px) / WIDEST_PX)}%`;
  if (!Number.isFinite(spread)) return html`<p><${Shape} is="none" /> ${t("focus-none")}</p>`;
  const worse = Math.round(100 * (figures.sigma_z_factor - 1));
  return html`<p class="big">
      ${t("focus-now", { now: number(spread, 2) })}${" "}
      <span class="muted">${t("focus-best", { best: number(held, 2) })}</span>
    </p>
    <span class="bar" aria-hidden="true">
      <span class="now ${isSoft(figures) ? "soft" : ""}" style=${{ width: width(spread) }}></span>
      <span class="held" style=${{ left: width(held) }}></span>
    </span>
    <p class="cost">
      <${Shape} is=${isSoft(figures) ? "doubt" : "tick"} />${" "}
      ${t("focus-cost", { percent: number(worse), isFree: worse > 0 ? 1 : 0 })}
    </p>`;
}

function Advice({ side, advice }) {
  const { exposure_us } = cameras.value?.settings?.[side] ?? {};
  const limits = cameras.value?.limits?.[side]?.exposure_us;
  const better =
    limits && exposure_us
      ? Math.min(limits[1], Math.max(limits[0], exposure_us * advice.exposure_factor))
      : null;
  const isOffered = holds.value && better !== null && Math.abs(advice.exposure_factor - 1) > 0.05;
  return html`<p>
      <${Shape} is=${advice.code === "good" ? "tick" : "doubt"} /> ${t(`advice-${dashed(advice.code)}`)}
    </p>
    ${
      isOffered &&
      html`<div class="actions">
        <button onClick=${() => set(side, { exposure_us: better })}>
          ${t("advice-take", { exposure: number(better) })}
        </button>
      </div>`
    }`;
}

function Quality({ side }) {
  const figures = pictures[side].value && quality.value?.[side];
  if (!figures) return holds.value && html`<p class="muted">${t("light-no-figures")}</p>`;
  if (!hasObject.value) return null;
  return html`<div class="quality">
    <h2>${t("light-head")}</h2>
    <${Advice} side=${side} advice=${figures.advice} />
    <p class="muted">
      ${t("light-figures", {
        clipped: percent(figures.clipped_share),
        dark: percent(figures.dark_share),
        noise: number(figures.noise_grey, 1),
        contrast: number(figures.contrast_grey),
      })}
    </p>
    <h2>${t("focus-title")}</h2>
    <${Focus} side=${side} figures=${figures} />
  </div>`;
}

// The widths of edges over the picture: a tilted sensor or part is sharp on one side only.
function fields(side) {
  const map = (pictures[side].value && quality.value?.[side]?.edge_spread_px.map) ?? [];
  const { width, height } = rawSize(side);
  const at = (i, count, size) => ((i + 0.5) * size) / count;
  return html`<g class="fields" style=${{ fontSize: `${width / 34}px` }}>
    ${map.flatMap((row, y) =>
      row.map(
        (px, x) =>
          Number.isFinite(px) &&
          html`<text x=${at(x, row.length, width)} y=${at(y, map.length, height)}>${number(px, 2)}</text>`,
      ),
    )}
  </g>`;
}

// First the thing, then the advice.
function Thing() {
  const isThere = hasObject.value;
  return html`<div class="keep">
    <p><${Shape} is=${isThere ? "tick" : "hand"} /> ${t(isThere ? "light-thing-there" : "light-thing")}</p>
    <button class=${isThere ? "" : "primary"} onClick=${() => sayObject(!isThere)}>
      ${t(isThere ? "light-thing-gone" : "light-thing-is")}
    </button>
  </div>`;
}

export default function Light() {
  useFresh(lookAtCameras, [holds.value]); // settings come only with a lease
  useEffect(hold, [quality.value]);
  const copy = () => {
    const { exposure_us, gain_db } = cameras.value.settings.left;
    set(
      "right",
      Object.fromEntries(
        Object.entries({ exposure_us, gain_db }).filter(([, value]) => value !== undefined && value !== null),
      ),
    );
  };
  return html`<h1>${t("light-title")}</h1>
    <p class="lead">${t("light-what")}</p>
    ${holds.value && html`<${Thing} />`}
    <p class="legend">
      <span class="stripes-clipped"></span> ${t("legend-clipped")} <span class="stripes-dark"></span>${" "}
      ${t("legend-dark")}
    </p>
    <${Pair}
      stripe=${stripe} over=${fields}
      below=${(side) => html`<${Settings} side=${side} /> <${Quality} side=${side} />`}
    />
    ${!holds.value && html`<p class="hint">${t("light-take")}</p>`}
    <div class="actions">
      <button disabled=${!holds.value || !cameras.value?.settings?.left} onClick=${copy}>
        ${t("light-copy")}
      </button>
      <button onClick=${() => (best.value = {})}>${t("focus-reset")}</button>
    </div>
    <${Keep} />`;
}
