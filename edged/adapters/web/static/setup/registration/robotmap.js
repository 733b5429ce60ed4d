// The map of the robot's error in use: what it is worth, and where the robot was off by how much.
import { html } from "../../vendor/ui.js";
import { number, t } from "../shared/texts.js";

const SIZE = 320;
const EDGE = 34;

export function RobotMap({ map }) {
  const { degree, points, alone_mm, held_out_mm, noise_mm } = map;
  const um = (mm) => t("robot-um-plain", { um: number(1000 * mm, 0) });
  const range = (axis) => {
    const along = points.map(({ place_mm }) => place_mm[axis]);
    return [Math.min(...along), Math.max(...along)];
  };
  const ranges = [0, 1, 2].map(range);
  const reach = ranges.map(([least, most], i) => `${"XYZ"[i]} ${number(least)} … ${number(most)} mm`);
  return html`<section aria-labelledby="robot-map" class="robot-map">
    <h2 id="robot-map">${t("robot-map")}</h2>
    <p>${t("robot-map-what")}</p>
    <dl class="facts">
      <dt>${t("robot-map-points")}</dt><dd>${t("robot-map-degree", { count: points.length, degree })}</dd>
      <dt>${t("robot-map-left-out")}</dt>
      <dd>${t("robot-map-from-to", { alone: um(alone_mm), held: um(held_out_mm) })}</dd>
      <dt>${t("robot-map-noise")}</dt><dd>${um(noise_mm)}</dd>
      <dt>${t("robot-map-hull")}</dt>
      <dd translate=${false}>${reach.join(", ")}</dd>
    </dl>
    <${Picture} points=${points} ranges=${ranges} />
  </section>`;
}

// From above; an arrow is as long as the robot was off there, many times larger than life.
function Picture({ points, ranges: [x, y] }) {
  const wide = Math.max(x[1] - x[0], y[1] - y[0]) || 1;
  const scale = (SIZE - 2 * EDGE) / wide;
  const off = ({ off_mm }) => Math.hypot(off_mm[0], off_mm[1]);
  const largest = Math.max(...points.map(off)) || 1;
  const grown = (0.12 * wide) / largest;
  const at = ([px, py]) => [EDGE + (px - x[0]) * scale, SIZE - EDGE - (py - y[0]) * scale];
  const told = t("robot-map-picture", { um: number(1000 * largest, 0), times: number(grown, 0) });
  return html`<figure>
    <svg viewBox="0 0 ${SIZE} ${SIZE}" role="img" aria-label=${told}>
      <path class="axes" d="M14 ${SIZE - 14}V${SIZE - 54}m-4 8l4 -8l4 8M14 ${SIZE - 14}H54m-8 -4l8 4l-8 4" />
      <text x="58" y=${SIZE - 10}>X</text><text x="9" y=${SIZE - 60}>Y</text>
      ${points.map(({ place_mm, off_mm }, i) => {
        const [from, to] = [place_mm, place_mm.map((mm, axis) => mm + grown * off_mm[axis])].map(at);
        return html`<g class="point" key=${i}>
          <path d="M${from[0]} ${from[1]}L${to[0]} ${to[1]}" /><circle cx=${from[0]} cy=${from[1]} r="4" />
        </g>`;
      })}
    </svg>
    <figcaption class="hint">${told}</figcaption>
  </figure>`;
}
