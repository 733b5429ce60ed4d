// The jobs of the cell: what each is called, how it did, and what can be done with it.
import { html, signal, useEffect, useState } from "../../vendor/ui.js";
import { ask, attempt } from "../api.js";
import { cell, holds, look, mayTake, me, offers, token } from "../live.js";
import { Dialog, NumberField, say, Shape } from "../pieces.js";
import { moment, number, t } from "../texts.js";
import { styled } from "./styles.js";

await styled("jobs");

const jobs = signal(null);
const find = () =>
  attempt(async () => {
    ({ jobs: jobs.value } = await ask("GET", "jobs"));
  });
const at = (name) => `jobs/${encodeURIComponent(name)}`;
const leased = () => (holds.value ? { token: token.value } : {});
const mayUse = () => me.value?.role === "engineer" || me.value?.role === "operator";
const KEPT = "edged.teaching";

// Everything that changes jobs: then both are looked at again.
async function doing(work, said) {
  const done = await attempt(async () => {
    await work();
    return true;
  });
  if (!done) return false;
  say(said);
  await find();
  await attempt(look);
  return true;
}

const edit = (job) =>
  attempt(async () => {
    const { id } = await ask("POST", "teachings", { job });
    localStorage.setItem(KEPT, id); // the page that teaches goes on with it
    location.hash = "#/teach";
  });

const GOOD = 0.95;
function Share({ share }) {
  if (share === null || share === undefined) return html`<span class="muted">${t("jobs-share-none")}</span>`;
  const percent = number(100 * share, share > 0.9995 || share === 0 ? 0 : 1);
  return html`<span class="share"><${Shape} is=${share >= GOOD ? "tick" : "doubt"} /> ${t("jobs-share", { percent })}</span>
    <span class="bar" aria-hidden="true"><span class="now ${share >= GOOD ? "" : "soft"}" style=${{ width: `${100 * share}%` }}></span></span>`;
}

function Job({ job, onAsk }) {
  const { name, number: count, features, last_used, ok_share, active, retired } = job;
  const owner = cell.value.plc.owner;
  const button = (what, onClick, isOff) => html`<button type="button" disabled=${isOff} aria-label=${t(`jobs-${what}-name`, { name })} onClick=${onClick}>${t(`jobs-${what}`)}</button>`;
  return html`<li class="tile job ${retired ? "retired" : ""}">
    <h2><span class="count" translate=${false}>${count}</span> <span translate=${false}>${name}</span> ${active && html`<span class="now"><${Shape} is="tick" /> ${t("jobs-active")}</span>`} ${retired && html`<span class="muted"><${Shape} is="gap" /> ${t("jobs-retired")}</span>`}</h2>
    <dl class="facts">
      <dt>${t("jobs-features")}</dt><dd>${number(features)}</dd>
      <dt>${t("jobs-last")}</dt><dd>${last_used ? html`<span translate=${false}>${moment(last_used)}</span>` : t("jobs-never")}</dd>
      <dt>${t("jobs-good")}</dt><dd><${Share} share=${ok_share} /></dd>
    </dl>
    <div class="actions">
      ${!retired && offers("jobs/{name}/use") && button("use", () => doing(() => ask("POST", `${at(name)}/use`, {}), t("jobs-used", { name })), active || Boolean(owner) || !mayUse())}
      ${!retired && offers("teachings") && button("edit", () => edit(name), !mayTake.value)}
      ${offers("jobs/{name}/duplicate") && button("duplicate", () => onAsk("duplicate", job), !mayTake.value)}
      ${button("rename", () => onAsk("rename", job), !mayTake.value)}
      ${button(retired ? "restore" : "retire", () => onAsk(retired ? "restore" : "retire", job), !mayTake.value || active)}
    </div>
    ${offers("jobs/{name}/versions") && html`<${Versions} name=${name} />`}
  </li>`;
}

function Versions({ name }) {
  const [versions, setVersions] = useState(null);
  const look_ = ({ currentTarget }) =>
    currentTarget.open &&
    attempt(async () => {
      setVersions((await ask("GET", `${at(name)}/versions`)).versions);
    });
  return html`<details class="versions" onToggle=${look_}><summary>${t("jobs-versions")}</summary>
    ${versions && !versions.length && html`<p class="muted">${t("jobs-versions-none")}</p>`}
    <ol>${versions?.map(({ release, created, author, note, active }) => html`<li key=${release}>${t("jobs-release", { number: release })} ${active && html`<${Shape} is="tick" /> ${t("jobs-active")}`} <span class="muted" translate=${false}>${moment(created)} · ${author} · ${note}</span></li>`)}</ol>
  </details>`;
}

