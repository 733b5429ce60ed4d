// The state of the cell and the live pictures, over one WebSocket, and the lease of the cell.
import { batch, computed, effect, signal, useEffect } from "../../vendor/ui.js";
import { ask, attempt, glance, logIn, Problem, trouble, troubled } from "./api.js";
import { forget, isAside } from "./drafts.js";

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
/** @typedef {{ on?: boolean, code?: string, detail?: string, width?: number, height?: number }} LiveState */
export const liveState = signal(/** @type {LiveState} */ ({}));
export const token = signal(localStorage.getItem(KEPT) ?? "");
export const liveViews = signal(0);

// Whether somebody said that a board or a part is before the cameras: an empty scene has texture, too, and
// light and focus cannot be judged by that.
const OBJECT = "edged.object";
export const hasObject = signal(sessionStorage.getItem(OBJECT) === "yes");
export function sayObject(isThere) {
  sessionStorage.setItem(OBJECT, isThere ? "yes" : "no");
  hasObject.value = isThere;
}

// Whether this cell has a route; a page without its routes is not opened.
const offered = new Set(document.getElementById("setup").dataset.offers.split(" "));
export const offers = (path) => offered.has(path);
export const hasManual = "manual" in document.getElementById("setup").dataset;

export const holds = computed(() => Boolean(token.value && cell.value?.setup?.yours));
export const mayTake = computed(() => me.value?.role === "engineer");

// --- the lease ---

function keep(value) {
  if (value) localStorage.setItem(KEPT, value);
  else localStorage.removeItem(KEPT);
  token.value = value;
}

// The server knows the names of its users; anyone else goes by the role.
const named = () => (me.value.name ? {} : { name: me.value.role });

export const take = (isTakenOver) =>
  attempt(async () => {
    const { token: given } = await ask("POST", "setup", {
      ...named(),
      ...(isTakenOver ? { take_over: true } : {}),
    });
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

// Ends a lease that nobody holds, after a look into the cell.
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
    if (problem.status !== 409 && problem.status !== 403) return; // unreachable: the lease lasts for a minute
    adopt(); // another tab may have taken the cell
    if (token.value !== held) return;
    keep("");
    troubled.value = null;
    trouble.value = new Problem({ status: problem.status, code: "lease_lost", detail: problem.detail });
    glance(look); // who has it now
  } finally {
    isRenewing = false;
  }
}

// All tabs of a browser share one lease.
const adopt = () => {
  token.value = localStorage.getItem(KEPT) ?? "";
};

// --- facts ---

export async function look() {
  cell.value = await ask("GET", "cell");
  await lookAtCheck();
}

// The last check, which belongs to one calibration.
export async function lookAtCheck() {
  if (offers("checks")) checked.value = await ask("GET", "checks");
}

// Settings come only with a lease, from cameras that are chosen and answer: which there are is seen without.
// A search takes a second: settings changed meanwhile are newer than its answer.
const UNREAD = { settings: null, limits: null };
let settings = 0;
async function search() {
  const before = settings;
  const [found, read] = await Promise.all([
    ask("GET", "cameras"),
    holds.value ? ask("POST", "cameras/settings", { token: token.value }).catch(() => UNREAD) : UNREAD,
  ]);
  cameras.value = { ...found, ...read, ...(before === settings ? {} : { settings: cameras.value.settings }) };
}
export const lookAtCameras = () => (mayTake.value ? glance(search) : undefined);
export function keepSettings(side, read) {
  settings += 1;
  const { configured, settings: known } = cameras.value;
  const tried = { ...configured[side], tried: { ...configured[side].tried, ...read } };
  cameras.value = {
    ...cameras.value,
    configured: { ...configured, [side]: tried },
    settings: { ...known, [side]: { ...known[side], ...read } },
  };
}

// --- the socket ---

let socket = null; // the newest; messages of older ones are ignored
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

// Messages missed while disconnected are not repeated: each page asks again for what it shows.
const missed = signal(0);
function catchUp() {
  missed.value += 1;
  glance(facts);
}
export const useFresh = (work, inputs = []) =>
  useEffect(() => {
    work();
  }, [missed.value, ...inputs]);

