// An acceptance: pictures of each test are taken, then the cell is judged by them.
import { html, useState } from "../../vendor/ui.js";
import { ask, attempt, glance } from "../shared/api.js";
import { cell, holds, sign, token, useFresh, useTask } from "../shared/live.js";
import { Pair } from "../shared/picture.js";
import { Failed, NumberField, Shape, say, Underway, useKept } from "../shared/pieces.js";
import { moment, number, t } from "../shared/texts.js";
import { Figures, Study, signs, verdictOf } from "./study.js";

const AT_ONCE = { still: 50, pose: 1, length: 1 };

function Taken({ name, taken, needed, isBusy, onTake, onClear, children }) {
  const count = AT_ONCE[name];
  return html`<section aria-labelledby=${`accept-${name}`}>
    <h2 id=${`accept-${name}`}>
      <${Shape} is=${taken >= needed ? "tick" : "none"} /> ${t(`accept-${name}`)}
    </h2>
    <p>${t(`accept-${name}-how`)}</p>
    <p class="figure">${t("accept-taken", { taken, needed })}</p>
    ${children}
    <div class="actions">
      ${
        count &&
        html`<button disabled=${!holds.value || isBusy} onClick=${() => onTake(name, count)}>
          ${t(count > 1 ? "accept-take-many" : "accept-take", { count })}
        </button>`
      }
      ${
        taken > 0 &&
        html`<button disabled=${!holds.value || isBusy} onClick=${() => onClear(name)}>
          ${t("accept-clear")}
        </button>`
      }
    </div>
  </section>`;
}

function Last({ last, isCurrent }) {
  return html`<section aria-labelledby="accept-last">
    <h2 id="accept-last">${t("accept-last")}</h2>
    <p class="big figure">
      <${Shape} is=${isCurrent ? verdictOf(last.passed) : "none"} />${" "}
      <strong>${t(last.passed ? "accept-passed" : "accept-failed")}</strong>
    </p>
    ${!isCurrent && html`<p><${Shape} is="doubt" /> ${t("accept-other")}</p>`}
    <p class="muted">
      <span translate=${false}>${moment(last.at)} · ${last.by}</span> ·${" "}
      ${t("accept-due", { when: moment(last.due) })}
    </p>
    ${last.tests.map(
      ({ name, good, why, figures }) => html`<div key=${name}>
        <h3>
          <${Shape} is=${verdictOf(good)} /> ${t(`accept-${name}`)}:${" "}
          ${t(`accept-is-${good === null ? "open" : good ? "good" : "bad"}`)}
        </h3>
        ${why && html`<p translate=${false} lang="en">${signs(why)}</p>`}
        <${Figures} figures=${figures} />
      </div>`,
    )}
    <div class="actions">
      <a class="button" href="/api/v1/acceptance/report" target="_blank">${t("accept-report")}</a>
    </div>
  </section>`;
}

function Length({ name, mm, onName, onMm }) {
  return html`<div class="row">
    <label class="field">
      <span>${t("accept-what")}</span>
      <input
        name="length" autocomplete="off" placeholder="c1-c2" value=${name}
        onInput=${({ currentTarget }) => onName(currentTarget.value.trim())}
      />
    </label>
    <${NumberField}
      label=${t("accept-true")} unit="mm" digits=${4} low=${0.001} high=${100000} value=${mm} onValue=${onMm}
      name="mm" isForm
    />
  </div>`;
}

function Touched({ onKeep, isBusy }) {
  const [table, setTable] = useKept("accept-touched", "");
  return html`<label class="field">
      <span>${t("accept-table")}</span>
      <textarea
        name="touched" rows="5" spellcheck=${false} value=${table}
        onInput=${({ currentTarget }) => setTable(currentTarget.value)}
      ></textarea>
    </label>
    <div class="actions">
      <button disabled=${!holds.value || isBusy || !table.trim()} onClick=${() => onKeep(table)}>
        ${t("accept-keep")}
      </button>
    </div>`;
}

export default function Accept() {
  const [known, setKnown] = useState(null);
  const [id, setId] = useState(null);
  const [failed, setFailed] = useState(null);
  const [chosen, setJob] = useKept("accept-job", null);
  const [name, setName] = useKept("accept-length", "");
  const [mm, setMm] = useKept("accept-mm", null);
  const find = () => glance(async () => setKnown(await ask("GET", "acceptance")));
  useFresh(find);
  const state = useTask(id, async (ended) => {
    setId(null);
    if (ended.state !== "done") setFailed(ended);
    await find();
    say(t("accept-done"));
  });
  const begin = (path, body) =>
    attempt(async () => {
      sign();
      setFailed(null);
      setId((await ask("POST", path, { token: token.value, ...body })).task);
    });
  const change = (method, path, body) =>
    attempt(async () => setKnown(await ask(method, path, { token: token.value, ...body })));
  const head = html`<h1>${t("accept-title")}</h1><p class="lead">${t("accept-why")}</p>`;
  const { jobs } = cell.value;
  if (!jobs.length)
    return html`${head}<p><${Shape} is="gap" /> ${t("accept-no-job")}</p>
      <div class="actions"><a class="button primary" href="#/teach">${t("step-teach")}</a></div>`;
  const job = jobs.some((one) => one.name === chosen) ? chosen : jobs[0].name;
  const length = name && mm ? { name, mm } : null;
  const isBusy = Boolean(id);
  const inside = {
    length: html`<${Length} name=${name} mm=${mm} onName=${setName} onMm=${setMm} />`,
    robot: html`<${Touched}
      isBusy=${isBusy} onKeep=${(table) => change("PUT", "acceptance/robot", { table })}
    />`,
  };
  return html`${head}
    <${Pair} />
    ${!holds.value && html`<p class="hint">${t("accept-hold")}</p>`}
    <label class="field">
      <span>${t("accept-job")}</span>
      <select name="job" onChange=${({ currentTarget }) => setJob(currentTarget.value)}>
        ${jobs.map(
          (one) => html`<option
            key=${one.name} value=${one.name} selected=${one.name === job} translate=${false}
          >
            ${number(one.number)} ${one.name}
          </option>`,
        )}
      </select>
    </label>
    ${(known?.tests ?? []).map(
      (test) => html`<${Taken}
        key=${test.name} ...${test} isBusy=${isBusy}
        onTake=${(which, count) => begin("acceptance/pictures", { test: which, count })}
        onClear=${(which) => change("POST", "acceptance/clear", { test: which })}
      >
        ${inside[test.name]}
      <//>`,
    )}
    <section aria-labelledby="accept-judge">
      <h2 id="accept-judge">${t("accept-judge")}</h2>
      <p>${t("accept-judge-how")}</p>
      <div class="actions">
        <button
          class="primary big" disabled=${!holds.value || isBusy}
          onClick=${() => begin("acceptance/accept", { job, length })}
        >
          ${t("accept-now")}
        </button>
      </div>
      ${id && html`<${Underway} text=${t("accept-running")} state=${state} />`}
      ${failed && html`<${Failed} text=${t("accept-stopped")} ended=${failed} />`}
    </section>
    ${known?.last && html`<${Last} last=${known.last} isCurrent=${known.is_current} />`}
    <${Study} job=${job} />`;
}
