// The map of predicted sigma, layer by layer, and where the part has lain already.
import { html, useEffect, useState } from "../../vendor/ui.js";
import { sentence } from "../shared/api.js";
import { Shape } from "../shared/pieces.js";
import { number, t } from "../shared/texts.js";
import { findMap, map, mapTrouble, trial } from "./trial.js";

const AXES = ["x", "y", "z"];
const worst = (sigma) => (sigma ? Math.max(...AXES.map((axis) => sigma[axis])) : null);
const levels = (points, axis) =>
  [...new Set(points.map((point) => point[axis]))].sort((one, other) => one - other);
const LAYERS = { 1: ["middle"], 2: ["near", "far"], 3: ["near", "middle", "far"] };

function Cells({ points, xs, ys, limit, covered, depth }) {
  const [width, height] = [step(xs), step(ys)];
  const at = (point) => [point.x - width / 2, point.y - height / 2];
  const most = Math.max(limit, ...points.map(({ sigma_um }) => worst(sigma_um) ?? 0));
  const pad = width * 0.1;
  const box = [
    xs[0] - width / 2 - pad,
    ys[0] - height / 2 - pad,
    xs.at(-1) - xs[0] + width + 2 * pad,
    ys.at(-1) - ys[0] + height + 2 * pad,
  ];
  return html`<svg class="sigma-map" viewBox=${box.join(" ")} role="img" aria-label=${t("try-map-title")}>
    <defs>
      <pattern
        id="beyond" width=${width / 5} height=${width / 5} patternUnits="userSpaceOnUse"
        patternTransform="rotate(45)"
      >
        <rect class="under" width=${width / 5} height=${width / 5} />
        <line x1="0" x2="0" y1="0" y2=${width / 5} />
      </pattern>
    </defs>
    ${points.map((point) => {
      const sigma = worst(point.sigma_um);
      const [x, y] = at(point);
      const isBeyond = sigma !== null && sigma > limit;
      return html`<g key=${`${point.x} ${point.y}`}>
        <rect
          class=${sigma === null ? "unseen-cell" : isBeyond ? "beyond" : "within"} x=${x} y=${y}
          width=${width} height=${height} fill=${isBeyond ? "url(#beyond)" : undefined}
          style=${
            sigma === null || isBeyond ? undefined : { fillOpacity: 0.08 + 0.5 * (sigma / (most || 1)) }
          }
        />
      </g>`;
    })}
    ${covered.map(
      ([x, y, z], i) => html`<circle
        key=${i} class="covered ${Math.abs(z - depth.z) <= depth.half ? "here" : ""}" cx=${x} cy=${y}
        r=${width / 10}
      />`,
    )}
    ${points.map((point) => {
      const sigma = worst(point.sigma_um);
      return (
        sigma !== null &&
        html`<text
          key=${`${point.x} ${point.y}`} x=${point.x} y=${point.y}
          style=${{ fontSize: `${Math.min(width / 2.6, height / 2)}px` }} translate=${false}
        >
          ${number(sigma, sigma < 9.95 ? 1 : 0)}
        </text>`
      );
    })}
  </svg>`;
}
const step = (values) => (values.length > 1 ? (values.at(-1) - values[0]) / (values.length - 1) : 10);

export function SigmaMap() {
  const [layer, setLayer] = useState(null);
  const isUsual = map.value !== null && !map.value.measured;
  const isSeen = trial.value?.status === "OK";
  useEffect(() => {
    if (isUsual && isSeen) findMap(false);
  }, [isUsual && isSeen]);
  if (mapTrouble.value)
    return html`<p class="wrong">
      <${Shape} is="doubt" /> ${sentence(mapTrouble.value)}
    </p>`;
  if (!map.value) return html`<p class="muted" role="status">${t("try-map-coming")}</p>`;
  const { points, limit_um: limit } = map.value;
  const zs = levels(points, "z");
  if (!points.some(({ sigma_um }) => sigma_um))
    return html`<p>
      <${Shape} is="gap" /> ${t("try-map-none")}
    </p>`;
  const z = zs.includes(layer) ? layer : zs[Math.floor(zs.length / 2)];
  const shown = points.filter((point) => point.z === z);
  const seen = points.filter(({ sigma_um }) => sigma_um);
  const beyond = seen.filter(({ sigma_um }) => worst(sigma_um) > limit).length;
  const covered = trial.value?.covered ?? [];
  const names = LAYERS[zs.length] ?? zs.map(() => null);
  return html`<section aria-labelledby="try-map">
    <h2 id="try-map">${t("try-map-title")}</h2>
    <p class="hint">${t(isUsual ? "try-map-usual" : "try-map-what")}</p>
    <p>
      <${Shape} is=${beyond ? "doubt" : "tick"} />${" "}
      ${t("try-map-beyond", { beyond, count: seen.length, limit: number(limit) })}
    </p>
    ${
      zs.length > 1 &&
      html`<div class="choices" role="radiogroup" aria-label=${t("try-map-layer")}>
        ${zs.map(
          (one, i) => html`<label class="choice" key=${one}>
            <input type="radio" name="layer" checked=${one === z} onChange=${() => setLayer(one)} />${" "}
            ${names[i] ? t(`try-layer-${names[i]}`) : ""} <span translate=${false}>Z ${number(one)} mm</span>
          </label>`,
        )}
      </div>`
    }
    <${Cells}
      points=${shown} xs=${levels(shown, "x")} ys=${levels(shown, "y")} limit=${limit} covered=${covered}
      depth=${{ z, half: step(zs) / 2 }}
    />
    <p class="legend">
      ${[
        ["within", "try-legend-within"],
        ["beyond", "try-legend-beyond"],
        ["dot", "try-legend-covered"],
      ].map(
        ([is, text]) => html`<span class="key" key=${is}>
          <span class="swatch ${is}"></span> ${t(text)}
        </span>`,
      )}
    </p>
    ${
      Number.isFinite(trial.value?.covered_share) &&
      html`<label class="meter">
        <span>${t("try-covered", { percent: number(100 * trial.value.covered_share) })}</span>
        <progress max="1" value=${trial.value.covered_share}></progress>
      </label>`
    }
  </section>`;
}
