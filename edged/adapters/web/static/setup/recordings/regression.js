// Starting a regression: a new job, rig or release tried on all recorded cycles.
import { signal } from "../../vendor/ui.js";
import { ask, attempt } from "../shared/api.js";
import { say } from "../shared/pieces.js";
import { learn, t } from "../shared/texts.js";

export const running = signal(null); // {task, regression}
export const result = signal(null);

export async function startRegression(body) {
  const begun = await attempt(() => ask("POST", "regressions", body));
  if (!begun) return;
  running.value = begun;
  result.value = null;
  await learn("setup/recordings/cycles");
  say(t("cycles-test-begun"));
  document.getElementById("regressions")?.scrollIntoView({ block: "start" });
}
