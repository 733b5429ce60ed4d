// The jobs of the cell: names, results, versions.
import { html, signal, useState } from "../../vendor/ui.js";
import { ask, attempt, glance, Problem, sentence } from "../shared/api.js";
import { teachFrom } from "../shared/drafts.js";
import { cell, look, mayTake, me, useFresh } from "../shared/live.js";
import { Dialog, NumberField, Shape, say } from "../shared/pieces.js";
import { moment, number, t } from "../shared/texts.js";
import { Releasing } from "./releasing.js";

const jobs = signal(null);
const find = () =>
  glance(async () => {
    ({ jobs: jobs.value } = await ask("GET", "jobs"));
  });
const at = ({ folder }) => `jobs/${encodeURIComponent(folder)}`;
const mayUse = () => me.value?.role === "engineer" || me.value?.role === "operator";

// Reloads jobs and cell after a change.
async function changed(said) {
  say(said);
  await find();
  await glance(look);
}
const use = (job) =>
  attempt(async () => {
    await ask("POST", `${at(job)}/use`, {});
    await changed(t("jobs-used", { name: job.name }));
  });
const GOOD = 0.95;
function Share({ share, cycles }) {
  if (share === null || share === undefined) return html`<span class="muted">${t("jobs-share-none")}</span>`;
  const percent = number(100 * share, share > 0.9995 || share === 0 ? 0 : 1);
  return html`<span class="share">
      <${Shape} is=${share >= GOOD ? "tick" : "doubt"} /> ${t("jobs-share", { percent, count: cycles })}
    </span>
    <span class="bar" aria-hidden="true">
      <span class="now ${share >= GOOD ? "" : "soft"}" style=${{ width: `${100 * share}%` }}></span>
    </span>`;
}

function Job({ job, onAsk }) {
  const {
    name,
    number: count,
    features,
    last_used,
    cycles,
    ok_share,
    active,
    retired,
    retired_by,
    retired_at,
  } = job;
  const owner = cell.value.plc.owner;
  const button = (
    what,
    onClick,
    isOff,
  ) => html`<button disabled=${isOff} aria-label=${t(`jobs-${what}-name`, { name })} onClick=${onClick}>
    ${t(`jobs-${what}`)}
  </button>`;
  return html`<li class="tile job ${retired ? "retired" : ""}">
    <h2>
      <span class="count" translate=${false}>${count}</span> <span translate=${false}>${name}</span>${" "}
      ${active && html`<span class="now"><${Shape} is="tick" /> ${t("jobs-active")}</span>`}${" "}
      ${retired && html`<span class="muted"><${Shape} is="gap" /> ${t("jobs-retired")}</span>`}
    </h2>
    <dl class="facts">
      <dt>${t("jobs-features")}</dt><dd>${number(features)}</dd>
      <dt>${t("jobs-last")}</dt>
      <dd>${last_used ? html`<span translate=${false}>${moment(last_used)}</span>` : t("jobs-never")}</dd>
      <dt>${t("jobs-good")}</dt><dd><${Share} share=${ok_share} cycles=${cycles} /></dd>
      ${
        retired_at &&
        html`<dt>${t("jobs-retired")}</dt>
          <dd translate=${false}>${moment(retired_at)} · ${retired_by}</dd>`
      }
    </dl>
    <div class="actions">
      ${
        !retired &&
        button("use", () => use(job), active || Boolean(owner) || cell.value.state === "SETUP" || !mayUse())
      }
      ${
        !retired &&
        button(
          "golden",
          () => onAsk("golden", job),
          Boolean(owner) || cell.value.state === "SETUP" || me.value?.role !== "engineer",
        )
      }
      ${!retired && button("edit", () => teachFrom({ job: job.folder }), !mayTake.value || !job.editable)}
      ${!retired && button("duplicate", () => onAsk("duplicate", job), !mayTake.value)}
      ${button("rename", () => onAsk("rename", job), !mayTake.value)}
      ${button(
        retired ? "restore" : "retire",
        () => onAsk(retired ? "restore" : "retire", job),
        !mayTake.value || active,
      )}
    </div>
    <${Versions} job=${job} />
  </li>`;
}

function Versions({ job }) {
  const [versions, setVersions] = useState(null);
  const look_ = ({ currentTarget }) =>
    currentTarget.open &&
    attempt(async () => {
      setVersions((await ask("GET", `${at(job)}/versions`)).versions);
    });
  return html`<details class="versions" onToggle=${look_}>
    <summary>${t("jobs-versions")}</summary>
    ${versions && !versions.length && html`<p class="muted">${t("jobs-versions-none")}</p>`}
    <ol>
      ${versions?.map(
        ({ release, created, author, note, active }) => html`<li key=${release}>
          ${t("jobs-release", { number: release })}${" "}
          ${active && html`<${Shape} is="tick" /> ${t("jobs-active")}`}${" "}
          <span class="muted" translate=${false}>${moment(created)} · ${author} · ${note}</span>
        </li>`,
      )}
    </ol>
  </details>`;
}

// Proposes a free name and number.
const from = (first, isFree) => {
  for (let i = first; ; i++) if (isFree(i)) return i;
};
const freeName = ({ name }) =>
  `${name}-${from(2, (i) => jobs.value.every((job) => job.name !== `${name}-${i}`))}`;
const freeNumber = () => from(1, (i) => jobs.value.every((job) => job.number !== i));

