// A cycle enlarged: both pictures with the measured features, at the same zoom.

import { fetched } from "../setup/shared/fetched.js";
import { t } from "../setup/shared/texts.js";
import { $, drawing, SIDES } from "./dom.js";
import { causes, clock, statusOf } from "./sentences.js";

const MOST = 16;
let kept = [];
let enlarged = null;
let view = { scale: 1, x: 0, y: 0 };

export async function enlarge(cycle) {
  const shown = await fetched(`/cycle/${cycle}.json`);
  if (!shown && $("viewer").open) $("viewedwhy").textContent = t("run-forgotten", { cycle: String(cycle) });
  if (!shown) return;
  const { width, height } = shown.picture;
  if (!enlarged || enlarged.width !== width || enlarged.height !== height) view = { scale: 1, x: 0, y: 0 };
  enlarged = { cycle, width, height };
  const title = [t("run-cycle", { cycle: String(cycle) }), clock(shown.time_ns), statusOf(shown.status)];
  $("viewed").textContent = title.join(" · ");
  $("viewedwhy").replaceChildren(...causes(shown.why));
  for (const side of SIDES) {
    // at full size at once: the cell may have dropped the cycle by the time of zooming
    const image = drawing("image", { x: 0, y: 0, width, height, href: `/picture/${cycle}/${side}/full` });
    const drawn = shown.picture.marks.map((mark) => marks(mark, side, shown.picture));
    $(`large${side}`).replaceChildren(image, ...drawn);
  }
  showNeighbours();
  look();
  if (!$("viewer").open) $("viewer").showModal();
}

function look() {
  const { width, height } = enlarged;
  view.scale = Math.min(MOST, Math.max(1, view.scale));
  const part = 1 / view.scale;
  view.x = Math.min(1 - part, Math.max(0, view.x));
  view.y = Math.min(1 - part, Math.max(0, view.y));
  const box = [view.x * width, view.y * height, part * width, part * height];
  for (const side of SIDES) $(`large${side}`).setAttribute("viewBox", box.join(" "));
  $("smaller").disabled = $("whole").disabled = view.scale === 1;
  $("larger").disabled = view.scale === MOST;
}

// x, y: the fixed point, 0 to 1 across the view
function zoom(factor, x = 0.5, y = 0.5) {
  const before = 1 / view.scale;
  view.scale = Math.min(MOST, Math.max(1, view.scale * factor));
  view.x += (before - 1 / view.scale) * x;
  view.y += (before - 1 / view.scale) * y;
  look();
}

function move(x, y) {
  view.x += x / view.scale;
  view.y += y / view.scale;
  look();
}

function step(direction) {
  const next =
    direction < 0
      ? kept.filter((cycle) => cycle < enlarged.cycle).pop()
      : kept.find((cycle) => cycle > enlarged.cycle);
  if (next !== undefined) enlarge(next);
}

/** @returns {[number, number]} */
function place(svg, { clientX, clientY }) {
  const box = svg.getBoundingClientRect();
  return [(clientX - box.left) / box.width, (clientY - box.top) / box.height];
}

for (const svg of [$("largeleft"), $("largeright")]) {
  const fingers = new Map();
  svg.addEventListener(
    "wheel",
    (event) => {
      event.preventDefault();
      zoom(Math.exp((-event.deltaY * (event.deltaMode ? 16 : 1)) / 400), ...place(svg, event));
    },
    { passive: false },
  );
  svg.addEventListener("dblclick", (event) => zoom(2, ...place(svg, event)));
  svg.addEventListener("pointerdown", (event) => {
    svg.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, place(svg, event));
  });
  for (const name of ["pointerup", "pointercancel"])
    svg.addEventListener(name, (event) => fingers.delete(event.pointerId));
  svg.addEventListener("pointermove", (event) => {
    const old = fingers.get(event.pointerId);
    if (!old) return;
    const now = place(svg, event);
    fingers.set(event.pointerId, now);
    const other = [...fingers].find(([id]) => id !== event.pointerId);
    if (!other) return move(old[0] - now[0], old[1] - now[1]);
    const apart = ([x, y]) => Math.hypot(x - other[1][0], y - other[1][1]);
    if (apart(old) > 0) zoom(apart(now) / apart(old), (now[0] + other[1][0]) / 2, (now[1] + other[1][1]) / 2);
  });
}

const KEYS = {
  "+": () => zoom(1.5),
  "=": () => zoom(1.5),
  "-": () => zoom(1 / 1.5),
  0: () => zoom(0),
  ArrowLeft: () => (view.scale > 1 ? move(-0.15, 0) : step(-1)),
  ArrowRight: () => (view.scale > 1 ? move(0.15, 0) : step(1)),
  ArrowUp: () => move(0, -0.15),
  ArrowDown: () => move(0, 0.15),
};
// on the document, as a button that gets disabled loses the focus
document.addEventListener("keydown", (event) => {
  if (!$("viewer").open || event.ctrlKey || event.metaKey || event.altKey || !KEYS[event.key]) return;
  event.preventDefault();
  KEYS[event.key]();
});
const BUTTONS = {
  older: () => step(-1),
  newer: () => step(1),
  smaller: KEYS["-"],
  whole: KEYS[0],
  larger: KEYS["+"],
  close: () => $("viewer").close(),
};
for (const [name, act] of Object.entries(BUTTONS)) $(name).addEventListener("click", act);

// Sets the cycles that can be enlarged: the cell still has their pictures.
export function keep(cycles) {
  kept = cycles;
  showNeighbours();
}

// Shows the cycle again after a change of language.
export const speakAgain = () => $("viewer").open && enlarge(enlarged.cycle);

function showNeighbours() {
  $("older").disabled = !enlarged || !kept.some((cycle) => cycle < enlarged.cycle);
  $("newer").disabled = !enlarged || !kept.some((cycle) => cycle > enlarged.cycle);
}

export function marks(mark, side, { width, height }) {
  const group = drawing("g", {
    fill: "none",
    "stroke-width": width / 500,
    stroke: mark.good ? "#2fe37a" : "#ff8f3a",
  });
  const point = (at) => `${(at[0] * width).toFixed(1)},${(at[1] * height).toFixed(1)}`;
  const points = (line) => line.map(point).join(" ");
  for (const line of mark[side].features) group.append(drawing("polyline", { points: points(line) }));
  const [origin, ...ends] = mark[side].axes;
  for (const [i, [name, colour]] of Object.entries({ x: "#ff5d52", y: "#4fb3ff" }).entries()) {
    group.append(drawing("polyline", { points: points([origin, ends[i]]), stroke: colour }));
    const label = drawing("text", {
      x: ends[i][0] * width + width / 150,
      y: ends[i][1] * height + width / 80,
      fill: colour,
      stroke: "none",
      "font-size": width / 30,
    });
    label.textContent = name;
    group.append(label);
  }
  if (mark[side].tool.length) {
    const { tool } = mark[side];
    const dashes = { stroke: "#ffd34d", "stroke-dasharray": width / 100 };
    group.append(drawing("polyline", { points: points(tool), ...dashes }));
    const [cx, cy] = point(tool[1]).split(",");
    group.append(drawing("circle", { cx, cy, r: width / 120, stroke: "#ffd34d" }));
  }
  return group;
}
