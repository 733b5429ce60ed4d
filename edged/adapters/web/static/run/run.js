// Shows what /events tells. The page must load from the cell PC alone, and last for years.
import { $, data, drawing, element, SIDES } from "./dom.js";
import { loadRegisters } from "./registers.js";
import { showBudget, showResult } from "./result.js";
import { causes, clock, fault, kindOf, nameOf, statusOf, told } from "./sentences.js";
import { showTrends } from "./trends.js";
import { enlarge, keep, marks, speakAgain } from "./viewer.js";
import { ask } from "../setup/api.js";
import { choose, language, LANGUAGES, learn, preferred, speak, t } from "../setup/texts.js";

const POINTS = 600;
let points = [];
let newest = null; // what was told last
let isLost = false; // what stands there is old
let shownCycle = -1;

// --- head ---

function showHead(status) {
  $("cell").textContent = status.cell;
  document.title = `${status.cell}: ${status.result ? statusOf(status.result.status) : "edged"}`;
  const { state, result } = status;
  let [text, kind] = [t("run-starting"), "idle"];
  if (state && state.error) [text, kind] = [t("run-fault"), "bad"];
  else if (result) [text, kind] = [statusOf(result.status), result.status === "OK" ? "good" : "warn"];
  else if (state) [text, kind] = [t(`state-${state.state.toLowerCase()}`), "idle"];
  const badge = $("badge");
  if (badge.textContent !== text) badge.textContent = text;
  badge.className = `badge ${kind}`;
  const parts = [];
  if (state) parts.push(t("run-job", { name: `${state.job_number} ${state.job}` }));
  if (result) parts.push(t("run-cycle", { cycle: String(result.cycle) }), clock(result.exposed_ns || result.published_ns));
  if (result && result.simulated) parts.push(t("run-simulated"));
  if (state && state.error) parts.push(fault(state.error_code));
  $("headline").textContent = parts.join(" · ");
}

// --- pictures ---