// to: the name and number that are proposed first.
function Question({ what, job, to, onClose }) {
  const isNew = what === "duplicate";
  const isNamed = isNew || what === "rename";
  const [name, setName] = useState(isNew ? freeName(job) : (to ?? job).name);
  const [count, setCount] = useState(isNew ? freeNumber() : (to ?? job).number);
  const isWrong = !/^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$/.test(name);
  const isSame = name === job.name && count === job.number;
  const WORK = {
    duplicate: (body) => ask("POST", `${at(job)}/duplicate`, { ...body, new_name: name, number: count }),
    rename: (body) =>
      ask("PUT", at(job), {
        ...body,
        ...(name !== job.name ? { new_name: name } : {}),
        ...(count !== job.number ? { number: count } : {}),
      }),
    retire: (body) => ask("PUT", at(job), { ...body, retired: true }),
    restore: (body) => ask("PUT", at(job), { ...body, retired: false }),
  };
  return html`<${Releasing}
    title=${t(`jobs-${what}-title`, { name: job.name })} label=${t(`jobs-${what}`)}
    isReady=${!isNamed || (!isWrong && !isSame)} send=${WORK[what]}
    onDone=${() => {
      last.value = { what, job, now: { name, number: count } };
      return changed(t(`jobs-${what}-done`, { name }));
    }} onClose=${onClose}
  >
    <p>${t(`jobs-${what}-what`)}</p>
    ${
      isNamed &&
      html`<div class="row">
        <label class="field">
          <span>${t("jobs-name")}</span>
          <input
            name="job" maxlength="64" value=${name} aria-invalid=${isWrong}
            onInput=${(event) => setName(event.currentTarget.value)}
          />
          ${
            isWrong &&
            html`<span class="wrong" role="alert">
              <${Shape} is="doubt" /> ${t("jobs-name-wrong")}
            </span>`
          }
        </label>
        <${NumberField}
          name="number" label=${t("jobs-number")} unit="" digits=${0} low=${1} high=${65535} value=${count}
          onValue=${(value) => setCount(Math.round(value))}
        />
      </div>`
    }
  <//>`;
}

// The last change is undone by its opposite, a release of its own, and that by the change itself.
const last = signal(null);
const OPPOSITE = { duplicate: "retire", rename: "rename", retire: "restore", restore: "retire" };
function Undo({ onAsk }) {
  const { what, job, now } = last.value ?? {};
  const there = jobs.value?.find(({ name }) => name === now?.name);
  if (!what || !there) return null;
  return html`<p class="keep" role="status">
    <span><${Shape} is="tick" /> ${t(`jobs-${what}-done`, now)}</span>
    <button
      disabled=${!mayTake.value}
      onClick=${() => onAsk(OPPOSITE[what], there, what === "rename" ? job : null)}
    >
      ${t("jobs-undo")}
    </button>
  </p>`;
}

// Keeps where the part lies now; a path that was taught on the former one no longer fits: it is asked first.
function Golden({ job, onClose }) {
  const [state, setState] = useState("");
  const [failed, setFailed] = useState(null);
  const keep = async () => {
    setState("busy");
    setFailed(null);
    try {
      await ask("POST", `${at(job)}/golden`, {});
      setState("kept");
      await changed(t("jobs-golden-done", { name: job.name }));
    } catch (problem) {
      if (!(problem instanceof Problem)) throw problem;
      setState("");
      setFailed(problem); // here, as the page's own message lies behind this dialog
    }
  };
  const title = t("jobs-golden-title", { name: job.name });
  return html`<${Dialog} title=${title} isOpen=${true} onClose=${onClose}>
    <p>${t("jobs-golden-what")}</p>
    ${state === "kept" && html`<p><${Shape} is="tick" /> ${t("jobs-golden-done", { name: job.name })}</p>`}
    ${failed && html`<p class="wrong" role="alert"><${Shape} is="doubt" /> ${sentence(failed)}</p>`}
    <div class="actions">
      <button onClick=${onClose}>${t("back")}</button>
      <button class="primary" disabled=${state !== ""} onClick=${keep}>${t("jobs-golden-keep")}</button>
    </div>
  <//>`;
}

export default function Jobs() {
  const [asked, setAsked] = useState(null);
  useFresh(find, [cell.value.jobs]);
  const ask_ = (what, job, to = null) => setAsked({ what, job, to });
  return html`<h1>${t("jobs-title")}</h1>
    <p class="lead">${t("jobs-what")}</p>
    ${cell.value.state === "SETUP" && html`<p><${Shape} is="hand" /> ${t("jobs-in-setup")}</p>`}
    ${
      cell.value.plc.owner &&
      html`<p>
        <${Shape} is="plant" /> ${t("jobs-owned")} <span translate=${false}>${cell.value.plc.owner}</span>
      </p>`
    }
    ${jobs.value && !jobs.value.length && html`<p><${Shape} is="gap" /> ${t("jobs-none")}</p>`}
    <${Undo} onAsk=${ask_} />
    <ul class="tiles jobs">
      ${jobs.value?.map((job) => html`<${Job} key=${job.folder} job=${job} onAsk=${ask_} />`)}
    </ul>
    <div class="actions"><a class="button primary" href="#/teach">${t("jobs-teach")}</a></div>
    ${
      asked?.what === "golden" &&
      html`<${Golden} key=${asked.job.folder} job=${asked.job} onClose=${() => setAsked(null)} />`
    }
    ${
      asked &&
      asked.what !== "golden" &&
      html`<${Question}
        key=${`${asked.what}.${asked.job.folder}`} ...${asked} onClose=${() => setAsked(null)}
      />`
    }`;
}
