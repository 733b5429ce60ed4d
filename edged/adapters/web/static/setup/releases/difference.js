// The differences between two releases.
import { html, useEffect, useState } from "../../vendor/ui.js";
import { ask, attempt } from "../shared/api.js";
import { dashed, number, sign, t } from "../shared/texts.js";

const DIGITS = 4;
function shown(value) {
  if (value === null || value === undefined) return t("diff-nothing");
  if (Array.isArray(value)) return value.map(shown).join(" × ");
  if (typeof value === "number")
    return Number.isInteger(value) ? number(value) : number(value, DIGITS).replace(/0+$/, "");
  if (typeof value === "boolean") return t(value ? "diff-yes" : "diff-no");
  return typeof value === "object" ? JSON.stringify(value) : String(value) || t("diff-nothing");
}

const Change = ({ one }) => html`<li>
  ${t(`diff-${dashed(one.code)}`, {
    name: one.name ?? "",
    before: shown(one.before),
    after: shown(one.after),
  })}
</li>`;
export const Changes = ({ list }) => html`<ul>
  ${list.map((one) => html`<${Change} key=${`${one.code} ${one.name}`} one=${one} />`)}
</ul>`;

function Rig({ rig }) {
  const { before, after, moved, robot } = rig;
  return html`<h4>${t("diff-rig", { before, after })}</h4>
    ${
      moved &&
      html`<p>
        ${t("diff-moved", {
          rms: number(moved.rms_um, 1),
          max: number(moved.max_um, 1),
          mean: ["X", "Y", "Z"].map((axis, i) => `${axis} ${sign(moved.mean_um[i], 1)}`).join("  "),
        })}
      </p>`
    }
    ${robot && html`<p>${t("diff-robot")}</p>`}`;
}

export function Difference({ from, to }) {
  const [told, setTold] = useState(null);
  useEffect(() => {
    attempt(async () => setTold(await ask("GET", `releases/${from}..${to}`)));
  }, [from, to]);
  if (!told) return html`<p class="muted">${t("diff-waits")}</p>`;
  const { jobs, rig, cameras, settings } = told;
  const isSame =
    !rig &&
    !cameras.length &&
    !settings.length &&
    !jobs.added.length &&
    !jobs.removed.length &&
    !jobs.changed.length;
  return html`<div class="diff" role="region" aria-label=${t("diff-title", { from, to })}>
    <h4>${t("diff-title", { from, to })}</h4>
    ${isSame && html`<p>${t("diff-same")}</p>`}
    ${jobs.added.length > 0 && html`<p>${t("diff-jobs-added", { names: jobs.added.join(", ") })}</p>`}
    ${jobs.removed.length > 0 && html`<p>${t("diff-jobs-removed", { names: jobs.removed.join(", ") })}</p>`}
    ${jobs.changed.map(
      ({ name, changes }) => html`<h4>${t("diff-job", { name })}</h4>
        <${Changes} list=${changes} />`,
    )}
    ${rig && html`<${Rig} rig=${rig} />`}
    ${cameras.length > 0 && html`<h4>${t("diff-cameras")}</h4><${Changes} list=${cameras} />`}
    ${settings.length > 0 && html`<h4>${t("diff-settings")}</h4><${Changes} list=${settings} />`}
  </div>`;
}
