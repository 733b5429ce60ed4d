// The last result and its error budget.

import { dashed, number, t } from "../setup/shared/texts.js";
import { $, AXES, data, detail, drawing, element, muted, note, row } from "./dom.js";
import { causes, clock, fault, notGood, statusOf } from "./sentences.js";

const mm = (value, digits) => data(`${number(value, digits)} mm`);
const degrees = (value, digits) => `${number(value, digits)}°`;

export function showResult({ result, why, angles, state }) {
  const place = $("reading");
  if (state?.error) {
    const last =
      result && result.status !== "CAPTURE_FAULT"
        ? t("run-before", {
            cycle: String(result.cycle),
            time: clock(result.exposed_ns || result.published_ns),
            status: statusOf(result.status),
          })
        : "";
    return place.replaceChildren(
      element("p", {}, fault(state.error_code)),
      element("p", {}, detail(state.error)),
      note(last || t("run-no-result")),
    );
  }
  if (!result) return place.replaceChildren(t("run-nothing-yet"));
  const parts = [];
  for (const [order, target] of [...result.targets, ...result.rejected].entries()) {
    const pose = target.pose_robot || target;
    const table = element("table");
    table.append(
      element(
        "thead",
        {},
        row("th", [t("run-axis"), t(`run-frame-${target.pose_robot ? "robot" : "rig"}`), "1 σ"]),
      ),
    );
    const body = element("tbody");
    for (const [i, axis] of AXES.entries()) {
      const line = row("td", [axis, mm(pose.position_mm[i], 3), mm(pose.sigma_mm[i], 4)]);
      line.children[1].classList.add("big", "number");
      body.append(line);
    }
    const turned = angles?.of[order];
    if (turned) {
      for (const [i, axis] of ["A", "B", "C"].entries()) {
        body.append(row("td", [axis, degrees(turned.deg[i], 3), degrees(turned.sigma_deg[i], 4)]));
      }
    }
    for (const { name, radius_mm, sigma_radius_mm } of target.circles.slice(0, 1)) {
      body.append(row("td", [t("run-radius", { name }), mm(radius_mm, 3), mm(sigma_radius_mm, 4)]));
    }
    body.append(row("td", [t("run-angle"), degrees(target.match.angle_deg, 3), ""]));
    body.append(row("td", [t("run-score"), number(target.score, 3), ""]));
    body.append(row("td", [t("run-rows"), data(`${number(target.epipolar_rms_px, 3)} px`), ""]));
    table.append(body);
    parts.push(table);
    if (target.reject.length) parts.push(element("p", {}, notGood(target.reject)));
    const convention = turned && t(`run-convention-${dashed(angles.convention)}`);
    if (turned) parts.push(note(t("run-abc", { convention })));
  }
  if (!parts.length) parts.push(element("p", {}, statusOf(result.status)), ...causes(why));
  if (result.tray) parts.unshift(element("p", { class: "tray" }, pockets(result)));
  const { total, ...times } = result.timing_ms;
  const stages = Object.entries(times).map(([name, ms]) => `${t(`run-stage-${name}`)} ${number(ms)}`);
  place.replaceChildren(...parts, note(t("run-timing", { total: number(total), stages: stages.join(", ") })));
}

// Which pocket is next, and which are without a part.
function pockets({ tray, targets }) {
  const all = Array.from({ length: tray.pockets }, (_, i) => i + 1);
  const empty = all.filter((pocket) => !tray.taken.includes(pocket));
  return t("run-tray", {
    taken: String(tray.taken.length),
    pockets: String(tray.pockets),
    next: String(targets[0]?.pocket ?? "–"),
    empty: empty.join(", ") || "–",
  });
}

// --- error budget ---

