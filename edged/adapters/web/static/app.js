"use strict";
// Shows what /events tells. No framework: the page must load from the cell PC alone, and last for years.

const POINTS = 600;
const SVG = "http://www.w3.org/2000/svg";
const $ = (id) => document.getElementById(id);
let points = [];
let shownCycle = -1;
let registersTimer = 0;

function element(tag, attributes = {}, ...children) {
  const node = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
  node.append(...children);
  return node;
}

function drawing(tag, attributes) {
  const node = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
  return node;
}

const fixed = (value, digits) => (value === null || value === undefined ? "–" : value.toFixed(digits));
const clock = (ns) => (ns ? new Date(ns / 1e6).toLocaleTimeString() : "–");
const words = (text) => text.toLowerCase().replaceAll("_", " ");

// --- head ---

function showHead(status) {
  $("cell").textContent = status.cell;
  document.title = `${status.cell}: ${status.result ? words(status.result.status) : "edged"}`;
  const { state, result } = status;
  let [text, kind] = ["starting", "idle"];
  if (state && state.error) [text, kind] = ["FAULT", "bad"];
  else if (result) [text, kind] = result.status === "OK" ? ["OK", "good"] : [words(result.status), "warn"];
  else if (state) [text, kind] = [words(state.state), "idle"];
  const badge = $("badge");
  if (badge.textContent !== text) badge.textContent = text;
  badge.className = `badge ${kind}`;
  const parts = [];
  if (state) parts.push(`job ${state.job_number} ${state.job}`);
  if (result) parts.push(`cycle ${result.cycle}`, clock(result.exposed_ns || result.published_ns));
  if (result && result.simulated) parts.push("simulated");
  if (state && state.error) parts.push(state.error);
  $("headline").textContent = parts.join(" · ");
}

// --- pictures ---

function showPictures({ picture, pictured_ns, state }) {
  // an old picture beside a fault would look like the present one
  const there = picture && !(state && state.error);
  $("nopicture").textContent = there ? "" : pictured_ns ? `no picture since ${clock(pictured_ns)}` : "no picture yet";
  $("nopicture").hidden = there;
  for (const side of ["left", "right"]) {
    const view = $(side);
    view.closest("figure").hidden = !there;
    if (!there) continue;
    view.setAttribute("viewBox", `0 0 ${picture.width} ${picture.height}`);
    let image = view.querySelector("image");
    if (!image) {
      image = drawing("image", { x: 0, y: 0 });
      view.append(image);
    }
    image.setAttribute("width", picture.width);
    image.setAttribute("height", picture.height);
    if (picture.cycle === shownCycle) continue;
    const loaded = new Image();
    loaded.onload = () => {
      image.setAttribute("href", loaded.src);
      view.querySelectorAll("g").forEach((old) => old.remove());
      picture.marks.forEach((mark) => view.append(marks(mark, side, picture)));
    };
    loaded.src = `/picture/${picture.cycle}/${side}`;
  }
  if (there) shownCycle = picture.cycle;
}

// --- last cycles, and any of them enlarged ---

const thumbnails = new Map();
let kept = [];
function showRecent(recent, faults) {
  kept = [...new Set([...recent, ...faults.filter((fault) => fault.has_picture)].map((one) => one.cycle))].sort((a, b) => a - b);
  for (const cycle of [...thumbnails.keys()]) if (!recent.some((one) => one.cycle === cycle)) thumbnails.delete(cycle);
  for (const one of recent) {
    if (thumbnails.has(one.cycle)) continue;
    const kind = one.status === "OK" ? "good" : one.status === "CAPTURE_FAULT" ? "bad" : "warn";
    thumbnails.set(one.cycle, element("li", {}, thumbnail(one), element("span", { class: `status ${kind}` }, words(one.status)), element("span", { class: "muted" }, clock(one.time_ns))));
  }
  $("recent").replaceChildren(...recent.map((one) => thumbnails.get(one.cycle)));
  showNeighbours();
}

