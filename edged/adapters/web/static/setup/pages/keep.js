// What was tried with the cameras goes with SETUP, unless it is kept.
import { html } from "../../vendor/ui.js";
import { ask, attempt } from "../api.js";
import { cameras, holds, lookAtCameras, SIDES, token } from "../live.js";
import { say, Shape } from "../pieces.js";
import { t } from "../texts.js";

export function Keep() {
  const isTried = SIDES.some((side) => Object.keys(cameras.value?.configured?.[side]?.tried ?? {}).length);
  if (!isTried || !holds.value) return null;
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
    <button type="button" class="primary" onClick=${keep}>${t("keep")}</button>
  </div>`;
}
