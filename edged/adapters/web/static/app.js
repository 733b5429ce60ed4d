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
    view.parentElement.hidden = !there;
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

function marks(mark, side, { width, height }) {
  const group = drawing("g", { fill: "none", "stroke-width": width / 500, stroke: mark.good ? "#2fe37a" : "#ff8f3a" });
  const place = ([x, y]) => `${(x * width).toFixed(1)},${(y * height).toFixed(1)}`;
  for (const circle of mark[side].circles) group.append(drawing("polyline", { points: circle.map(place).join(" ") }));
  const [origin, x, y] = mark[side].axes.map(place);
  for (const [name, end, at, colour] of [["x", x, mark[side].axes[1], "#ff5d52"], ["y", y, mark[side].axes[2], "#4fb3ff"]]) {
    group.append(drawing("polyline", { points: `${origin} ${end}`, stroke: colour }));
    const label = drawing("text", { x: at[0] * width + width / 150, y: at[1] * height + width / 80, fill: colour, stroke: "none", "font-size": width / 30 });
    label.textContent = name;
    group.append(label);
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
  const key = faults.map((fault) => `${fault.cycle} ${fault.times}`).join();
  if (key === shownFaults && $("faults").childElementCount) return;
  shownFaults = key;
  if (!faults.length) return $("faults").replaceChildren(element("li", { class: "muted" }, "none since the start"));
  $("faults").replaceChildren(...faults.map((fault) => {
    const picture = fault.has_picture ? element("img", { src: `/picture/${fault.cycle}/left`, alt: `left picture of cycle ${fault.cycle}`, loading: "lazy" }) : element("span", { class: "muted" }, "no picture");
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
  showTrends();
  showFacts(status.facts);
  showFaults(status.faults);
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
