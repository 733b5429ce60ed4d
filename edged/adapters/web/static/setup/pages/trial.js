// What is tried: the newest result of each live pair, and the map of what is to be expected.
import { computed, signal } from "../../vendor/ui.js";
import { ask, attempt, glance } from "../api.js";
import { holds, told, token } from "../live.js";

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
    pushed.value = null; // of before
    const { on, teaching, job } = loaded.value;
    if (on) chosen.value = teaching ? `teaching:${teaching}` : `job:${job}`;
  });

export const run = (on) =>
  attempt(async () => {
    const state = await ask("PUT", "trials", { token: token.value, ...(on ? wish() : {}), on });
    pushed.value = null; // of before
    loaded.value = state;
  });

// What is not looked at is not tried: the page is left, the cell has better to do.
export const rest = () => isOn.value && holds.value && run(false);

// isFirst: not one that is made better because the light is known by now.
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
