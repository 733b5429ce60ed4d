// Camera settings are lost with SETUP unless they are kept.
import { html } from "../../vendor/ui.js";
import { ask, attempt } from "../shared/api.js";
import { cameras, cell, holds, lookAtCameras, SIDES, token } from "../shared/live.js";
import { Shape, say } from "../shared/pieces.js";
import { t } from "../shared/texts.js";

export function Keep() {
  const tried = SIDES.flatMap((side) => Object.keys(cameras.value?.configured?.[side]?.tried ?? {}));
  if (!tried.length || !holds.value) return null;
  // a calibration holds for its own cameras alone
  if (tried.includes("device") && !cell.value.missing.includes("rig"))
    return html`<div class="keep">
      <p><${Shape} is="doubt" /> ${t("keep-calibrate")}</p>
      <a class="button primary" href="#/calibrate">${t("step-calibrate")}</a>
    </div>`;
  const keep = async () => {
    const kept = await attempt(async () => {
      await ask("POST", "cameras/keep", { token: token.value });
      return true;
    });
    if (!kept) return;
    say(t("kept"));
    await lookAtCameras();
  };
  return html`<div class="keep">
    <p><${Shape} is="doubt" /> ${t("keep-what")}</p>
    <button class="primary" onClick=${keep}>${t("keep")}</button>
  </div>`;
}
