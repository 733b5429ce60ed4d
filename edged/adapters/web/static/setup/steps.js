// The nine steps from unboxed cameras to a picked part; their ticks come from facts, never from clicks.
import { computed, html } from "../vendor/ui.js";
import {
  cameras,
  cell,
  checked,
  draft,
  hasObject,
  isConnected,
  offers,
  quality,
  SIDES,
  told,
} from "./shared/live.js";
import { Shape } from "./shared/pieces.js";
import { t } from "./shared/texts.js";

const MOST_FACTOR = 1.25;

function ofCameras() {
  if (!cameras.value) return "none";
  const { configured, found } = cameras.value;
  if (!SIDES.every((side) => configured[side].chosen)) return "open";
  const ours = found.filter(({ side }) => side);
  return ours.length < SIDES.length || ours.some(({ trouble }) => trouble) ? "doubt" : "tick";
}

function ofLight() {
  if (!quality.value || !hasObject.value) return "none";
  const isGood = ({ advice, sigma_z_factor }) =>
    advice.code === "good" && (sigma_z_factor ?? 1) <= MOST_FACTOR;
  return SIDES.every((side) => isGood(quality.value[side])) ? "tick" : "doubt";
}

function ofRig() {
  if (cell.value.missing.includes("rig")) return draft.value ? "doubt" : "open";
  return draft.value && !draft.value.active ? "doubt" : "tick";
}

// By the last check, if it is of the calibration in use.
function ofCheck() {
  if (!checked.value?.is_current || cell.value.missing.includes("rig")) return "none";
  return checked.value.last.verdict === "OK" ? "tick" : "doubt";
}

// By the last still test, if it is of the calibration in use: scatter within sigma, or below.
function ofTry() {
  const last = told("still").value;
  if (!last || last.calibration !== cell.value.rig?.id) return "none";
  return ["honest", "smaller"].includes(last.verdict) ? "tick" : "doubt";
}

const ofCell = () => (!isConnected.value ? "gap" : cell.value.error ? "doubt" : "tick");
const ofJobs = () => (cell.value.missing.includes("jobs") ? "open" : "tick");
const ROBOT = { yes: "tick", on_flange: "tick", no: "open" };
const ofRobot = () => ROBOT[cell.value.rig?.robot] ?? "none";
const ofPlc = () => (cell.value.plc.owner ? "tick" : "none");
const none = () => "none";
/**
 * topic: the folder of the page; needs: routes, one of which the cell must have; state: a shape of pieces.js,
 * or "open" where nothing was done yet; "gap" is for what is broken.
 * @typedef {{ id: string, topic: string, needs?: string[], state: () => string }} Step
 */
/** @type {Step[]} */
export const STEPS = [
  { id: "welcome", topic: "cell", state: ofCell },
  { id: "cameras", topic: "cell", needs: ["cameras"], state: ofCameras },
  { id: "light", topic: "cell", needs: ["cameras"], state: ofLight },
  { id: "calibrate", topic: "calibration", needs: ["calibrations"], state: ofRig },
  { id: "check", topic: "calibration", needs: ["checks"], state: ofCheck },
  { id: "teach", topic: "teaching", needs: ["teachings"], state: ofJobs },
  { id: "try", topic: "trials", needs: ["trials"], state: ofTry },
  { id: "robot", topic: "registration", needs: ["registrations"], state: ofRobot },
  { id: "plc", topic: "cell", needs: ["plc"], state: ofPlc },
];
// Pages beside the steps, in the head of every page.
/** @type {Step[]} */
export const BESIDE = [
  { id: "jobs", topic: "releases", needs: ["jobs"], state: none },
  { id: "cycles", topic: "recordings", needs: ["cycles"], state: none },
  { id: "marks", topic: "marking", needs: ["marks"], state: none },
  { id: "accept", topic: "acceptance", needs: ["acceptance"], state: none },
  { id: "space", topic: "cell", needs: ["scene"], state: none },
  { id: "settings", topic: "cell", needs: ["settings"], state: none },
  { id: "system", topic: "cell", needs: ["releases", "users"], state: none },
];
export const PAGES = [...STEPS, ...BESIDE];
/** @param {Step} step */
export const isBuilt = ({ needs }) => !needs || needs.some(offers);
export const next = computed(() =>
  cell.value
    ? STEPS.find((step) => isBuilt(step) && step.id !== "welcome" && step.state() !== "tick")
    : undefined,
);

export const State = ({ is }) => html`<span class="state ${is}">
  <${Shape} is=${is === "open" ? "none" : is} /><span class="unseen">${t(`state-${is}`)}</span>
</span>`;
