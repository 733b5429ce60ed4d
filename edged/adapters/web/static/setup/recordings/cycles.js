// Recorded cycles: the list, one in detail, and regressions.
import { html, signal, useEffect, useState } from "../../vendor/ui.js";
import { ask, attempt, glance } from "../shared/api.js";
import { teachFrom } from "../shared/drafts.js";
import { cell, mayTake, offers, useFresh } from "../shared/live.js";
import { Shape } from "../shared/pieces.js";
import { dashed, moment, number, t } from "../shared/texts.js";
import { Beside } from "./comparison.js";
import { kept, open, REASONS, reasonsOf, SHAPES, shown, shut, statusOf } from "./recorded.js";
import { Regressions } from "./regressions.js";
import { WhatIf } from "./whatif.js";

const MOST = 20;
const listed = signal(null);
const filter = signal({ status: "", reason: "", job: "" });

const query = (more) => {
  const asked = new URLSearchParams({ most: MOST, ...more });
  for (const [key, value] of Object.entries(filter.value)) if (value) asked.set(key, value);
  return `cycles?${asked}`;
};
const find = () =>
  glance(async () => {
    listed.value = await ask("GET", query());
  });
const older = () =>
  attempt(async () => {
    const { cycles, damaged } = listed.value;
    const more = await ask("GET", query({ before: cycles.at(-1).number }));
    listed.value = { ...more, cycles: [...cycles, ...more.cycles], damaged: [...damaged, ...more.damaged] };
  });

function Choice({ name, values, word }) {
  const change = (event) => {
    filter.value = { ...filter.value, [name]: event.currentTarget.value };
    find();
  };
  return html`<label class="field">
    <span>${t(`cycles-filter-${name}`)}</span>
    <select name=${name} onChange=${change}>
      <option value="">${t("cycles-filter-any")}</option>
      ${values.map(
        (value) => html`<option
          key=${value} value=${value} selected=${filter.value[name] === value}
          translate=${name === "job" ? false : undefined}
        >
          ${word(value)}
        </option>`,
      )}
    </select>
  </label>`;
}

function Line({ line }) {
  const { number: count, at, status, job, reasons, sigma_um, kind, has_pictures } = line;
  const isOpen = shown.value?.number === count;
  return html`<li>
    <button class="cycle" aria-pressed=${isOpen} onClick=${() => open(count)}>
      <span class="small">
        ${has_pictures && html`<img src="/api/v1/cycles/${count}/small.jpg" alt="" loading="lazy" />`}
      </span>
      <span class="figure" translate=${false}>${moment(at, "medium")} · ${count}</span>
      ${statusOf(status)} <span translate=${false}>${job}</span>
      <span class="muted">
        ${
          reasons.length
            ? reasonsOf(reasons)
            : kind === "GRAB"
              ? t("cycles-grab")
              : sigma_um === null
                ? ""
                : t("cycles-sigma", { sigma: number(sigma_um, 1) })
        }
      </span>
    </button>
  </li>`;
}

function List() {
  if (!listed.value) return html`<p>${t("cycles-loading")}</p>`;
  const { recorder, cycles, damaged, counts, has_more } = listed.value;
  if (!recorder) return html`<p><${Shape} is="gap" /> ${t("cycles-no-recorder")}</p>`;
  const all = Object.values(counts).reduce((sum, one) => sum + one, 0);
  const jobs = cell.value.jobs.map(({ name }) => name);
  const word = (status) => `${t(`cycles-status-${dashed(status)}`)} (${counts[status] ?? 0})`;
  return html`<div class="row">
      <${Choice} name="status" values=${Object.keys(SHAPES)} word=${word} />
      <${Choice} name="reason" values=${REASONS} word=${(one) => t(`cycles-reason-${dashed(one)}`)} />
      <${Choice} name="job" values=${jobs} word=${(one) => one} />
    </div>
    <p class="muted">${t("cycles-count", { count: all })}</p>
    ${!cycles.length && html`<p>${t("cycles-none")}</p>`}
    <ul class="cycles">${cycles.map((line) => html`<${Line} key=${line.number} line=${line} />`)}</ul>
    <div class="actions">
      ${has_more && html`<button onClick=${older}>${t("cycles-older")}</button>`}
      <button onClick=${find}>${t("cycles-again")}</button>
    </div>
    ${
      damaged.length > 0 &&
      html`<details>
        <summary><${Shape} is="doubt" /> ${t("cycles-damaged", { count: damaged.length })}</summary>
        <ul class="hint" translate=${false} lang="en">
          ${damaged.map(({ file, why }) => html`<li key=${file}>${why}</li>`)}
        </ul>
      </details>`
    }`;
}

function TeachFrom({ count, calibration }) {
  const [isTaking, setTaking] = useState(false);
  const isOther = calibration !== cell.value.rig?.id;
  const begin = async () => {
    setTaking(true);
    await teachFrom({ cycle: count });
    setTaking(false);
  };
  return html`<div class="actions">
      <button disabled=${isTaking || isOther} onClick=${begin}>${t("cycles-teach")}</button>
    </div>
    ${isOther && html`<p class="hint">${t("cycles-teach-other")}</p>`}`;
}

function Cycle() {
  const {
    number: count,
    at,
    status,
    reasons,
    job,
    error,
    trouble,
    trouble_text,
    calibration,
    now,
  } = shown.value;
  return html`<section aria-labelledby="cycle">
    <div class="titled">
      <h2 id="cycle">${t("cycles-title", { number: String(count) })}</h2>
      <button onClick=${shut}>${t("cycles-close")}</button>
    </div>
    <p class="verdict-line">
      ${statusOf(status)} ${reasons.length > 0 && html`<strong>${reasonsOf(reasons)}</strong>`}
    </p>
    <p class="muted" translate=${false}>${moment(at, "medium")} · ${job} · ${calibration}</p>
    ${error && html`<p class="hint" translate=${false} lang="en">${error}</p>`}
    ${
      trouble &&
      html`<p><${Shape} is="doubt" /> ${t(`cycles-trouble-${trouble}`)}</p>
        <p class="hint" translate=${false} lang="en">${trouble_text}</p>`
    }
    ${now && html`<${Beside} key=${count} document=${shown.value} />`}
    ${
      now?.pictures &&
      mayTake.value &&
      offers("teachings") &&
      html`<${TeachFrom} key=${`teach ${count}`} count=${count} calibration=${calibration} />`
    }
    ${now?.pictures && mayTake.value && html`<${WhatIf} key=${`if ${count}`} document=${shown.value} />`}
  </section>`;
}

export default function Cycles() {
  useFresh(find);
  useEffect(() => {
    if (kept() && !shown.value) open(kept());
  }, []);
  return html`<h1>${t("nav-cycles")}</h1>
    <p class="lead">${t("cycles-what")}</p>
    ${shown.value && html`<${Cycle} />`}
    <section aria-labelledby="recorded">
      <h2 id="recorded">${t("cycles-recorded")}</h2>
      <${List} />
    </section>
    ${offers("regressions") && listed.value?.recorder && html`<${Regressions} />`}`;
}
