// The recorded cycle that is open, and the words for results and reasons.
import { html, signal } from "../../vendor/ui.js";
import { ask, attempt } from "../shared/api.js";
import { Shape, say } from "../shared/pieces.js";
import { dashed, t } from "../shared/texts.js";

export const SHAPES = { OK: "tick", NO_TARGET: "none", LOW_QUALITY: "doubt", CAPTURE_FAULT: "gap" };
export const REASONS = [
  "SIGMA_LIMIT",
  "RESIDUAL",
  "FEW_EDGES",
  "LEFT_RIGHT_MISMATCH",
  "OUT_OF_VOLUME",
  "TOLERANCE",
  "AMBIGUOUS_ROTATION",
  "AMBIGUOUS_EDGE",
  "CALIBRATION",
  "OUT_OF_LIMITS",
  "KEEP_OUT",
  "NO_GRASP",
  "OUT_OF_MAP",
  "BLUR",
  "NO_COUNT",
  "NOT_FOUND",
  "CAPTURE",
];
const KEPT = "edged.cycle";

export const part = signal(0); // index of the part
export const shown = signal(null); // the open document

export const statusOf = (status) => html`<span class="status ${dashed(status)}">
  <${Shape} is=${SHAPES[status] ?? "none"} /> ${t(`cycles-status-${dashed(status)}`)}
</span>`;
export const reasonsOf = (reasons) => reasons.map((one) => t(`cycles-reason-${dashed(one)}`)).join(", ");

export async function open(count) {
  const document = await attempt(() => ask("GET", `cycles/${count}`));
  if (!document) return;
  sessionStorage.setItem(KEPT, count);
  part.value = 0;
  shown.value = document;
  say(t("cycles-open-said", { number: String(count) }));
  globalThis.document.getElementById("cycle")?.scrollIntoView({ block: "start" });
}
export const shut = () => {
  sessionStorage.removeItem(KEPT);
  shown.value = null;
};
export const kept = () => sessionStorage.getItem(KEPT);
