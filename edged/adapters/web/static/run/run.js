// Shows the events of /events. The page loads from the cell PC alone.

import { ask } from "../setup/shared/api.js";
import { fetched } from "../setup/shared/fetched.js";
import { choose, LANGUAGES, language, learn, preferred, speak, t } from "../setup/shared/texts.js";
import { $, data, drawing, element, muted, SIDES } from "./dom.js";
import { loadRegisters } from "./registers.js";
import { showBudget, showResult } from "./result.js";
import { causes, clock, fault, kindOf, nameOf, statusOf, told } from "./sentences.js";
import { showTrends } from "./trends.js";
import { enlarge, keep, marks, speakAgain } from "./viewer.js";

const POINTS = 600;
let points = [];
let newest = null; // the last status
let isLost = false; // the page shows an old status
let shownCycle = -1;

// --- head ---

function showHead(status) {
  $("cell").textContent = status.cell;
  document.title = `${status.cell}: ${status.result ? statusOf(status.result.status) : "edged"}`;
  const { state, result } = status;
  let [text, kind] = [t("run-starting"), "idle"];
  if (state?.error) [text, kind] = [t("run-fault"), "bad"];
  else if (result) [text, kind] = [statusOf(result.status), result.status === "OK" ? "good" : "warn"];
  else if (state) [text, kind] = [t(`state-${state.state.toLowerCase()}`), "idle"];
  const badge = $("badge");
  if (badge.textContent !== text) badge.textContent = text;
  badge.className = `badge ${kind}`;
  const parts = [];
  if (state) parts.push(t("run-job", { name: `${state.job_number} ${state.job}` }));
  if (result)
    parts.push(
      t("run-cycle", { cycle: String(result.cycle) }),
      clock(result.exposed_ns || result.published_ns),
    );
  if (result?.simulated) parts.push(t("run-simulated"));
  if (state?.error) parts.push(`${fault(state.error_code)} ${t("measures-again")}`);
  $("headline").textContent = parts.join(" · ");
}

// --- pictures ---

function showPictures({ picture, pictured_ns, state }) {
  // an old picture beside a fault would look current
  const there = picture && !state?.error;
  $("nopicture").textContent = there
    ? ""
    : pictured_ns
      ? t("run-no-picture-since", { time: clock(pictured_ns) })
      : t("run-no-picture-yet");
  $("nopicture").hidden = there;
  for (const side of SIDES) {
    const view = $(side);
    view.closest("figure").hidden = !there;
    if (!there) continue;
    view.setAttribute("viewBox", `0 0 ${picture.width} ${picture.height}`);
    if (!view.querySelector("image")) view.append(drawing("image", { x: 0, y: 0 }));
    const image = view.querySelector("image");
    image.setAttribute("width", picture.width);
    image.setAttribute("height", picture.height);
    if (picture.cycle === shownCycle) continue;
    const loaded = new Image();
    loaded.onload = () => {
      image.setAttribute("href", loaded.src);
      for (const old of view.querySelectorAll("g")) old.remove();
      view.append(...picture.marks.map((mark) => marks(mark, side, picture)));
    };
    loaded.src = `/picture/${picture.cycle}/${side}`;
  }
  if (there) shownCycle = picture.cycle;
}

// --- last cycles ---

const thumbnails = new Map();
function showRecent(recent, faults) {
  const pictured = [...recent, ...faults.filter(({ has_picture }) => has_picture)].map(({ cycle }) => cycle);
  keep([...new Set(pictured)].sort((a, b) => a - b));
  for (const cycle of [...thumbnails.keys()]) {
    if (!recent.some((kept) => kept.cycle === cycle)) thumbnails.delete(cycle);
  }
  for (const { cycle, status, time_ns } of recent) {
    if (thumbnails.has(cycle)) continue;
    const name = element("span", { class: `status ${kindOf(status)}` }, statusOf(status));
    const time = data(clock(time_ns), { class: "muted" });
    thumbnails.set(cycle, element("li", {}, thumbnail(cycle), name, time));
  }
  $("recent").replaceChildren(...recent.map(({ cycle }) => thumbnails.get(cycle)));
}

function thumbnail(cycle) {
  const button = element(
    "button",
    { type: "button", class: "open", "aria-label": t("run-enlarge-cycle", { cycle: String(cycle) }) },
    element("img", { src: `/picture/${cycle}/left/small`, alt: "" }),
  );
  button.addEventListener("click", () => enlarge(cycle));
  return button;
}
for (const side of SIDES)
  $(side).parentElement.addEventListener("click", () => shownCycle >= 0 && enlarge(shownCycle));

// --- the rest ---

function showFacts(facts) {
  $("facts").replaceChildren(
    ...Object.entries(facts).map(([group, values]) => {
      const list = element("dl");
      for (const [name, value] of Object.entries(values))
        list.append(element("dt", {}, nameOf(name)), element("dd", {}, ...told(value)));
      return element("div", {}, element("h3", {}, nameOf(group)), list);
    }),
  );
}

let shownFaults = "";
function showFaults(faults) {
  const key = JSON.stringify(faults);
  if (key === shownFaults && $("faults").childElementCount) return;
  shownFaults = key;
  if (!faults.length)
    return $("faults").replaceChildren(element("li", { class: "muted" }, t("run-no-faults")));
  $("faults").replaceChildren(...faults.map(faultItem));
}

function faultItem({ cycle, times, has_picture, time_ns, last_ns, status, why }) {
  const picture = has_picture ? thumbnail(cycle) : muted(t("run-no-picture"));
  const at = { cycle: String(cycle), time: clock(time_ns), times: String(times), last: clock(last_ns) };
  const seen = element("div", { class: "muted" }, t(times > 1 ? "run-seen-times" : "run-seen-at", at));
  return element(
    "li",
    {},
    picture,
    element("div", {}, element("b", {}, statusOf(status)), ...causes(why), seen),
  );
}

function showJobs(jobs, state) {
  $("jobs").replaceChildren(
    ...jobs.map(({ number, name }) => {
      const job = data(`${number} ${name}`);
      if (state?.job_number !== number) return element("li", {}, job);
      return element("li", { "aria-current": "true" }, element("b", {}, job, " ", t("run-active")));
    }),
  );
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

// Marks the page as out of date.
function showLoss() {
  $("badge").textContent = t("run-no-connection");
  $("badge").className = "badge bad";
  $("link").textContent = t("run-reconnecting");
}

let source = null; // null while the page is hidden
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

// A page restored from the browser's back/forward cache has lost its connection.
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
  else if (source) connect(); // still open
}

// --- language ---

const hasUsers = Boolean(document.querySelector('.pages a[href="/setup"]'));

function speakThePage() {
  for (const node of document.querySelectorAll("[data-text]")) {
    node.textContent = t(node.getAttribute("data-text"));
  }
  for (const node of document.querySelectorAll("[data-label]")) {
    node.setAttribute("aria-label", t(node.getAttribute("data-label")));
  }
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

const whoLooks = async () => (hasUsers && (await fetched("/api/v1/me"))) || {};

$("language").append(
  ...Object.entries(LANGUAGES).map(([tag, name]) =>
    element("option", { value: tag, lang: tag, translate: "no" }, name),
  ),
);
$("language").addEventListener("change", async () => {
  await choose($("language").value);
  speakAnew();
  // also kept with the user
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
