// A recorded pair beside the taught or a good one, at the same zoom, with a table of features.
import { html, signal, useRef } from "../../vendor/ui.js";
import { SIDES } from "../shared/live.js";
import { Shape } from "../shared/pieces.js";
import { number, sign, t } from "../shared/texts.js";
import { part } from "./recorded.js";

const lit = signal(null); // the highlighted feature
// zoom relative to the part's size; x, y from its middle, raw px
const view = signal({ zoom: 1, x: 0, y: 0 });
const other = signal(null); // "taught" or "good"
const ROOM = 1.7;
const STEP = 1.4;
const MOST_ZOOM = 12;
const WHY = { outside: "gap", unseen: "doubt", tolerance: "doubt", not_found: "gap" };

const allPoints = (one, side) => (one?.features ?? []).flatMap(({ outline }) => outline[side]);
function box(points) {
  if (!points.length) return null;
  const [xs, ys] = [points.map(([x]) => x), points.map(([, y]) => y)];
  const [x0, x1, y0, y1] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
  return { x: (x0 + x1) / 2, y: (y0 + y1) / 2, w: x1 - x0, h: y1 - y0 };
}

// The shown width, raw px, the same in every picture: what looks smaller is farther away.
function spanOf(document, sights) {
  const boxes = sights.flatMap((one) => SIDES.map((side) => box(allPoints(one, side))).filter(Boolean));
  const { width, height } = document.now;
  if (!boxes.length) return width;
  const wanted = ROOM * Math.max(...boxes.map(({ w, h }) => Math.max(w, (h * width) / height)));
  return Math.min(Math.max(wanted, width / MOST_ZOOM), width);
}

const path = (points, isClosed) => `M${points.map(([x, y]) => `${x} ${y}`).join("L")}${isClosed ? "Z" : ""}`;

function Features({ one, side }) {
  return (one?.features ?? [])
    .filter(({ outline }) => outline[side].length)
    .map(({ key, kind, why, outline }) => {
      const d = path(outline[side], kind !== "edge");
      const [x, y] = outline[side].reduce((best, point) => (point[1] < best[1] ? point : best));
      const isLit = lit.value === key;
      return html`<g key=${key} class="feature ${why ? "amiss" : ""} ${isLit ? "lit" : ""}">
        <path class="rim" d=${d} /><path class="line" d=${d} />
        ${isLit && html`<text x=${x} y=${y}>${key}</text>`}
      </g>`;
    });
}

function Picture({ sight, one, side, span, label }) {
  const svg = useRef(null);
  const held = useRef(null);
  const { width, height, pictures } = sight;
  const middle = box(allPoints(one, side)) ?? { x: width / 2, y: height / 2 };
  const isWhole = view.value.zoom === 0;
  const w = isWhole ? width : span / view.value.zoom;
  const h = (w * height) / width;
  const [x, y] = isWhole ? [-0.5, -0.5] : [middle.x + view.value.x - w / 2, middle.y + view.value.y - h / 2];
  const down = (event) => {
    held.current = { x: event.clientX, y: event.clientY, was: view.value };
    event.currentTarget.setPointerCapture(event.pointerId);
  };
  const move = (event) => {
    if (!held.current || isWhole) return;
    const scale = w / svg.current.getBoundingClientRect().width;
    const { was } = held.current;
    view.value = {
      ...was,
      x: was.x - (event.clientX - held.current.x) * scale,
      y: was.y - (event.clientY - held.current.y) * scale,
    };
  };
  const up = () => {
    held.current = null;
  };
  return html`<svg
    ref=${svg} class="recorded" viewBox="${x} ${y} ${w} ${h}"
    style=${{ "--px": w / 480, aspectRatio: `${width} / ${height}` }} role="img" aria-label=${label}
    onPointerDown=${down} onPointerMove=${move} onPointerUp=${up} onPointerCancel=${up}
  >
    ${pictures && html`<image href=${pictures[side]} x="-0.5" y="-0.5" width=${width} height=${height} />`}
    <${Features} one=${one} side=${side} />
    ${
      one &&
      !one.measured &&
      side === "left" &&
      html`<path
        class="missed"
        d="M${one.at[0] - w / 40} ${one.at[1] - w / 40}l${w / 20} ${w / 20}m0 ${-w / 20}l${-w / 20} ${w / 20}"
      />`
    }
  </svg>`;
}

const zoomBy = (factor) => () => {
  const { zoom, x, y } = view.value;
  view.value = { zoom: Math.min(Math.max((zoom || 0.3) * factor, 0.3), MOST_ZOOM), x, y };
};
const STEP_PX = 12;
function steer(event) {
  const [x, y] =
    { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key] ?? [];
  if (x !== undefined)
    view.value = { ...view.value, x: view.value.x + x * STEP_PX, y: view.value.y + y * STEP_PX };
  else if (event.key === "+") zoomBy(STEP)();
  else if (event.key === "-") zoomBy(1 / STEP)();
  else return;
  event.preventDefault();
}

