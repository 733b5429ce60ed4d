// Any of the last cycles enlarged: both pictures with what was measured, at the same zoom.
import { $, drawing, SIDES } from "./dom.js";
import { causes, clock, statusOf } from "./sentences.js";
import { t } from "../setup/texts.js";

const MOST = 16;
let kept = [];
let enlarged = null;
let view = { scale: 1, x: 0, y: 0 };

export async function enlarge(cycle) {
  const answer = await fetch(`/cycle/${cycle}.json`);
  const shown = answer.ok ? await answer.json() : null;
  if (!shown && $("viewer").open) $("viewedwhy").textContent = t("run-forgotten", { cycle: String(cycle) });
  if (!shown) return;
  const { width, height } = shown.picture;
  if (!enlarged || enlarged.width !== width || enlarged.height !== height) view = { scale: 1, x: 0, y: 0 };
  enlarged = { cycle, width, height };
  $("viewed").textContent = [t("run-cycle", { cycle: String(cycle) }), clock(shown.time_ns), statusOf(shown.status)].join(" · ");
  $("viewedwhy").replaceChildren(...causes(shown.why));
  for (const side of SIDES) {
    // in full from the beginning: when somebody zooms the cell may have forgotten the cycle
    const image = drawing("image", { x: 0, y: 0, width, height, href: `/picture/${cycle}/${side}/full` });
    $(`large${side}`).replaceChildren(image, ...shown.picture.marks.map((mark) => marks(mark, side, shown.picture)));
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
  for (const side of SIDES) $(`large${side}`).setAttribute("viewBox", `${view.x * width} ${view.y * height} ${part * width} ${part * height}`);
  $("smaller").disabled = $("whole").disabled = view.scale === 1;
  $("larger").disabled = view.scale === MOST;
}

// factor, and the place of the view that stays where it is, 0 to 1
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
  const next = direction < 0 ? kept.filter((one) => one < enlarged.cycle).pop() : kept.find((one) => one > enlarged.cycle);
  if (next !== undefined) enlarge(next);
}

function place(svg, { clientX, clientY }) {
  const box = svg.getBoundingClientRect();
  return [(clientX - box.left) / box.width, (clientY - box.top) / box.height];
}

for (const svg of [$("largeleft"), $("largeright")]) {
  const fingers = new Map();
  svg.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(Math.exp((-event.deltaY * (event.deltaMode ? 16 : 1)) / 400), ...place(svg, event));
  }, { passive: false });
  svg.addEventListener("dblclick", (event) => zoom(2, ...place(svg, event)));
  svg.addEventListener("pointerdown", (event) => {
    svg.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, place(svg, event));
  });
  for (const name of ["pointerup", "pointercancel"]) svg.addEventListener(name, (event) => fingers.delete(event.pointerId));
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
  "+": () => zoom(1.5), "=": () => zoom(1.5), "-": () => zoom(1 / 1.5), 0: () => zoom(0),
  ArrowLeft: () => (view.scale > 1 ? move(-0.15, 0) : step(-1)), ArrowRight: () => (view.scale > 1 ? move(0.15, 0) : step(1)),
  ArrowUp: () => move(0, -0.15), ArrowDown: () => move(0, 0.15),
};
// of the document: a button that has just been disabled has lost the focus to nobody
document.addEventListener("keydown", (event) => {
  if (!$("viewer").open || event.ctrlKey || event.metaKey || event.altKey || !KEYS[event.key]) return;
  event.preventDefault();
  KEYS[event.key]();
});
for (const [name, done] of [["older", () => step(-1)], ["newer", () => step(1)], ["smaller", () => zoom(1 / 1.5)], ["whole", () => zoom(0)], ["larger", () => zoom(1.5)], ["close", () => $("viewer").close()]])
  $(name).addEventListener("click", done);

// What can be enlarged: the cycles whose pictures the cell still has.
export function keep(cycles) {
  kept = cycles;
  showNeighbours();
}

// Again in another language.
export const speakAgain = () => $("viewer").open && enlarge(enlarged.cycle);

function showNeighbours() {
  $("older").disabled = !enlarged || !kept.some((one) => one < enlarged.cycle);
  $("newer").disabled = !enlarged || !kept.some((one) => one > enlarged.cycle);
}

export function marks(mark, side, { width, height }) {
  const group = drawing("g", { fill: "none", "stroke-width": width / 500, stroke: mark.good ? "#2fe37a" : "#ff8f3a" });
  const place = ([x, y]) => `${(x * width).toFixed(1)},${(y * height).toFixed(1)}`;
  for (const line of mark[side].features) group.append(drawing("polyline", { points: line.map(place).join(" ") }));
  const [origin, x, y] = mark[side].axes.map(place);
  for (const [name, end, at, colour] of [["x", x, mark[side].axes[1], "#ff5d52"], ["y", y, mark[side].axes[2], "#4fb3ff"]]) {
    group.append(drawing("polyline", { points: `${origin} ${end}`, stroke: colour }));
    const label = drawing("text", { x: at[0] * width + width / 150, y: at[1] * height + width / 80, fill: colour, stroke: "none", "font-size": width / 30 });
    label.textContent = name;
    group.append(label);
  }
  if (mark[side].tool.length) {
    const tool = mark[side].tool.map(place);
    group.append(drawing("polyline", { points: tool.join(" "), stroke: "#ffd34d", "stroke-dasharray": width / 100 }));
    const [cx, cy] = tool[1].split(",");
    group.append(drawing("circle", { cx, cy, r: width / 120, stroke: "#ffd34d" }));
  }
  return group;
}
