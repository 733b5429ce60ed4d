// What the cell is and does now: facts and pictures over one WebSocket, and the lease of whoever sets it up.
import { batch, computed, effect, signal, useEffect } from "../vendor/ui.js";
import { ask, attempt, glance, logIn, Problem, trouble } from "./api.js";
import { forget, isAside } from "./drafting.js";

const KEPT = "edged.lease";
const LEASE_MS = 5000;
const LOGGED_OUT = 4401;
const AGAIN_MS = [250, 500, 1000, 2000, 4000];
export const SIDES = ["left", "right"];

export const me = signal(null);
export const cell = signal(null);
export const cameras = signal(null);
export const quality = signal(null);
export const draft = signal(null);
export const task = signal(null);
export const checked = signal(null);
export const isConnected = signal(false);
export const pictures = { left: signal(null), right: signal(null) };
export const liveState = signal({});
export const token = signal(localStorage.getItem(KEPT) ?? "");
export const liveViews = signal(0);

// Whether this cell has a route: a page without its routes is not entered.
const offered = new Set(document.getElementById("setup").dataset.offers.split(" "));
export const offers = (path) => offered.has(path);

export const holds = computed(() => Boolean(token.value && cell.value?.setup?.yours));
export const mayTake = computed(() => me.value?.role === "engineer");

// --- the lease ---

function keep(value) {
  if (value) localStorage.setItem(KEPT, value);
  else localStorage.removeItem(KEPT);
  token.value = value;
}

// The server knows the names of its users; who has none is called by the role.
const named = () => (me.value.name ? {} : { name: me.value.role });

export const take = (isTakenOver) =>
  attempt(async () => {
    const { token: given } = await ask("POST", "setup", { ...named(), ...(isTakenOver ? { take_over: true } : {}) });
    keep(given);
    await look();
  });

export const leave = () =>
  attempt(async () => {
    const held = token.value;
    keep("");
    await ask("DELETE", "setup", { token: held });
    await look();
  });

// Somebody at the cell has seen that nobody stands in it.
export const end = () =>
  attempt(async () => {
    await ask("DELETE", "setup", { name: me.value.name || me.value.role });
    await look();
  });

let isRenewing = false;
async function renew() {
  const held = token.value;
  if (!held || isRenewing) return;
  isRenewing = true;
  try {
    await ask("PUT", "setup/lease", { token: held });
  } catch (problem) {
    if (!(problem instanceof Problem)) throw problem;
    if (problem.status !== 409 && problem.status !== 403) return; // not reached: the cell waits for a minute
    adopt(); // another tab of this browser may have taken it
    if (token.value !== held) return;
    keep("");
    trouble.value = new Problem({ status: problem.status, code: "lease_lost", detail: problem.detail });
    glance(look); // whose it is now
  } finally {
    isRenewing = false;
  }
}

// All tabs of a browser have one lease.
const adopt = () => {
  token.value = localStorage.getItem(KEPT) ?? "";
};

// --- facts ---

export async function look() {
  cell.value = await ask("GET", "cell");
  await lookAtCheck();
}

// Of the calibration in use: another one makes the last check one of before.
export async function lookAtCheck() {
  if (offers("checks")) checked.value = await ask("GET", "checks");
}

// Only who has the cell also learns what the cameras are set to. A search takes a second: what was set meanwhile is newer.
let settings = 0;
async function search() {
  const before = settings;
  const found = await ask("GET", holds.value ? `cameras?token=${encodeURIComponent(token.value)}` : "cameras");
  cameras.value = before === settings ? found : { ...found, settings: cameras.value.settings };
}
export const lookAtCameras = () => glance(search);
export function keepSettings(side, read) {
  settings += 1;
  const { configured, settings: known } = cameras.value;
  const tried = { ...configured[side], tried: { ...configured[side].tried, ...read } };
  cameras.value = { ...cameras.value, configured: { ...configured, [side]: tried }, settings: { ...known, [side]: { ...known[side], ...read } } };
}

// --- the socket ---

let socket = null; // the newest: what an older one says is not heard
let retry = 0;
let failures = 0;
let opened = 0;
const waiting = new Map();

function open() {
  const made = new WebSocket(`${location.protocol.replace("http", "ws")}//${location.host}/api/v1/ws`);
  const ours = (work) => (event) => made === socket && work(event);
  socket = made;
  made.binaryType = "arraybuffer";
  made.onopen = ours(() => {
    failures = 0;
    isConnected.value = true;
    if (opened++) catchUp();
    tellLive();
  });
  made.onmessage = ours(({ data }) => (typeof data === "string" ? hear(JSON.parse(data)) : see(data)));
  made.onclose = ours(({ code }) => {
    if (code === LOGGED_OUT) logIn();
    isConnected.value = false;
    waiting.clear();
    retry = setTimeout(open, AGAIN_MS[Math.min(failures++, AGAIN_MS.length - 1)]);
  });
}

// What was told while nobody listened is told no more: it is asked for, by each page what it shows.
const missed = signal(0);
function catchUp() {
  missed.value += 1;
  glance(facts);
}
export const useFresh = (work, inputs = []) =>
  useEffect(() => {
    work();
  }, [missed.value, ...inputs]);