function showNeighbours() {
  $("older").disabled = !enlarged || !kept.some((one) => one < enlarged.cycle);
  $("newer").disabled = !enlarged || !kept.some((one) => one > enlarged.cycle);
}

function thumbnail({ cycle }) {
  const button = element("button", { type: "button", class: "open", "aria-label": `enlarge the pictures of cycle ${cycle}` },
    element("img", { src: `/picture/${cycle}/left/small`, alt: "" }));
  button.addEventListener("click", () => enlarge(cycle));
  return button;
}

const MOST = 16;
let enlarged = null;
let view = { scale: 1, x: 0, y: 0 };

async function enlarge(cycle) {
  const answer = await fetch(`/cycle/${cycle}.json`);
  const shown = answer.ok ? await answer.json() : null;
  if (!shown && $("viewer").open) $("viewedwhy").textContent = `cycle ${cycle} is no longer in memory`;
  if (!shown) return;
  const { width, height } = shown.picture;
  if (!enlarged || enlarged.width !== width || enlarged.height !== height) view = { scale: 1, x: 0, y: 0 };
  enlarged = { cycle, width, height };
  $("viewed").textContent = `cycle ${cycle} · ${clock(shown.time_ns)} · ${words(shown.status)}`;
  $("viewedwhy").textContent = shown.text;
  for (const side of ["left", "right"]) {
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
  for (const side of ["left", "right"]) $(`large${side}`).setAttribute("viewBox", `${view.x * width} ${view.y * height} ${part * width} ${part * height}`);
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
for (const side of ["left", "right"]) $(side).parentElement.addEventListener("click", () => shownCycle >= 0 && enlarge(shownCycle));

function marks(mark, side, { width, height }) {
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

// --- result ---

const CONVENTIONS = {
  fixed_xyz: "FANUC W P R, Yaskawa", kuka_abc: "KUKA A B C", ur_rotation_vector: "UR rotation vector",
  staubli_xyz: "Stäubli rx ry rz", kawasaki_oat: "Kawasaki O A T", abb_zyx: "ABB OrientZYX",
};

function showResult({ result, why, angles, state }) {
  const place = $("reading");
  if (state && state.error) {
    const last = result && result.status !== "CAPTURE_FAULT" ? `before, cycle ${result.cycle} at ${clock(result.exposed_ns || result.published_ns)}: ${words(result.status)}` : "";
    return place.replaceChildren(element("p", {}, state.error), element("p", { class: "muted" }, last || "no result while the fault lasts"));
  }
  if (!result) return place.replaceChildren("nothing measured yet");
  const parts = [];
  for (const [number, target] of [...result.targets, ...result.rejected].entries()) {
    const pose = target.pose_robot || target;
    const table = element("table");
    table.append(element("thead", {}, row("th", ["", target.pose_robot ? "robot's frame" : "rig's frame", "1 σ"])));
    const body = element("tbody");
    ["X", "Y", "Z"].forEach((axis, i) => {
      const line = row("td", [axis, `${fixed(pose.position_mm[i], 3)} mm`, `${fixed(pose.sigma_mm[i], 4)} mm`]);
      line.children[1].classList.add("big", "number");
      body.append(line);
    });
    const turned = angles && angles.of[number];
    if (turned) {
      ["A", "B", "C"].forEach((axis, i) => body.append(row("td", [axis, `${fixed(turned.deg[i], 3)}°`, `${fixed(turned.sigma_deg[i], 4)}°`])));
    }
    for (const circle of target.circles.slice(0, 1))
      body.append(row("td", [`radius ${circle.name}`, `${fixed(circle.radius_mm, 3)} mm`, `${fixed(circle.sigma_radius_mm, 4)} mm`]));
    body.append(row("td", ["angle in image", `${fixed(target.match.angle_deg, 3)}°`, ""]));
    body.append(row("td", ["score", fixed(target.score, 3), ""]));
    body.append(row("td", ["row difference", `${fixed(target.epipolar_rms_px, 3)} px`, ""]));
    table.append(body);
    parts.push(table);
    if (target.reject.length) parts.push(element("p", {}, `not good: ${words(target.reject.join(", "))}`));
    if (turned) parts.push(element("p", { class: "muted" }, `A, B, C: ${CONVENTIONS[angles.convention] || angles.convention}`));
  }
  if (!parts.length) parts.push(element("p", {}, words(result.status)), ...why.map((text) => element("p", {}, text)));
  const total = result.timing_ms.total;
  const stages = Object.entries(result.timing_ms).filter(([name]) => name !== "total");
  parts.push(element("p", { class: "muted" }, `${fixed(total, 0)} ms: ${stages.map(([name, ms]) => `${name} ${fixed(ms, 0)}`).join(", ")}`));
  place.replaceChildren(...parts);
}

function row(tag, cells) {
  const line = element("tr");
  cells.forEach((text, i) => line.append(element(tag, i && tag === "td" ? { class: "number" } : {}, text)));
  return line;
}

// --- where the sigma comes from ---

const TERMS = {
  edges: ["edges", "#4c8fd6", "smaller with ", "light and focus", "/setup#/light"],
  calibration: ["calibration", "#c9821c", "smaller with ", "more views of the board", "/setup#/calibrate"],
  registration: ["registration", "#7d62c7", "smaller with ", "more touches, or poses", "/setup#/robot"],
  doubt: ["doubt", "#d0453a", "", "what contradicts the rig", "#contradiction"],
};
const FREE_DEG = 60;

function showBudget({ budget, result, state }) {
  const place = $("budget");
  place.hidden = !budget || !result || Boolean(state && state.error);
  if (place.hidden) return place.replaceChildren();
  const parts = [element("h3", {}, "Where the sigma comes from", element("span", { class: "muted" }, ` ${budget.frame}'s frame`)), bars(budget), shares(budget, "mm", "X Y Z", "µm", 1000)];
  const limit = budget.limit_mm;
  if (limit) parts.push(element("p", { class: "muted" }, `The job allows ${fixed(1000 * limit, 0)} µm for each of X, Y, Z, without the registration.`));
  if (budget.terms.doubt.mm.some((value) => value > 0))
    parts.push(element("p", { id: "contradiction", class: "doubt" }, "Doubt: the rows of both pictures do not meet, or all sizes are wrong alike. A camera was knocked, the part moved between both exposures, or it is another part."));
  const before = place.querySelector("details");
  const turned = element("details", before && before.open ? { open: "" } : {}, element("summary", {}, "the same of the rotation"), shares(budget, "deg", "about X,about Y,about Z", "°", 1));
  place.replaceChildren(...parts, turned);
}

// a part of a bar is as long as its share of the variance: the whole is the sigma
function bars({ sigma, terms, limit_mm: limit }) {
  const most = Math.max(...sigma.mm);
  const near = limit && limit < 5 * most;
  const whole = 1.05 * Math.max(most, near ? limit : 0);
  const list = element("div", { class: "bars" });
  ["X", "Y", "Z"].forEach((axis, i) => {
    const told = Object.keys(TERMS).map((name) => `${name} ${fixed(1000 * terms[name].mm[i], 1)}`).join(", ");
    const over = limit && sigma.mm[i] > limit ? ", beyond the limit" : "";
    const view = drawing("svg", { viewBox: "0 0 100 10", preserveAspectRatio: "none", role: "img", "aria-label": `${axis}: ${fixed(1000 * sigma.mm[i], 1)} µm${over}: ${told}` });
    let x = 0;
    for (const [name, [, colour]] of Object.entries(TERMS)) {
      const width = sigma.mm[i] > 0 ? (100 * terms[name].mm[i] ** 2) / sigma.mm[i] / whole : 0;
      view.append(drawing("rect", { x, y: 1, width, height: 8, fill: colour }));
      x += width;
    }
    if (near) view.append(drawing("path", { d: `M${(100 * limit) / whole} 0V10`, class: "limit" }));
    list.append(element("span", {}, axis), view, element("b", {}, `${fixed(1000 * sigma.mm[i], 1)} µm`));
  });
  if (limit && !near) list.append(element("span", {}), element("span", { class: "muted" }, `the limit is ${fixed(limit / most, 0)} times as long`), element("span", {}));
  return list;
}

function shares({ terms, free }, unit, axes, name, factor) {
  const may = document.querySelector('header a[href="/setup"]');
  const digits = unit === "mm" ? 1 : 4;
  const table = element("table", { class: "shares" }, element("thead", {}, row("th", [`1 σ, ${name}`, ...axes.split(unit === "mm" ? " " : ",")])));
  const body = element("tbody");
  for (const [key, [title, colour, how, remedy, link]] of Object.entries(TERMS)) {
    const values = terms[key][unit];
    const line = row("td", ["", ...values.map((value) => (unit === "deg" && free && value > FREE_DEG ? "free" : fixed(factor * value, digits)))]);
    const swatch = drawing("svg", { viewBox: "0 0 1 1", class: "swatch", "aria-hidden": "true" });
    swatch.append(drawing("rect", { width: 1, height: 1, fill: colour }));
    line.firstChild.append(swatch, title);
    const matters = unit === "mm" && values.some((value) => value > 0);
    if (matters) line.firstChild.append(element("span", { class: "remedy" }, how, may || link[0] === "#" ? element("a", { href: link }, remedy) : remedy));
    body.append(line);
  }
  table.append(body);
  return table;
}

// --- trends ---

const RATE = 20;
const okRate = (_, i) => {
  const some = points.slice(Math.max(0, i + 1 - RATE), i + 1);
  return (100 * some.filter((p) => p.status === "OK").length) / some.length;
};
const TRENDS = [
  { name: `OK, of ${RATE} cycles`, unit: "%", of: okRate, digits: 0, from: 0, to: 100 },
  { name: "largest sigma", unit: "mm", of: (p) => p.sigma_mm, digits: 4, from: 0 },
  { name: "drift: rows, mean", unit: "px", of: (p) => p.drift_px, digits: 3, from: 0 },
  { name: "row difference", unit: "px", of: (p) => p.epipolar_px, digits: 3, from: 0 },
  { name: "score", unit: "", of: (p) => p.score, digits: 4 },
  { name: "cycle time", unit: "ms", of: (p) => p.total_ms, digits: 0, from: 0 },
];

function showTrends() {
  $("span").textContent = points.length ? `last ${points.length} cycles since ${clock(points[0].time_ns)}` : "";
  $("trends").replaceChildren(...TRENDS.map(trend));
}

function trend({ name, unit, of, digits, from, to }) {
  const values = points.map(of).map((value) => (value === undefined || value === null ? null : value));
  const known = values.filter((value) => value !== null);
  const box = element("div", { class: "trend" }, element("span", {}, name));
  if (!known.length) {
    box.append(element("b", {}, "–"));
    return box;
  }
  let [low, high] = [Math.min(from ?? Infinity, ...known), Math.max(to ?? -Infinity, ...known)];
  if (high - low < 1e-9) [low, high] = [low - 0.5, high + 0.5];
  const last = values[values.length - 1];
  box.append(element("b", {}, last === null ? "–" : `${fixed(last, digits)} ${unit}`));
  const view = drawing("svg", { viewBox: "0 0 600 60", preserveAspectRatio: "none", role: "img",
    "aria-label": `${name}: ${fixed(last, digits)} ${unit}, between ${fixed(low, digits)} and ${fixed(high, digits)}` });
  const step = 600 / Math.max(values.length - 1, 1);
  let path = "";
  let pen = "M";
  values.forEach((value, i) => {
    if (value === null) { pen = "M"; return; }
    path += `${pen}${(i * step).toFixed(1)} ${(56 - (52 * (value - low)) / (high - low)).toFixed(1)}`;
    pen = "L";
  });
  view.append(drawing("path", { d: path, fill: "none", stroke: "currentColor", "stroke-width": 1.5, "vector-effect": "non-scaling-stroke" }));
  box.append(view, element("span", { class: "muted" }, `${fixed(low, digits)} … ${fixed(high, digits)} ${unit}`));
  return box;
}

// --- the rest ---

function showFacts(facts) {
  $("facts").replaceChildren(...Object.entries(facts).map(([group, values]) => {
    const list = element("dl");
    for (const [name, value] of Object.entries(values)) list.append(element("dt", {}, name), element("dd", {}, String(value)));
    return element("div", {}, element("h3", {}, group), list);
  }));
}

let shownFaults = "";
function showFaults(faults) {
  const key = faults.map((fault) => `${fault.cycle} ${fault.times} ${fault.text} ${fault.has_picture}`).join();
  if (key === shownFaults && $("faults").childElementCount) return;
  shownFaults = key;
  if (!faults.length) return $("faults").replaceChildren(element("li", { class: "muted" }, "none since the start"));
  $("faults").replaceChildren(...faults.map((fault) => {
    const picture = fault.has_picture ? thumbnail(fault) : element("span", { class: "muted" }, "no picture");
    return element("li", {}, picture, element("div", {}, element("b", {}, words(fault.status)), element("div", {}, fault.text),
      element("div", { class: "muted" }, `cycle ${fault.cycle}, ${clock(fault.time_ns)}${fault.times > 1 ? `; ${fault.times} times until ${clock(fault.last_ns)}` : ""}`)));
  }));
}

function showJobs(jobs, state) {
  $("jobs").replaceChildren(...jobs.map((job) => {
    const active = state && state.job_number === job.number;
    return element("li", active ? { "aria-current": "true" } : {}, active ? element("b", {}, `${job.number} ${job.name} (active)`) : `${job.number} ${job.name}`);
  }));
}

async function loadRegisters() {
  const answer = await fetch("/registers.json");
  if (!answer.ok) return;
  const wanted = $("find").value.trim().toLowerCase();
  const rows = (await answer.json()).filter((r) => !wanted || r.name.toLowerCase().includes(wanted) || String(r.address) === wanted);
  $("words").replaceChildren(...rows.map(registerRow));
}

function registerRow(r) {
  const value = element("td", { class: "value" }, r.text, r.meaning ? element("span", { class: "muted" }, ` ${r.meaning}`) : "");
  return element("tr", {}, element("td", {}, String(r.address)), element("td", {}, r.name), value, element("td", {}, r.unit), element("td", {}, r.help));
}

$("registers").addEventListener("toggle", () => {
  clearInterval(registersTimer);
  if ($("registers").open) {
    loadRegisters();
    registersTimer = setInterval(loadRegisters, 1000);
  }
});
$("find").addEventListener("input", loadRegisters);

// --- the connection ---

function show(status) {
  $("logout").hidden = !status.protected;
  showHead(status);
  showPictures(status);
  showResult(status);
  showBudget(status);
  showTrends();
  showFacts(status.facts);
  showFaults(status.faults);
  showRecent(status.recent, status.faults);
  showJobs(status.jobs, status.state);
}

function connect() {
  const source = new EventSource("/events");
  source.addEventListener("all", (event) => {
    const status = JSON.parse(event.data);
    points = status.points;
    shownCycle = -1;
    $("link").textContent = "live";
    show(status);
  });
  source.addEventListener("update", (event) => {
    const status = JSON.parse(event.data);
    const last = points.length ? points[points.length - 1].cycle : 0;
    points.push(...status.points.filter((point) => point.cycle > last));
    points.splice(0, points.length - POINTS);
    show(status);
  });
  source.onerror = () => {
    // what stands on the page is old from now on, and must look so
    $("badge").textContent = "no connection";
    $("badge").className = "badge bad";
    $("link").textContent = "reconnecting";
    if (source.readyState === EventSource.CLOSED) setTimeout(again, 3000);
  };
}


async function again() {
  const answer = await fetch("/status.json").catch(() => null);
  if (answer && answer.status === 401) location.assign("/login");
  else connect();
}

connect();