// A name that is free, proposed: somebody may only press the button.
const proposed = ({ name }) => {
  const taken = new Set(jobs.value.map((job) => job.name));
  for (let i = 2; ; i++) if (!taken.has(`${name}-${i}`)) return `${name}-${i}`;
};
const freeNumber = () => {
  const taken = new Set(jobs.value.map((job) => job.number));
  for (let i = 1; ; i++) if (!taken.has(i)) return i;
};

function Question({ what, job, onClose }) {
  const isNew = what === "duplicate";
  const isNamed = isNew || what === "rename";
  const [name, setName] = useState(isNew ? proposed(job) : job.name);
  const [count, setCount] = useState(isNew ? freeNumber() : job.number);
  const [note, setNote] = useState("");
  const isWrong = !/^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$/.test(name);
  const isSame = name === job.name && count === job.number;
  const WORK = {
    duplicate: () => ask("POST", `${at(job.name)}/duplicate`, { ...leased(), new_name: name, number: count, note }),
    rename: () => ask("PUT", at(job.name), { ...leased(), ...(name !== job.name ? { new_name: name } : {}), ...(count !== job.number ? { number: count } : {}), note }),
    retire: () => ask("PUT", at(job.name), { ...leased(), retired: true, note }),
    restore: () => ask("PUT", at(job.name), { ...leased(), retired: false, note }),
  };
  const act = async () => {
    onClose();
    await doing(WORK[what], t(`jobs-${what}-done`, { name }));
  };
  return html`<${Dialog} title=${t(`jobs-${what}-title`, { name: job.name })} isOpen=${true} onClose=${onClose}>
    <p>${t(`jobs-${what}-what`)}</p>
    ${isNamed &&
    html`<div class="row"><label class="field"><span>${t("jobs-name")}</span><input name="job" maxlength="64" value=${name} aria-invalid=${isWrong} onInput=${(event) => setName(event.currentTarget.value)} />${isWrong && html`<span class="wrong" role="alert"><${Shape} is="doubt" /> ${t("jobs-name-wrong")}</span>`}</label>
      <${NumberField} name="number" label=${t("jobs-number")} unit="" digits=${0} low=${1} high=${65535} value=${count} onValue=${(value) => setCount(Math.round(value))} /></div>`}
    <label class="field"><span>${t("jobs-note")}</span><input name="note" value=${note} maxlength="200" onInput=${(event) => setNote(event.currentTarget.value)} /></label>
    <div class="actions"><button type="button" onClick=${onClose}>${t("back")}</button><button type="button" class="primary" disabled=${!note.trim() || (isNamed && (isWrong || isSame))} onClick=${act}>${t(`jobs-${what}`)}</button></div>
  <//>`;
}

export default function Jobs() {
  const [asked, setAsked] = useState(null);
  useEffect(() => {
    find();
  }, [cell.value.jobs]);
  const ask_ = (what, job) => setAsked({ what, job });
  const shown = [...(jobs.value ?? [])].sort((one, other) => Number(one.retired) - Number(other.retired) || one.number - other.number);
  return html`<h1>${t("jobs-title")}</h1>
    <p class="lead">${t("jobs-what")}</p>
    ${cell.value.plc.owner && html`<p><${Shape} is="plant" /> ${t("jobs-owned")} <span translate=${false}>${cell.value.plc.owner}</span></p>`}
    ${jobs.value && !jobs.value.length && html`<p><${Shape} is="gap" /> ${t("jobs-none")}</p>`}
    <ul class="tiles jobs">${shown.map((job) => html`<${Job} key=${job.name} job=${job} onAsk=${ask_} />`)}</ul>
    ${offers("teachings") && html`<div class="actions"><a class="button primary" href="#/teach">${t("jobs-teach")}</a></div>`}
    ${asked && html`<${Question} key=${`${asked.what}.${asked.job.name}`} ...${asked} onClose=${() => setAsked(null)} />`}`;
}