function showPictures({ picture, pictured_ns, state }) {
  // an old picture beside a fault would look like the present one
  const there = picture && !(state && state.error);
  $("nopicture").textContent = there ? "" : pictured_ns ? t("run-no-picture-since", { time: clock(pictured_ns) }) : t("run-no-picture-yet");
  $("nopicture").hidden = there;
  for (const side of SIDES) {
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
function showRecent(recent, faults) {
  keep([...new Set([...recent, ...faults.filter((fault) => fault.has_picture)].map((one) => one.cycle))].sort((a, b) => a - b));
  for (const cycle of [...thumbnails.keys()]) if (!recent.some((one) => one.cycle === cycle)) thumbnails.delete(cycle);
  for (const one of recent) {
    if (thumbnails.has(one.cycle)) continue;
    thumbnails.set(one.cycle, element("li", {}, thumbnail(one), element("span", { class: `status ${kindOf(one.status)}` }, statusOf(one.status)), data(clock(one.time_ns), { class: "muted" })));
  }
  $("recent").replaceChildren(...recent.map((one) => thumbnails.get(one.cycle)));
}

function thumbnail({ cycle }) {
  const button = element("button", { type: "button", class: "open", "aria-label": t("run-enlarge-cycle", { cycle: String(cycle) }) },
    element("img", { src: `/picture/${cycle}/left/small`, alt: "" }));
  button.addEventListener("click", () => enlarge(cycle));
  return button;
}
for (const side of SIDES) $(side).parentElement.addEventListener("click", () => shownCycle >= 0 && enlarge(shownCycle));

// --- the rest ---

function showFacts(facts) {
  $("facts").replaceChildren(...Object.entries(facts).map(([group, values]) => {
    const list = element("dl");
    for (const [name, value] of Object.entries(values)) list.append(element("dt", {}, nameOf(name)), element("dd", {}, ...told(value)));
    return element("div", {}, element("h3", {}, nameOf(group)), list);
  }));
}

let shownFaults = "";
function showFaults(faults) {
  const key = faults.map((one) => `${one.cycle} ${one.times} ${one.why.map(({ text }) => text)} ${one.has_picture}`).join();
  if (key === shownFaults && $("faults").childElementCount) return;
  shownFaults = key;
  if (!faults.length) return $("faults").replaceChildren(element("li", { class: "muted" }, t("run-no-faults")));
  $("faults").replaceChildren(...faults.map((one) => {
    const picture = one.has_picture ? thumbnail(one) : element("span", { class: "muted" }, t("run-no-picture"));
    const at = { cycle: String(one.cycle), time: clock(one.time_ns), times: String(one.times), last: clock(one.last_ns) };
    return element("li", {}, picture, element("div", {}, element("b", {}, statusOf(one.status)), ...causes(one.why),
      element("div", { class: "muted" }, t(one.times > 1 ? "run-seen-times" : "run-seen-at", at))));
  }));
}

function showJobs(jobs, state) {
  $("jobs").replaceChildren(...jobs.map((job) => {
    const active = state && state.job_number === job.number;
    return element("li", active ? { "aria-current": "true" } : {}, active ? element("b", {}, data(`${job.number} ${job.name}`), " ", t("run-active")) : data(`${job.number} ${job.name}`));
  }));
}

// --- the connection ---

function show(status) {
  newest = status;
  $("link").textContent = t("run-live");
  $("logout").hidden = !status.protected;
  showHead(status);
  showPictures(status);
  showResult(status);
  showBudget(status);
  showTrends(points);
  showFacts(status.facts);
  showFaults(status.faults);
  showRecent(status.recent, status.faults);
  showJobs(status.jobs, status.state);
}

// What stands on the page is old from now on, and must look so.
function showLoss() {
  $("badge").textContent = t("run-no-connection");
  $("badge").className = "badge bad";
  $("link").textContent = t("run-reconnecting");
}

let source = null; // none while the page is not looked at
let retry = 0;

function connect() {
  source = new EventSource("/events");
  source.addEventListener("all", (event) => {
    const status = JSON.parse(event.data);
    points = status.points;
    shownCycle = -1;
    isLost = false;
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
    isLost = true;
    showLoss();
    if (source.readyState === EventSource.CLOSED) retry = setTimeout(again, 3000);
  };
}

// A page that is left or frozen may come back from the browser's memory, where no connection lasts.
function rest() {
  clearTimeout(retry);
  source?.close();
  source = null;
  isLost = true;
  showLoss();
}
const rouse = () => source || connect();

async function again() {
  const answer = await fetch("/status.json").catch(() => null);
  if (answer && answer.status === 401) location.assign("/login");
  else if (source) connect(); // not left meanwhile
}

// --- its language: as on the pages that set the cell up ---

const hasUsers = Boolean(document.querySelector('header a[href="/setup"]'));

function speakThePage() {
  for (const node of document.querySelectorAll("[data-text]")) node.textContent = t(node.dataset.text);
  for (const node of document.querySelectorAll("[data-label]")) node.setAttribute("aria-label", t(node.dataset.label));
  $("find").placeholder = t("run-find-what");
  $("language").value = language.value;
  if (newest) return;
  $("badge").textContent = t("run-connecting");
  $("nopicture").textContent = t("run-no-picture-yet");
}

function speakAnew() {
  speakThePage();
  thumbnails.clear();
  shownFaults = "";
  if ($("registers").open) loadRegisters();
  speakAgain();
  if (newest) show(newest);
  if (isLost) showLoss();
}

async function whoLooks() {
  const answer = hasUsers && (await fetch("/api/v1/me").catch(() => null));
  return answer && answer.ok ? answer.json() : {};
}

$("language").append(...Object.entries(LANGUAGES).map(([tag, name]) => element("option", { value: tag, lang: tag, translate: "no" }, name)));
$("language").addEventListener("change", async () => {
  await choose($("language").value);
  speakAnew();
  // with the user, too: it is spoken wherever they log in
  if ((await whoLooks()).name) await ask("PUT", "me", { language: language.value }).catch(() => {});
});

await speak(preferred());
await learn("run/run");
speakThePage();
connect();
addEventListener("pagehide", rest);
addEventListener("pageshow", rouse);
document.addEventListener("freeze", rest);
document.addEventListener("resume", rouse);
const theirs = preferred((await whoLooks()).language);
if (theirs !== language.value) {
  await speak(theirs);
  speakAnew();
}
