// The job on trial: its newest result and its map of predicted sigma.
import { computed, signal } from "../../vendor/ui.js";
import { ask, attempt, glance } from "../shared/api.js";
import { holds, token, told } from "../shared/live.js";

export const chosen = signal(""); // "job:NAME" or "teaching:ID"
export const map = signal(null);
export const mapTrouble = signal(null);
const pushed = told("trial");
const loaded = signal(null);
export const trial = computed(() => pushed.value ?? loaded.value);
export const isOn = computed(() => Boolean(trial.value?.on));

const wish = () => {
  const [kind, ...rest] = chosen.value.split(":");
  return { [kind]: rest.join(":") };
};

export const look = () =>
  glance(async () => {
    loaded.value = await ask("GET", "trials");
    pushed.value = null; // out of date
    const { on, teaching, job } = loaded.value;
    if (on) chosen.value = teaching ? `teaching:${teaching}` : `job:${job}`;
  });

export const run = (on) =>
  attempt(async () => {
    const state = await ask("PUT", "trials", { token: token.value, ...(on ? wish() : {}), on });
    pushed.value = null; // out of date
    loaded.value = state;
  });

// Leaving the page ends the trial.
export const rest = () => isOn.value && holds.value && run(false);

// isFirst: not a map that is refined once the light is known.
export async function findMap(isFirst = true) {
  if (isFirst) map.value = mapTrouble.value = null;
  const asked = chosen.value;
  if (!asked) return;
  const query = new URLSearchParams(wish()).toString();
  try {
    const found = await ask("GET", `trials/map?${query}`);
    if (asked === chosen.value) map.value = found;
  } catch (problem) {
    if (asked === chosen.value) mapTrouble.value = problem;
  }
}
