// The region of the part: shapes over the left picture, drawn by finger, mouse or keys, sent when complete.
import { html, signal } from "../../vendor/ui.js";
import { mayTake } from "../shared/live.js";
import { Shape } from "../shared/pieces.js";
import { number, t } from "../shared/texts.js";
import { change, teaching } from "./teaching.js";
import { box, Handle, middle } from "./zoom.js";

export const TOOLS = ["tap", "rectangle", "circle", "polygon", "brush"];
export const tool = signal("tap");
const BRUSH_PX = 12; // on the screen, half its width
const LEAST_PX = 8; // half the least width of a shape
const MOST_HANDLES = 16; // a tapped outline has hundreds of corners: too many to drag
/**
 * Lengths in raw px of the left picture; add: false cuts.
 * @typedef {{ kind: string, add: boolean, x?: number, y?: number, width?: number, height?: number,
 *   radius?: number, points?: number[][] }} Area
 */
const edited = signal(/** @type {Area[]} */ (null)); // while something is drawn or dragged
const begun = signal([]); // tapped corners of a new shape
const isAdding = signal(true);

export const shapes = () => edited.value ?? teaching.value.shapes;
const points = (list) => list.map(([x, y]) => `${x},${y}`).join(" ");
const apart = ([ax, ay], [bx, by]) => Math.hypot(ax - bx, ay - by);

async function put(list) {
  edited.value = list;
  begun.value = [];
  await change("PUT", "/region", { shapes: list });
  if (edited.value === list) edited.value = null;
}
const add = (shape) => put([...teaching.value.shapes, shape]);

/** @returns {Area} */
const brushed = (line, scale) => ({
  kind: "brush",
  add: false,
  points: line,
  radius: Math.max(BRUSH_PX * scale, LEAST_PX),
});

// A shape by two points: opposite corners, or a centre and a point of the rim.
/** @returns {Area} */
function made(kind, [first, last]) {
  const shape = { kind, add: isAdding.value };
  if (kind === "circle")
    return { ...shape, x: first[0], y: first[1], radius: Math.max(apart(first, last), LEAST_PX) };
  const [x, y] = [0, 1].map((i) => Math.min(first[i], last[i]));
  return { ...shape, x, y, width: Math.abs(last[0] - first[0]), height: Math.abs(last[1] - first[1]) };
}
/** @param {Area} shape */
const isLarge = ({ kind, width, height }) => kind !== "rectangle" || Math.min(width, height) >= 2 * LEAST_PX;

export function tapped(at, scale) {
  if (tool.value === "tap") change("POST", "/tap", { x: at[0], y: at[1] });
  else if (tool.value === "brush") add(brushed([at], scale));
  else if (tool.value === "polygon") {
    if (begun.value.length > 2 && apart(at, begun.value[0]) < 24 * scale) close();
    else begun.value = [...begun.value, at];
  } else if (begun.value.length) {
    const shape = made(tool.value, [begun.value[0], at]);
    begun.value = [];
    if (isLarge(shape)) add(shape);
  } else begun.value = [at];
}

export const close = () => add({ kind: "polygon", add: isAdding.value, points: begun.value });

export function stroked(stroke, isDone, scale) {
  if (!stroke.length) edited.value = null;
  else {
    const last = stroke[stroke.length - 1];
    const shape =
      tool.value === "brush" ? brushed(thinned(stroke, scale), scale) : made(tool.value, [stroke[0], last]);
    if (!isDone) edited.value = [...teaching.value.shapes, shape];
    else if (isLarge(shape)) add(shape);
    else edited.value = null;
  }
}
export const draws = () => ["rectangle", "circle", "brush"].includes(tool.value);
const thinned = (stroke, scale) =>
  stroke.filter((at, i) => i === 0 || i === stroke.length - 1 || apart(at, stroke[i - 1]) > 2 * scale);

const outline = ({ kind, x, y, width, height, radius, points: list }) => {
  if (kind === "circle") return html`<circle cx=${x} cy=${y} r=${radius} />`;
  if (kind === "rectangle") return html`<rect x=${x} y=${y} width=${width} height=${height} />`;
  if (kind === "brush")
    return html`<polyline points=${points([...list, list.at(-1)])} style=${{ strokeWidth: 2 * radius }} />`;
  return html`<polygon points=${points(list)} />`;
};

