// The way from unboxed cameras to a picked part: nine steps, whose ticks come from facts and never from clicks.
import { computed, html } from "../vendor/ui.js";
import { Calibrate } from "./calibrate.js";
import { Cameras } from "./cameras.js";
import { Check } from "./check.js";
import { Light } from "./light.js";
import { cameras, cell, checked, draft, isConnected, offers, quality, SIDES } from "./live.js";
import { Shape } from "./pieces.js";
import { System } from "./system.js";
import { t } from "./texts.js";
import { Welcome } from "./welcome.js";

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

const ROBOT = { yes: "tick", on_flange: "tick", no: "gap" };
export const STEPS = [
  { id: "welcome", page: Welcome, state: () => (!isConnected.value ? "gap" : cell.value.error ? "doubt" : "tick") },
  { id: "cameras", page: Cameras, needs: ["cameras"], state: ofCameras },
  { id: "light", page: Light, needs: ["cameras"], state: ofLight },
  { id: "calibrate", page: Calibrate, needs: ["calibrations"], state: ofRig },
  { id: "check", page: Check, needs: ["checks"], state: ofCheck },
  { id: "teach", state: () => (cell.value.missing.includes("jobs") ? "gap" : "tick") },
  { id: "try", state: () => "none" },
  { id: "robot", state: () => ROBOT[cell.value.rig?.robot] ?? "none" },
  { id: "plc", state: () => (cell.value.plc.owner ? "tick" : "none") },
];
// Not a step: what runs, and what ran before.
export const PAGES = [...STEPS, { id: "system", page: System, needs: ["releases", "users"], state: () => "none" }];
export const isBuilt = ({ page, needs }) => page && (!needs || needs.some(offers));
export const next = computed(() => (cell.value ? STEPS.filter(isBuilt).find(({ id, state }) => id !== "welcome" && state() !== "tick") : undefined));

export const State = ({ is }) => html`<span class="state ${is}"><${Shape} is=${is} /><span class="unseen">${t(`state-${is}`)}</span></span>`;
