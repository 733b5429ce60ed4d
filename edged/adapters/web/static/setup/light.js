// Exposure, gain and focus of both lenses, while one looks at what they cost.
import { html, signal, useEffect } from "../vendor/ui.js";
import { ask, attempt } from "./api.js";
import { cameras, holds, lookAtCameras, quality, SIDES, token } from "./live.js";
import { Pair } from "./picture.js";
import { NumberField, Shape, Slider } from "./pieces.js";
import { number, t } from "./texts.js";

const SETTINGS = [
  { name: "exposure_us", unit: "µs", digits: 0, isLogarithmic: true },
  { name: "gain_db", unit: "dB", digits: 1, isLogarithmic: false },
];
const PLACES = ["near", "middle", "far"];
const SOFT_PX = 1.2;
const WIDEST_PX = 4;
const best = signal({});

// One request of a side at a time, the newest values next: a slider makes more than a camera can take.
const wanted = {};
const isAsking = {};
async function set(side, values) {
  wanted[side] = { ...wanted[side], ...values };
  if (isAsking[side]) return;
  isAsking[side] = true;
  while (wanted[side]) {
    const asked = wanted[side];
    wanted[side] = null;
    const read = await attempt(() => ask("PUT", `cameras/${side}`, { token: token.value, ...asked }));
    if (!read) continue;
    const { settings } = cameras.value;
    cameras.value = { ...cameras.value, settings: { ...settings, [side]: { ...settings[side], ...read } } };
  }
  isAsking[side] = false;
}

function Settings({ side }) {
  const settings = cameras.value?.settings?.[side];
  const limits = cameras.value?.limits?.[side];
  if (!settings || !limits) return html`<p class="muted">${t("light-no-settings")}</p>`;
  return html`<div class="settings" role="group" aria-label=${t(`settings-${side}`)}>
    ${SETTINGS.filter(({ name }) => limits[name]).map(({ name, unit, digits, isLogarithmic }) => {
      const [low, high] = limits[name];
      const label = t(`setting-${name.replace("_", "-")}`);
      const common = { label, value: settings[name], low, high, disabled: !holds.value, onValue: (value) => set(side, { [name]: value }) };
      return html`<div class="setting" key=${name}>
        <${NumberField} ...${common} unit=${unit} digits=${digits} name="${side}-${name}" />
        <${Slider} ...${common} isLogarithmic=${isLogarithmic} describe=${(value) => `${number(value, digits)} ${unit}`} />
      </div>`;
    })}
  </div>`;
}

function hold() {
  const held = { ...best.value };
  for (const side of SIDES)
    for (const [place, spread] of Object.entries(quality.value?.[side]?.edge_spread_px ?? {}))
      if (Number.isFinite(spread)) held[`${side}-${place}`] = Math.min(spread, held[`${side}-${place}`] ?? Infinity);
  if (JSON.stringify(held) !== JSON.stringify(best.value)) best.value = held;
}

function Spread({ side, place, spread }) {
  const held = best.value[`${side}-${place}`];
  const width = (px) => `${Math.min(100, (100 * px) / WIDEST_PX)}%`;
  return html`<li>
    <span>${t(`place-${place}`)}</span>
    <span class="bar" aria-hidden="true"
      >${Number.isFinite(spread) && html`<span class="now ${spread > SOFT_PX ? "soft" : ""}" style=${{ width: width(spread) }}></span>`}${Number.isFinite(held) && html`<span class="held" style=${{ left: width(held) }}></span>`}</span
    >
    <span class="figure">${Number.isFinite(spread) ? t("spread-now", { now: number(spread, 2) }) : t("spread-none")}</span>
    <span class="figure muted">${Number.isFinite(held) ? t("spread-best", { best: number(held, 2) }) : ""}</span>
  </li>`;
}

const percent = (share) => number(100 * share, share > 0 && share < 0.1 ? 1 : 0);

function Quality({ side }) {
  const now = quality.value?.[side];
  if (!now) return html`<p class="muted">${t("light-no-figures")}</p>`;
  const worse = Math.round(100 * ((now.sigma_z_factor ?? 1) - 1));
  const isClipped = now.clipped_share > 0.01;
  return html`<div class="quality">
    <p><${Shape} is=${isClipped ? "doubt" : "tick"} /> ${t("light-clipped", { share: percent(now.clipped_share) })} ${isClipped ? t("light-clipped-remedy") : ""}</p>
    <p><${Shape} is="none" /> ${t("light-dark", { share: percent(now.dark_share) })}</p>
    <p><${Shape} is="none" /> ${t("light-noise", { grey: number(now.noise_grey, 1) })}</p>
    <h3>${t("focus-title")}</h3>
    <ul class="spreads">
      ${PLACES.map((place) => html`<${Spread} key=${place} side=${side} place=${place} spread=${now.edge_spread_px?.[place]} />`)}
    </ul>
    <p class="cost"><${Shape} is=${worse > 25 ? "doubt" : "tick"} /> ${t("focus-cost", { percent: number(worse) })}</p>
  </div>`;
}

export function Light() {
  useEffect(() => {
    lookAtCameras();
  }, []);
  useEffect(hold, [quality.value]);
  const copy = () => {
    const { exposure_us, gain_db } = cameras.value.settings.left;
    set("right", Object.fromEntries(Object.entries({ exposure_us, gain_db }).filter(([, value]) => value !== undefined && value !== null)));
  };
  return html`<h1>${t("light-title")}</h1>
    <p class="lead">${t("light-what")}</p>
    <p class="legend"><span class="stripes-clipped"></span> ${t("legend-clipped")} <span class="stripes-dark"></span> ${t("legend-dark")}</p>
    <${Pair}
      isStriped=${true}
      below=${(side) => html`<${Settings} side=${side} /> <${Quality} side=${side} />`}
    />
    <div class="actions">
      <button type="button" disabled=${!holds.value || !cameras.value?.settings?.left} onClick=${copy}>${t("light-copy")}</button>
      <button type="button" onClick=${() => (best.value = {})}>${t("focus-reset")}</button>
    </div>`;
}
