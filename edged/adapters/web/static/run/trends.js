// Trends over the last cycles.

import { number, t } from "../setup/shared/texts.js";
import { $, data, drawing, element } from "./dom.js";
import { clock } from "./sentences.js";

const RATE = 20;
const okRate = (points) => (_, i) => {
  const some = points.slice(Math.max(0, i + 1 - RATE), i + 1);
  return (100 * some.filter((p) => p.status === "OK").length) / some.length;
};
/**
 * of: given all points, the value of one; from, to: the least range of the scale.
 * @typedef {{ id: string, unit: string, digits: number, from?: number, to?: number,
 *   of: (points: any[]) => (point: any, i: number) => number }} Trend
 */
/** @type {Trend[]} */
const TRENDS = [
  { id: "ok", unit: "%", of: okRate, digits: 0, from: 0, to: 100 },
  { id: "sigma", unit: "mm", of: () => (p) => p.sigma_mm, digits: 4, from: 0 },
  { id: "drift", unit: "px", of: () => (p) => p.drift_px, digits: 3, from: 0 },
  { id: "rows", unit: "px", of: () => (p) => p.epipolar_px, digits: 3, from: 0 },
  { id: "score", unit: "", of: () => (p) => p.score, digits: 4 },
  { id: "time", unit: "ms", of: () => (p) => p.total_ms, digits: 0, from: 0 },
];

export function showTrends(points) {
  $("span").textContent = points.length
    ? t("run-span", { count: String(points.length), time: clock(points[0].time_ns) })
    : "";
  $("trends").replaceChildren(...TRENDS.map((kind) => trend(points, kind)));
}

/** @param {Trend} kind */
function trend(points, kind) {
  const { id, unit, of, digits, from, to } = kind;
  const name = t(`run-trend-${id}`, { count: String(RATE) });
  const values = points
    .map(of(points))
    .map((value) => (value === undefined || value === null ? null : value));
  const known = values.filter((value) => value !== null);
  const box = element("div", { class: "trend" }, element("span", {}, name));
  if (!known.length) {
    box.append(element("b", {}, "–"));
    return box;
  }
  let [low, high] = [Math.min(from ?? Infinity, ...known), Math.max(to ?? -Infinity, ...known)];
  if (high - low < 1e-9) [low, high] = [low - 0.5, high + 0.5];
  const last = values[values.length - 1];
  box.append(element("b", {}, last === null ? "–" : data(`${number(last, digits)} ${unit}`)));
  const view = drawing("svg", {
    viewBox: "0 0 600 60",
    preserveAspectRatio: "none",
    role: "img",
    "aria-label": t("run-trend", {
      name,
      unit,
      last: number(last, digits),
      low: number(low, digits),
      high: number(high, digits),
    }),
  });
  const step = 600 / Math.max(values.length - 1, 1);
  let path = "";
  let pen = "M";
  values.forEach((value, i) => {
    if (value === null) {
      pen = "M";
      return;
    }
    path += `${pen}${(i * step).toFixed(1)} ${(56 - (52 * (value - low)) / (high - low)).toFixed(1)}`;
    pen = "L";
  });
  view.append(
    drawing("path", {
      d: path,
      fill: "none",
      stroke: "currentColor",
      "stroke-width": 1.5,
      "vector-effect": "non-scaling-stroke",
    }),
  );
  box.append(view, data(`${number(low, digits)} … ${number(high, digits)} ${unit}`, { class: "muted" }));
  return box;
}