function Tools({ choices, chosen }) {
  const isWhole = view.value.zoom === 0;
  return html`<div class="actions tools" role="group" aria-label=${t("cycles-view")} onKeyDown=${steer}>
    <button aria-label=${t("cycles-zoom-in")} onClick=${zoomBy(STEP)}>+</button>
    <button aria-label=${t("cycles-zoom-out")} disabled=${isWhole} onClick=${zoomBy(1 / STEP)}>−</button>
    <button
      aria-pressed=${!isWhole && view.value.zoom === 1}
      onClick=${() => (view.value = { zoom: 1, x: 0, y: 0 })}
    >
      ${t("cycles-zoom-part")}
    </button>
    <button aria-pressed=${isWhole} onClick=${() => (view.value = { zoom: 0, x: 0, y: 0 })}>
      ${t("cycles-zoom-whole")}
    </button>
    ${
      choices.length > 1 &&
      choices.map(
        (
          kind,
        ) => html`<button key=${kind} aria-pressed=${chosen === kind} onClick=${() => (other.value = kind)}>
          ${t(`cycles-beside-${kind}`)}
        </button>`,
      )
    }
  </div>`;
}

const sizeOf = (size) =>
  size
    ? Object.values(size)
        .map((one) => number(one, 3))
        .join(" × ")
    : "–";
function Table({ one }) {
  const why = (feature) =>
    feature.why
      ? html`<${Shape} is=${WHY[feature.why]} />${" "}
        ${t(`cycles-why-${feature.why.replace("_", "-")}`)}`
      : html`<${Shape} is="tick" /> ${t("cycles-why-none")}`;
  return html`<div class="scroll" tabindex="0" role="region" aria-label=${t("cycles-features")}>
    <table class="features">
      <thead>
        <tr>
          <th scope="col">${t("cycles-feature")}</th><th scope="col">${t("cycles-taught")}</th>
          <th scope="col">${t("cycles-now")}</th><th scope="col">${t("cycles-off")}</th>
          <th scope="col">${t("cycles-why")}</th>
        </tr>
      </thead>
      <tbody>
        ${one.features.map(
          (feature) =>
            html`<tr key=${feature.key} class=${lit.value === feature.key ? "lit" : ""}>
              <th scope="row">
                <button
                  class="quiet" aria-pressed=${lit.value === feature.key}
                  onClick=${() => (lit.value = lit.value === feature.key ? null : feature.key)}
                >
                  <span translate=${false}>${feature.key}</span> ${t(`cycles-kind-${feature.kind}`)}
                </button>
              </th>
              <td class="figure">${sizeOf(feature.taught)}</td>
              <td class="figure">${sizeOf(feature.now)}</td>
              <td class="figure">
                ${
                  feature.off_um === null
                    ? "–"
                    : html`${sign(feature.off_um, 1)}
                      ${feature.sigma_um !== null && ` ± ${number(feature.sigma_um, 1)}`}`
                }
              </td>
              <td>${why(feature)}</td>
            </tr>`,
        )}
      </tbody>
    </table>
  </div>`;
}

export function Sigmas({ of }) {
  if (!of) return null;
  return html`<span class="figure" translate=${false}>
    ${["X", "Y", "Z"].map((axis, i) => `${axis} ±${number(of[i], 1)}`).join("  ")} µm
  </span>`;
}

export function Beside({ document }) {
  const { now, taught, beside } = document;
  const kinds = [...(taught?.pictures ? ["taught"] : []), ...(beside ? ["good"] : [])];
  const kind = kinds.includes(other.value) ? other.value : (kinds[0] ?? "taught");
  const reference = kind === "good" ? beside : taught;
  const one = now.parts[Math.min(part.value, now.parts.length - 1)];
  const theirs = reference?.parts[0];
  const span = spanOf(document, [one, theirs]);
  const captions = {
    now: t("cycles-this"),
    other: kind === "good" ? t("cycles-good", { number: String(beside.number) }) : t("cycles-as-taught"),
  };
  return html`${
    now.parts.length > 1 &&
    html`<label class="field">
        <span>${t("cycles-part")}</span>
        <select onChange=${(event) => (part.value = Number(event.currentTarget.value))}>
          ${now.parts.map(
            (each, i) => html`<option value=${i} selected=${i === part.value}>
              ${t(each.good ? "cycles-part-good" : "cycles-part-bad", { number: i + 1 })}
            </option>`,
          )}
        </select>
      </label>`
  }
    ${!one && html`<p><${Shape} is="none" /> ${t("cycles-nothing")}</p>`}
    ${
      one &&
      !one.measured &&
      html`<p>
        <${Shape} is="doubt" /> ${
          one.needed_score === null
            ? t("cycles-dismissed", { score: number(one.score, 2) })
            : t("cycles-nearest", { score: number(one.score, 2), needed: number(one.needed_score, 2) })
        }
      </p>`
    }
    ${
      one?.sigma_um &&
      html`<p>
        ${t("cycles-place")} <span class="figure" translate=${false}>
          ${one.place_mm.map((value) => number(value, 3)).join("  ")} mm
        </span>, <${Sigmas} of=${one.sigma_um} />
      </p>`
    }
    <${Tools} choices=${kinds} chosen=${kind} />
    <div class="besides">
      ${SIDES.map(
        (side) =>
          html`<figure key=${side}>
              <figcaption>${captions.now}, ${t(side)}</figcaption>
              <${Picture}
                sight=${now} one=${one} side=${side} span=${span} label=${`${captions.now}, ${t(side)}`}
              />
            </figure>
            <figure key=${`${side} other`}>
              <figcaption>${captions.other}, ${t(side)}</figcaption>
              <${Picture}
                sight=${reference ?? now} one=${theirs} side=${side} span=${span}
                label=${`${captions.other}, ${t(side)}`}
              />
            </figure>`,
      )}
    </div>
    ${!taught?.pictures && !beside && html`<p class="hint">${t("cycles-no-beside")}</p>`}
    ${one && html`<${Table} one=${one} />`}`;
}
