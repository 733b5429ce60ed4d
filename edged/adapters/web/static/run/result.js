// The last result, and where its sigma comes from.
import { $, data, detail, drawing, element, row } from "./dom.js";
import { causes, clock, fault, notGood, statusOf } from "./sentences.js";
import { number, t } from "../setup/texts.js";

const mm = (value, digits) => data(`${number(value, digits)} mm`);

export function showResult({ result, why, angles, state }) {
  const place = $("reading");
  if (state && state.error) {
    const last = result && result.status !== "CAPTURE_FAULT" ? t("run-before", { cycle: String(result.cycle), time: clock(result.exposed_ns || result.published_ns), status: statusOf(result.status) }) : "";
    return place.replaceChildren(element("p", {}, fault(state.error_code)), element("p", {}, detail(state.error)), element("p", { class: "muted" }, last || t("run-no-result")));
  }
  if (!result) return place.replaceChildren(t("run-nothing-yet"));
  const parts = [];
  for (const [order, target] of [...result.targets, ...result.rejected].entries()) {
    const pose = target.pose_robot || target;
    const table = element("table");
    table.append(element("thead", {}, row("th", ["", t(`run-frame-${target.pose_robot ? "robot" : "rig"}`), "1 σ"])));
    const body = element("tbody");
    ["X", "Y", "Z"].forEach((axis, i) => {
      const line = row("td", [axis, mm(pose.position_mm[i], 3), mm(pose.sigma_mm[i], 4)]);
      line.children[1].classList.add("big", "number");
      body.append(line);
    });
    const turned = angles && angles.of[order];
    if (turned) {
      ["A", "B", "C"].forEach((axis, i) => body.append(row("td", [axis, `${number(turned.deg[i], 3)}°`, `${number(turned.sigma_deg[i], 4)}°`])));
    }
    for (const circle of target.circles.slice(0, 1))
      body.append(row("td", [t("run-radius", { name: circle.name }), mm(circle.radius_mm, 3), mm(circle.sigma_radius_mm, 4)]));
    body.append(row("td", [t("run-angle"), `${number(target.match.angle_deg, 3)}°`, ""]));
    body.append(row("td", [t("run-score"), number(target.score, 3), ""]));
    body.append(row("td", [t("run-rows"), data(`${number(target.epipolar_rms_px, 3)} px`), ""]));
    table.append(body);
    parts.push(table);
    if (target.reject.length) parts.push(element("p", {}, notGood(target.reject)));
    if (turned) parts.push(element("p", { class: "muted" }, t("run-abc", { convention: t(`run-convention-${angles.convention.replaceAll("_", "-")}`) })));
  }
  if (!parts.length) parts.push(element("p", {}, statusOf(result.status)), ...causes(why));
  const total = result.timing_ms.total;
  const stages = Object.entries(result.timing_ms).filter(([name]) => name !== "total");
  parts.push(element("p", { class: "muted" }, t("run-timing", { total: number(total), stages: stages.map(([name, ms]) => `${t(`run-stage-${name}`)} ${number(ms)}`).join(", ") })));
  place.replaceChildren(...parts);
}

// --- where the sigma comes from ---

const TERMS = {
  edges: ["#4c8fd6", "/setup#/light"],
  calibration: ["#c9821c", "/setup#/calibrate"],
  registration: ["#7d62c7", "/setup#/robot"],
  doubt: ["#d0453a", "#contradiction"],
};
const FREE_DEG = 60;

export function showBudget({ budget, result, state }) {
  const place = $("budget");
  place.hidden = !budget || !result || Boolean(state && state.error);
  if (place.hidden) return place.replaceChildren();
  const parts = [element("h3", {}, t("run-budget"), " ", element("span", { class: "muted" }, t(`run-frame-${budget.frame}`))), bars(budget), shares(budget, "mm", ["X", "Y", "Z"], "µm", 1000)];
  const limit = budget.limit_mm;
  if (limit) parts.push(element("p", { class: "muted" }, t("run-limit", { limit: number(1000 * limit) })));
  if (budget.terms.doubt.mm.some((value) => value > 0))
    parts.push(element("p", { id: "contradiction", class: "doubt" }, t("run-doubt")));
  const before = place.querySelector("details");
  const turned = element("details", before && before.open ? { open: "" } : {}, element("summary", {}, t("run-rotation")), shares(budget, "deg", ["X", "Y", "Z"].map((axis) => t("run-about", { axis })), "°", 1));
  place.replaceChildren(...parts, turned);
}

// a part of a bar is as long as its share of the variance: the whole is the sigma
function bars({ sigma, terms, limit_mm: limit }) {
  const most = Math.max(...sigma.mm);
  const near = limit && limit < 5 * most;
  const whole = 1.05 * Math.max(most, near ? limit : 0);
  const list = element("div", { class: "bars" });
  ["X", "Y", "Z"].forEach((axis, i) => {
    const told = Object.keys(TERMS).map((name) => `${t(`run-term-${name}`)} ${number(1000 * terms[name].mm[i], 1)}`).join(", ");
    const isOver = limit && sigma.mm[i] > limit;
    const label = t(isOver ? "run-bar-over" : "run-bar", { axis, sigma: number(1000 * sigma.mm[i], 1), terms: told });
    const view = drawing("svg", { viewBox: "0 0 100 10", preserveAspectRatio: "none", role: "img", "aria-label": label });
    let x = 0;
    for (const [name, [colour]] of Object.entries(TERMS)) {
      const width = sigma.mm[i] > 0 ? (100 * terms[name].mm[i] ** 2) / sigma.mm[i] / whole : 0;
      view.append(drawing("rect", { x, y: 1, width, height: 8, fill: colour }));
      x += width;
    }
    if (near) view.append(drawing("path", { d: `M${(100 * limit) / whole} 0V10`, class: "limit" }));
    list.append(element("span", {}, axis), view, element("b", {}, data(`${number(1000 * sigma.mm[i], 1)} µm`)));
  });
  if (limit && !near) list.append(element("span", {}), element("span", { class: "muted" }, t("run-limit-far", { times: number(limit / most) })), element("span", {}));
  return list;
}

function shares({ terms, free }, unit, axes, name, factor) {
  const may = document.querySelector('header a[href="/setup"]');
  const digits = unit === "mm" ? 1 : 4;
  const table = element("table", { class: "shares" }, element("thead", {}, row("th", [data(`1 σ, ${name}`), ...axes])));
  const body = element("tbody");
  for (const [key, [colour, link]] of Object.entries(TERMS)) {
    const values = terms[key][unit];
    const line = row("td", ["", ...values.map((value) => (unit === "deg" && free && value > FREE_DEG ? t("run-free") : number(factor * value, digits)))]);
    const swatch = drawing("svg", { viewBox: "0 0 1 1", class: "swatch", "aria-hidden": "true" });
    swatch.append(drawing("rect", { width: 1, height: 1, fill: colour }));
    line.firstChild.append(swatch, t(`run-term-${key}`));
    const matters = unit === "mm" && values.some((value) => value > 0);
    if (matters) line.firstChild.append(remedyOf(key, may || link[0] === "#" ? link : ""));
    body.append(line);
  }
  table.append(body);
  return table;
}

function remedyOf(key, link) {
  const remedy = t(`run-remedy-${key}`);
  return element("span", { class: "remedy" }, ...(key === "doubt" ? [] : [t("run-smaller"), " "]), link ? element("a", { href: link }, remedy) : remedy);
}