const TERMS = {
  edges: ["#4c8fd6", "/setup#/light"],
  calibration: ["#c9821c", "/setup#/calibrate"],
  registration: ["#7d62c7", "/setup#/robot"],
  doubt: ["#d0453a", "#contradiction"],
  marks: ["#3f8f6b", "/setup#/light"],
};
const FREE_DEG = 60;

export function showBudget({ budget, result, state }) {
  const place = $("budget");
  place.hidden = !budget || !result || Boolean(state?.error);
  if (place.hidden) return place.replaceChildren();
  const parts = [
    element("h3", {}, t("run-budget"), " ", muted(t(`run-frame-${budget.frame}`))),
    bars(budget),
    shares(budget, "mm", AXES, "µm", 1000),
  ];
  const limit = budget.limit_mm;
  if (limit) parts.push(note(t("run-limit", { limit: number(1000 * limit) })));
  const isDoubtful = budget.terms.doubt.mm.some((value) => value > 0);
  if (isDoubtful) parts.push(element("p", { id: "contradiction", class: "doubt" }, t("run-doubt")));
  const before = place.querySelector("details");
  const turns = AXES.map((axis) => t("run-about", { axis }));
  const turned = element(
    "details",
    before?.open ? { open: "" } : {},
    element("summary", {}, t("run-rotation")),
    shares(budget, "deg", turns, "°", 1),
  );
  place.replaceChildren(...parts, turned);
}

// Reference marks are a term only where there are some.
function known(terms) {
  return Object.entries(TERMS).filter(([name]) => terms[name]);
}

// The length of a bar is the sigma; each term takes its share of the variance.
function bars({ sigma, terms, limit_mm: limit }) {
  const most = Math.max(...sigma.mm);
  const near = limit && limit < 5 * most;
  const whole = 1.05 * Math.max(most, near ? limit : 0);
  const list = element("div", { class: "bars" });
  for (const [i, axis] of AXES.entries()) {
    const total = number(1000 * sigma.mm[i], 1);
    const each = known(terms).map(
      ([name]) => `${t(`run-term-${name}`)} ${number(1000 * terms[name].mm[i], 1)}`,
    );
    const isOver = limit && sigma.mm[i] > limit;
    const label = t(isOver ? "run-bar-over" : "run-bar", { axis, sigma: total, terms: each.join(", ") });
    const view = drawing("svg", {
      viewBox: "0 0 100 10",
      preserveAspectRatio: "none",
      role: "img",
      "aria-label": label,
    });
    let x = 0;
    for (const [name, [colour]] of known(terms)) {
      const width = sigma.mm[i] > 0 ? (100 * terms[name].mm[i] ** 2) / sigma.mm[i] / whole : 0;
      view.append(drawing("rect", { x, y: 1, width, height: 8, fill: colour }));
      x += width;
    }
    if (near) view.append(drawing("path", { d: `M${(100 * limit) / whole} 0V10`, class: "limit" }));
    list.append(element("span", {}, axis), view, element("b", {}, data(`${total} µm`)));
  }
  if (limit && !near) {
    const far = muted(t("run-limit-far", { times: number(limit / most) }));
    list.append(element("span"), far, element("span"));
  }
  return list;
}

function shares({ terms, free }, unit, axes, name, factor) {
  const may = document.querySelector('.pages a[href="/setup"]');
  const digits = unit === "mm" ? 1 : 4;
  const table = element(
    "table",
    { class: "shares" },
    element("thead", {}, row("th", [data(`1 σ, ${name}`), ...axes])),
  );
  const body = element("tbody");
  for (const [key, [colour, link]] of known(terms)) {
    const values = terms[key][unit];
    const line = row("td", [
      "",
      ...values.map((value) =>
        unit === "deg" && free && value > FREE_DEG ? t("run-free") : number(factor * value, digits),
      ),
    ]);
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
  return element(
    "span",
    { class: "remedy" },
    ...(key === "doubt" ? [] : [t("run-smaller"), " "]),
    link ? element("a", { href: link }, remedy) : remedy,
  );
}
