// The directions of the flange at each pose, as seen from the first, and the turn still missing.
import { html } from "../../vendor/ui.js";
import { number, t } from "../shared/texts.js";
import { sampleName } from "./registration.js";

const SIZE = 320;
const LEAST_DEG = 20;
const STEP_DEG = 10;

export function Sky({ sky, missing }) {
  const widest = Math.max(LEAST_DEG, ...sky.map(({ tilt_deg }) => tilt_deg));
  const rings = Math.ceil(widest / STEP_DEG);
  const scale = (SIZE / 2 - 34) / (rings * STEP_DEG);
  const at = ({ tilt_deg, azimuth_deg }) => {
    const angle = (azimuth_deg * Math.PI) / 180;
    return [tilt_deg * scale * Math.cos(angle), -tilt_deg * scale * Math.sin(angle)];
  };
  const told = t(missing ? `robot-sky-${missing}` : "robot-sky-whole");
  const far = rings * STEP_DEG * scale;
  const arrow = (angle) => html`<g transform="rotate(${angle})">
    <path d="M0 ${-0.35 * far}V${-0.8 * far}m-8 12l8 -14l8 14" />
  </g>`;
  return html`<section aria-labelledby="robot-sky" class="robot-sky">
    <h2 id="robot-sky">${t("robot-sky")}</h2>
    <svg
      viewBox="${-SIZE / 2} ${-SIZE / 2} ${SIZE} ${SIZE}" role="img"
      aria-label="${t("robot-sky-what", { count: sky.length })} ${told}"
    >
      ${Array.from(
        { length: rings },
        (_, i) => html`<g class="ring" key=${i}>
          <circle r=${(i + 1) * STEP_DEG * scale} />
          <text x="4" y=${-(i + 1) * STEP_DEG * scale - 4}>${number((i + 1) * STEP_DEG)}°</text>
        </g>`,
      )}
      <path class="ring" d="M${-far} 0H${far}M0 ${-far}V${far}" />
      ${
        (missing === "tilt" || missing === "all") &&
        html`<g class="missing">${[0, 90, 180, 270].map(arrow)}</g>`
      }
      ${
        (missing === "wrist" || missing === "all") &&
        html`<g class="missing">
          <path d="M${0.5 * far} 0A${0.5 * far} ${0.5 * far} 0 1 0 0 ${0.5 * far}m12 -9l-13 9l9 12" />
        </g>`
      }
      ${sky.map((one, i) => {
        const [x, y] = at(one);
        return html`<g class="star" key=${one.name} transform="translate(${x} ${y})">
          <path d="M0 0V-22" transform="rotate(${-one.turn_deg})" /><circle r="11" />
          <text y="5">${i + 1}</text>
        </g>`;
      })}
    </svg>
    <p class="verdict small">${told}</p>
    <ul class="unseen">
      ${sky.map(
        (one) => html`<li key=${one.name}>
          ${t("robot-sky-one", {
            name: sampleName(one.name),
            tilt: number(one.tilt_deg),
            turn: number(one.turn_deg),
          })}
        </li>`,
      )}
    </ul>
    <p class="hint">${t("robot-sky-hint")}</p>
  </section>`;
}