// The handles of a shape: corners, or a circle's centre and rim.
function grips({ kind, x, y, width, height, radius, points: list }) {
  if (kind === "circle")
    return [
      [x, y],
      [x + radius, y],
    ];
  if (kind === "rectangle")
    return [
      [x, y],
      [x + width, y],
      [x + width, y + height],
      [x, y + height],
    ];
  return kind === "brush" || list.length > MOST_HANDLES ? [] : list;
}
function dragged(shape, i, at) {
  if (shape.kind === "circle")
    return i === 0
      ? { ...shape, x: at[0], y: at[1] }
      : { ...shape, radius: Math.max(apart([shape.x, shape.y], at), LEAST_PX) };
  if (shape.kind === "polygon")
    return { ...shape, points: shape.points.map((old, n) => (n === i ? at : old)) };
  const opposite = grips(shape)[(i + 2) % 4];
  const reach = [0, 1].map(
    (n) => Math.sign(at[n] - opposite[n] || 1) * Math.max(Math.abs(at[n] - opposite[n]), 2 * LEAST_PX),
  );
  const keepsSide = [0, 1].every((n) => Math.sign(reach[n]) === Math.sign(grips(shape)[i][n] - opposite[n]));
  if (!keepsSide) return shape; // a corner does not pass the opposite one
  const [x, y] = [0, 1].map((n) => Math.min(opposite[n], opposite[n] + reach[n]));
  return { ...shape, x, y, width: Math.abs(reach[0]), height: Math.abs(reach[1]) };
}
const replace = (i, shape) => shapes().map((old, n) => (n === i ? shape : old));
const without = (i) => put(teaching.value.shapes.filter((_, n) => n !== i));

export const Region = ({ scale, isEdited }) => html`<g class="region">
  ${shapes().map(
    (shape, i) => html`<g key=${i} class="${shape.kind} ${shape.add ? "adds" : "cuts"}">
      ${outline(shape)}
    </g>`,
  )}
  ${
    begun.value.length > 0 &&
    html`<g class="adds begun">
      <polyline points=${points(begun.value)} />
      ${begun.value.map(([x, y]) => html`<circle cx=${x} cy=${y} r=${7 * scale} />`)}
    </g>`
  }
  ${
    isEdited &&
    mayTake.value &&
    shapes().map((shape, i) =>
      grips(shape).map(
        (at, n) =>
          html`<${Handle}
            key=${`${i}.${n}`} at=${at} scale=${scale}
            label=${t("teach-handle", {
              shape: i + 1,
              point: n + 1,
              kind: t(`teach-shape-${shape.kind}`),
              x: number(at[0], 1),
              y: number(at[1], 1),
            })}
            onMove=${(to) => (edited.value = replace(i, dragged(shapes()[i], n, to)))}
            onEnd=${() => edited.value && put(edited.value)} onDelete=${() => without(i)}
          />`,
      ),
    )
  }
</g>`;

// Places a shape in the middle of the view, for work without a pointer.
function place(size) {
  const [x, y] = middle(box.value ?? { x: 0, y: 0, w: size.width, h: size.height });
  const reach = (box.value?.w ?? size.width) / 6;
  const corners = [
    [x - reach, y - reach],
    [x + reach, y - reach],
    [x + reach, y + reach],
    [x - reach, y + reach],
  ];
  if (tool.value === "polygon") add({ kind: "polygon", add: isAdding.value, points: corners });
  else
    add(
      made(
        tool.value,
        tool.value === "circle"
          ? [
              [x, y],
              [x + reach, y],
            ]
          : [corners[0], corners[2]],
      ),
    );
}

export function RegionTools({ size }) {
  const region = teaching.value.shapes;
  const isShape = ["rectangle", "circle", "polygon"].includes(tool.value);
  const choose = (one) => {
    tool.value = one;
    begun.value = [];
  };
  return html`<section aria-labelledby="teach-part">
    <h2 id="teach-part">${t("teach-part")}</h2>
    <p class="hint">${t(`teach-tool-${tool.value}-what`)}</p>
    <div class="tools" role="group" aria-label=${t("teach-part")}>
      ${TOOLS.map(
        (one) => html`<button
          key=${one} aria-pressed=${tool.value === one} disabled=${!mayTake.value}
          onClick=${() => choose(one)}
        >
          ${t(`teach-tool-${one}`)}
        </button>`,
      )}
    </div>
    ${
      isShape &&
      html`<div class="actions">
        <button aria-pressed=${!isAdding.value} onClick=${() => (isAdding.value = !isAdding.value)}>
          ${t("teach-cut")}
        </button>
        <button disabled=${!mayTake.value} onClick=${() => place(size)}>${t("teach-place")}</button>
        ${
          begun.value.length > 2 &&
          html`<button class="primary" onClick=${close}>${t("teach-close")}</button>`
        }
      </div>`
    }
    ${
      region.length > 0 &&
      html`<ul class="shapes">
        ${region.map(
          (shape, i) =>
            html`<li key=${i}>
              <${Shape} is=${shape.add ? "tick" : "gap"} /> <span>
                ${t(shape.add ? "teach-adds" : "teach-cuts", {
                  shape: i + 1,
                  kind: t(`teach-shape-${shape.kind}`),
                })}
              </span>
              <button
                disabled=${!mayTake.value} aria-label=${t("teach-remove-shape", { shape: i + 1 })}
                onClick=${() => without(i)}
              >
                ${t("teach-remove")}
              </button>
            </li>`,
        )}
      </ul>`
    }
    ${region.length === 0 && html`<p><${Shape} is="none" /> ${t("teach-no-region")}</p>`}
  </section>`;
}
