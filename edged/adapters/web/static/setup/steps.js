// The way from unboxed cameras to a picked part: nine steps, whose ticks come from facts and never from clicks.
import { computed, html, signal } from "../vendor/ui.js";
import { Problem } from "./api.js";
import { cameras, cell, checked, draft, isConnected, offers, quality, SIDES, told } from "./live.js";
import { Shape } from "./pieces.js";
import { learn, t } from "./texts.js";

const MOST_FACTOR = 1.25;

function ofCameras() {
  if (!cameras.value) return "none";
  const { configured, found } = cameras.value;
  if (!SIDES.every((side) => configured?.[side])) return "gap";
  const ours = found.filter(({ side }) => side);
  return ours.length < SIDES.length || ours.some(({ trouble }) => trouble) ? "doubt" : "tick";
}

function ofLight() {
  if (!quality.value) return "none";
  const isGood = ({ advice, sigma_z_factor }) => advice.code === "good" && (sigma_z_factor ?? 1) <= MOST_FACTOR;
  return SIDES.every((side) => isGood(quality.value[side])) ? "tick" : "doubt";
}

function ofRig() {
  if (cell.value.missing.includes("rig")) return "gap";
  return draft.value && !draft.value.active ? "doubt" : "tick";
}

// Of the calibration in use alone, and only what a fresh pair has shown.
function ofCheck() {
  if (!checked.value?.is_current || cell.value.missing.includes("rig")) return "none";
  return checked.value.last.verdict === "OK" ? "tick" : "doubt";
}

// By the last still test, of the calibration in use: scatter within what sigma says, or below it.
function ofTry() {
  const last = told("still").value;
  if (!last || last.calibration !== cell.value.rig?.id) return "none";
  return ["honest", "smaller"].includes(last.verdict) ? "tick" : "doubt";
}

const ROBOT = { yes: "tick", on_flange: "tick", no: "gap" };
export const STEPS = [
  { id: "welcome", load: () => import("./pages/welcome.js"), state: () => (!isConnected.value ? "gap" : cell.value.error ? "doubt" : "tick") },
  { id: "cameras", load: () => import("./pages/cameras.js"), needs: ["cameras"], state: ofCameras },
  { id: "light", load: () => import("./pages/light.js"), needs: ["cameras"], state: ofLight },
  { id: "calibrate", load: () => import("./pages/calibrate.js"), needs: ["calibrations"], state: ofRig },
  { id: "check", load: () => import("./pages/check.js"), needs: ["checks"], state: ofCheck },
  { id: "teach", load: () => import("./pages/teach.js"), needs: ["teachings"], state: () => (cell.value.missing.includes("jobs") ? "gap" : "tick") },
  { id: "try", load: () => import("./pages/try.js"), needs: ["trials"], state: ofTry },
  { id: "robot", load: () => import("./pages/robot.js"), needs: ["registrations"], state: () => ROBOT[cell.value.rig?.robot] ?? "none" },
  { id: "plc", load: () => import("./pages/plc.js"), needs: ["plc"], state: () => (cell.value.plc.owner ? "tick" : "none") },
];
// Not steps: what runs, and what ran before; in the head of every page.
export const BESIDE = [
  { id: "jobs", load: () => import("./pages/jobs.js"), needs: ["jobs"], state: () => "none" },
  { id: "cycles", load: () => import("./pages/cycles.js"), needs: ["cycles"], state: () => "none" },
  { id: "system", load: () => import("./pages/system.js"), needs: ["releases", "users"], state: () => "none" },
];
export const PAGES = [...STEPS, ...BESIDE];
export const isBuilt = ({ load, needs }) => load && (!needs || needs.some(offers));
export const next = computed(() => (cell.value ? STEPS.filter(isBuilt).find(({ id, state }) => id !== "welcome" && state() !== "tick") : undefined));

export const State = ({ is }) => html`<span class="state ${is}"><${Shape} is=${is} /><span class="unseen">${t(`state-${is}`)}</span></span>`;

// A page comes with its texts when it is first entered: what is not looked at is not sent.
const come = signal({});
export const pageOf = ({ id }) => come.value[id];
export async function enter({ id, load }) {
  if (come.value[id]) return;
  let page;
  try {
    [{ default: page }] = await Promise.all([load(), learn(`setup/pages/${id}`)]);
  } catch {
    throw new Problem({ code: "page" });
  }
  come.value = { ...come.value, [id]: page };
}