// The state of a task, pushed by the cell and also asked for, in case a message was missed.
const TASK_MS = 1000;
export function useTask(id, onEnd) {
  const state = id && task.value?.id === id ? task.value : null;
  useEffect(() => {
    if (!id) return undefined;
    const find = async () => {
      const found = await glance(() => ask("GET", `tasks/${id}`));
      if (found) task.value = found;
    };
    find();
    const timer = setInterval(find, TASK_MS);
    return () => clearInterval(timer);
  }, [id]);
  useEffect(() => {
    if (state && state.state !== "running") onEnd(state);
  }, [state?.state]);
  return state;
}

// A tab that slept may hold a dead socket without noticing: it gets a new one.
const SLEPT_MS = 15_000;
let awake = Date.now();
function rouse() {
  if (document.visibilityState !== "visible") return;
  const slept = Date.now() - awake;
  awake = Date.now();
  if (slept > SLEPT_MS || !socket) listenAnew();
}
// A page may be restored from the back/forward cache, its socket not; browsers report an open one as an
// error.
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

// The newest message of a type that only one page needs, such as "teaching"; null before the first.
const others = new Map();
export function told(type) {
  if (!others.has(type)) others.set(type, signal(null));
  return others.get(type);
}

// The answer to a request, or the message about the same thing if it came first and is newer.
// Null for a discarded thing.
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
    if (token.value && !message.setup?.yours) renew(); // reports the loss at once
    if (isOther) glance(lookAtCheck);
  } else if (type === "check") checked.value = message;
  else if (type === "draft") hearDraft(message);
  else if (type === "task") task.value = message;
  else if (type === "quality") quality.value = message;
  else if (type === "live") {
    const { width, height } = liveState.value;
    liveState.value = { width, height, ...message };
    // live pictures stop when nobody looks; a tablet that slept asks again
    if (message.code === "unseen" && document.visibilityState === "visible") tellLive();
  } else told(type).value = message;
}

// Takes the calibration shown here, or the cell's current one unless it was put aside here.
function hearDraft(message) {
  const isShown = message.id === draft.peek()?.id;
  if (message.gone) {
    forget("calibrations", message.id);
    if (isShown) draft.value = null;
  } else if (isShown || (message.current && !message.active && !isAside("calibrations", message.id)))
    draft.value = message;
}

// The size of a camera's whole image, whatever the size of the picture shown.
export function rawSize(side) {
  const { width, height } = liveState.value.width
    ? liveState.value
    : (pictures[side].value ?? { width: 4, height: 3 });
  return { width, height };
}

// Shows a pair once both pictures are there and then asks for the next: a slow tablet gets fewer, never late
// ones.
async function see(data) {
  const view = new DataView(data);
  const side = SIDES[view.getUint8(0)];
  const count = view.getBigUint64(1);
  const bitmap = await createImageBitmap(new Blob([new Uint8Array(data, 9)], { type: "image/jpeg" }));
  if (isOver()) return bitmap.close();
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

// Whoever watches sees pictures while they come: the last one would look like the present.
const isOver = () => !holds.value && (!cell.value?.setup?.name || liveState.value.on === false);
function forgetPictures() {
  waiting.clear();
  for (const side of SIDES) {
    pictures[side].peek()?.close();
    pictures[side].value = null;
  }
}

const say = (message) => socket?.readyState === WebSocket.OPEN && socket.send(JSON.stringify(message));

// Reports activity of the person: after ten minutes without, an engineer may only look.
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
    return true;
  });
effect(() => {
  if (trouble.value?.code === "idle")
    ask("GET", "me").then(
      (known) => (me.value = known),
      () => {},
    );
});

const tellLive = () =>
  say(liveViews.value > 0 && holds.value ? { live: true, token: token.value } : { live: false });

// The draft may have been discarded meanwhile.
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
  if (offers("trials/still"))
    ask("GET", "trials/still").then(
      ({ last }) => (told("still").value = last),
      () => {},
    );
  if (offers("cameras") && cameras.peek() && mayTake.peek()) await search();
}

export async function start() {
  await facts();
  if (token.value) await renew();
  open();
  if (offers("cameras") && mayTake.value) search().catch(() => {}); // the cameras' page reports errors
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
  effect(() => {
    if (isOver()) batch(forgetPictures);
  });
}