// A tab that slept may have a socket that nobody answers any more, and does not notice: it gets another.
const SLEPT_MS = 15_000;
let awake = Date.now();
function rouse() {
  if (document.visibilityState !== "visible") return;
  const slept = Date.now() - awake;
  awake = Date.now();
  if (slept > SLEPT_MS || !socket) listenAnew();
}
// A page that is left or frozen may come back from the browser's memory. Its socket does not: browsers cut it there, and say so as a fault.
function rest() {
  const old = socket;
  socket = null;
  clearTimeout(retry);
  isConnected.value = false;
  waiting.clear();
  old?.close();
}
function listenAnew() {
  const old = socket;
  clearTimeout(retry);
  failures = 0;
  open();
  old?.close();
  renew();
}

// What a page alone listens to: the newest message of a type, as "teaching"; null before the first.
const others = new Map();
export function told(type) {
  if (!others.has(type)) others.set(type, signal(null));
  return others.get(type);
}

// The answer to a request about what is also told: a message may overtake it, and is the newer one then. Null for what is discarded.
const discarded = new Set();
export async function newest(heard, request) {
  const before = heard.peek();
  const answer = await request;
  if (discarded.has(answer.id)) return null;
  const now = heard.peek();
  return now !== before && now?.id === answer.id && now.revision >= answer.revision ? now : answer;
}

function hear({ type, ...message }) {
  if (message.gone) discarded.add(message.id);
  if (type === "cell") {
    const isOther = message.rig?.id !== cell.value?.rig?.id;
    cell.value = message;
    if (token.value && !message.setup?.yours) renew(); // says at once that it is lost
    if (isOther) glance(lookAtCheck);
  } else if (type === "check") checked.value = message;
  else if (type === "draft") hearDraft(message);
  else if (type === "task") task.value = message;
  else if (type === "quality") quality.value = message;
  else if (type === "live") {
    const { width, height } = liveState.value;
    liveState.value = { width, height, ...message };
    // it ends when nobody has looked for a while: a tablet that slept looks again
    if (message.code === "unseen" && document.visibilityState === "visible") tellLive();
  } else told(type).value = message;
}

// What is told of the calibration that is shown; and another one, where the cell is at that and nobody here has put it aside.
function hearDraft(message) {
  const isShown = message.id === draft.peek()?.id;
  if (message.gone) {
    forget("calibrations", message.id);
    if (isShown) draft.value = null;
  } else if (isShown || (message.current && !message.active && !isAside("calibrations", message.id))) draft.value = message;
}

// Of a whole image of a camera, whatever the size of the picture that is shown.
export function rawSize(side) {
  const { width, height } = liveState.value.width ? liveState.value : (pictures[side].value ?? { width: 4, height: 3 });
  return { width, height };
}

// A number's picture of both sides, and only then the next: a slow tablet gets fewer, never late ones.
async function see(data) {
  const view = new DataView(data);
  const side = SIDES[view.getUint8(0)];
  const count = view.getBigUint64(1);
  const bitmap = await createImageBitmap(new Blob([new Uint8Array(data, 9)], { type: "image/jpeg" }));
  const pair = waiting.get(count) ?? {};
  pair[side] = bitmap;
  waiting.set(count, pair);
  if (!pair.left || !pair.right) return;
  for (const older of [...waiting.keys()]) if (older <= count) waiting.delete(older);
  const before = SIDES.map((one) => pictures[one].value);
  batch(() => {
    for (const one of SIDES) pictures[one].value = pair[one];
  });
  for (const old of before) old?.close();
  requestAnimationFrame(() => say({ seen: Number(count) }));
}

const say = (message) => socket?.readyState === WebSocket.OPEN && socket.send(JSON.stringify(message));

// Signs of a person, not of the page: without one for ten minutes an engineer may only look.
const SIGN_MS = 60_000;
let signed = -SIGN_MS;
export function sign() {
  if (performance.now() - signed < SIGN_MS) return;
  signed = performance.now();
  say({ active: true });
}
export const wake = (password) =>
  attempt(async () => {
    await ask("POST", "me/wake", { password });
    me.value = await ask("GET", "me");
  });
effect(() => {
  if (trouble.value?.code === "idle") ask("GET", "me").then((told) => (me.value = told), () => {});
});

const tellLive = () => say(liveViews.value > 0 && holds.value ? { live: true, token: token.value } : { live: false });

// Somebody may have discarded it meanwhile.
async function lookAtDraft(id) {
  const found = await ask("GET", `calibrations/${id}`).catch((problem) => {
    if (problem.status !== 404) throw problem;
    return null;
  });
  if (draft.peek()?.id === id) draft.value = found;
}

async function facts() {
  me.value = await ask("GET", "me");
  await look();
  if (draft.peek()) await lookAtDraft(draft.peek().id);
  if (offers("trials/still")) ask("GET", "trials/still").then(({ last }) => (told("still").value = last), () => {});
  if (offers("cameras") && cameras.peek()) await search();
}

export async function start() {
  await facts();
  if (token.value) await renew();
  open();
  if (offers("cameras")) search().catch(() => {}); // their page says what went wrong
  setInterval(() => {
    rouse();
    renew();
  }, LEASE_MS);
  for (const name of ["pointerdown", "keydown"]) addEventListener(name, sign, { passive: true });
  for (const name of ["visibilitychange", "resume"]) document.addEventListener(name, rouse);
  document.addEventListener("freeze", rest);
  addEventListener("pagehide", rest);
  addEventListener("pageshow", rouse);
  addEventListener("online", listenAnew);
  addEventListener("storage", adopt);
  addEventListener("visibilitychange", () => document.visibilityState === "visible" && tellLive());
  effect(() => {
    void liveViews.value;
    void holds.value;
    tellLive();
  });
}
