// What the cell has and lacks, and the next step as a big button.
import { html, useState } from "../../vendor/ui.js";
import { ask, glance } from "../shared/api.js";
import { cameras, cell, hasManual, mayTake, offers, useFresh } from "../shared/live.js";
import { number, t } from "../shared/texts.js";
import { isBuilt, next, STEPS, State } from "../steps.js";

// Pages of the manual for steps that this cell does not offer.
const MANUAL = {
  cameras: "cameras",
  light: "cameras",
  calibrate: "calibrate",
  check: "calibrate",
  teach: "teach",
  try: "operate",
  robot: "robot-frame",
  plc: "plc",
};

// What edged doctor found the last time; the page System has it, and what helps.
function Machine() {
  const [found, setFound] = useState(null);
  useFresh(() => glance(async () => setFound(await ask("GET", "machine"))));
  const count = (verdict) => found.checks.filter((check) => check.verdict === verdict).length;
  return html`<dt>${t("fact-machine")}</dt>
    <dd>
      ${
        found?.at
          ? t("fact-machine-found", { bad: count("bad"), warn: count("warn") })
          : t("fact-machine-new")
      }${" "}
      <a class="button" href="#/system">${t("fact-machine-look")}</a>
    </dd>`;
}

export default function Welcome() {
  const { name, missing, rig, jobs, plc, error } = cell.value;
  const found = cameras.value?.found ?? [];
  const later = STEPS.filter((step) => !isBuilt(step));
  return html`<h1>${t("welcome-title", { cell: name })}</h1>
    <p class="lead">${t(missing.length ? "welcome-new" : "welcome-complete")}</p>
    ${
      next.value
        ? html`<a class="button primary big" href="#/${next.value.id}">
          ${t(`next-${next.value.id}`)}
        </a>`
        : html`<p class="done"><${State} is="tick" /> ${t("welcome-done")}</p>`
    }
    <section aria-labelledby="facts">
      <h2 id="facts">${t("welcome-facts")}</h2>
      <dl class="facts">
        <dt>${t("fact-cameras")}</dt>
        <dd>
          ${
            cameras.value
              ? t("fact-cameras-found", {
                  count: found.length,
                  troubled: found.filter(({ trouble }) => trouble).length,
                })
              : t("fact-unknown")
          }
        </dd>
        <dt>${t("fact-rig")}</dt>
        <dd>
          ${
            rig
              ? html`<span translate=${false}>${rig.id}</span>
                ${
                  rig.sigma_um &&
                  html`${" "}${t("fact-rig-sigma", {
                    sigma: number(Math.max(...Object.values(rig.sigma_um)), 1),
                  })}`
                }`
              : t("fact-no-rig")
          }
        </dd>
        <dt>${t("fact-jobs")}</dt>
        <dd>
          ${
            jobs.length
              ? html`<span translate=${false}>
                ${jobs.map((job) => `${job.number} ${job.name}`).join(", ")}
              </span>`
              : t("fact-no-jobs")
          }
        </dd>
        <dt>${t("fact-plc")}</dt>
        <dd>
          ${
            plc.owner
              ? html`${t("fact-plc-owner")}${" "}
                <span translate=${false}>${plc.owner}</span>`
              : t("fact-no-plc")
          }
        </dd>
        ${mayTake.value && offers("machine") && html`<${Machine} />`}
        ${error && html`<dt>${t("fact-error")}</dt><dd translate=${false}>${error}</dd>`}
      </dl>
    </section>
    ${
      later.length > 0 &&
      html`<section aria-labelledby="later">
        <h2 id="later">${t("welcome-later")}</h2>
        <p>${t("welcome-later-why")}</p>
        <ul class="later">
          ${later.map(
            ({ id, state }) => html`<li>
              <${State} is=${state()} /> ${t(`step-${id}`)}${
                hasManual && html`: <a href="/manual/how-to/${MANUAL[id]}/">${t(`manual-${id}`)}</a>`
              }
            </li>`,
          )}
        </ul>
      </section>`
    }`;
}
