// Regressions: a new job or rig tried on all recorded cycles, the worst changes first.
import { html, signal, useState } from "../../vendor/ui.js";
import { Releasing } from "../releases/releasing.js";
import { ask, attempt, glance, Problem } from "../shared/api.js";
import { look, mayTake, offers, useFresh, useTask } from "../shared/live.js";
import { Shape, say } from "../shared/pieces.js";
import { moment, number, sign, t } from "../shared/texts.js";
import { open, reasonsOf, statusOf } from "./recorded.js";
import { result, running, startRegression } from "./regression.js";

const ROWS = 10;
const kept = signal(null);
const candidates = signal(null);

const find = () =>
  glance(async () => {
    kept.value = (await ask("GET", "regressions")).regressions;
  });

// Candidates: solved rigs, drafts of jobs, older releases.
const search = () =>
  glance(async () => {
    const lists = await Promise.all(
      ["calibrations", "teachings", "releases"].map((one) => (offers(one) ? ask("GET", one) : {})),
    );
    const [calibrations, teachings, releases] = lists.map(
      (one, i) => one[["calibrations", "teachings", "releases"][i]] ?? [],
    );
    candidates.value = [
      ...teachings
        .filter(({ active }) => !active)
        .map(({ id, name, created }) => ({ kind: "teaching", id, what: name, at: created })),
      ...calibrations
        .filter(({ active, solved }) => solved && !active)
        .map(({ id, boards, created }) => ({
          kind: "calibration",
          id,
          what: boards.join(", "),
          at: created,
        })),
      ...releases
        .filter(({ active }) => !active)
        .map(({ number: count, note, created }) => ({
          kind: "release",
          id: String(count),
          what: note,
          at: created,
        })),
    ].slice(0, 20);
  });

const bodyOf = ({ kind, id }) => ({ [kind]: kind === "release" ? Number(id) : id });

export async function show(id) {
  result.value = (await attempt(() => ask("GET", `regressions/${id}`))) ?? null;
}

const verdictOf = ({ passes, counts }) =>
  t(passes ? "cycles-passes" : "cycles-worse", { count: counts.good_to_bad });

function Progress() {
  const { task: id, regression } = running.value;
  const state = useTask(id, async (ended) => {
    running.value = null;
    if (ended.problem) await attempt(() => Promise.reject(new Problem(ended.problem)));
    if (ended.state !== "done") return;
    await show(regression);
    await find();
    if (result.value) say(verdictOf(result.value));
  });
  return html`<div class="meter">
    <label>
      ${t("cycles-testing", { percent: number(100 * (state?.done ?? 0)) })}${" "}
      <progress max="1" value=${state?.done ?? 0}></progress>
    </label>
    <div class="actions">
      <button onClick=${() => attempt(() => ask("DELETE", `tasks/${id}`, {}))}>${t("cycles-cancel")}</button>
    </div>
  </div>`;
}

const axes = (values, digits) =>
  ["X", "Y", "Z"].map((axis, i) => `${axis} ${sign(values[i], digits)}`).join("  ");
function Changed({ one }) {
  const { number: count, at, before, after, reasons, apart_sigmas, apart_um, lost, pictures } = one;
  return html`<tr>
    <th scope="row">
      <button
        class="quiet" aria-label=${t("cycles-look-name", { number: String(count) })}
        onClick=${() => open(count)}
      >
        <img src=${pictures.left} alt="" loading="lazy" width="96" />${" "}
        <span class="figure" translate=${false}>${count}</span>
      </button>
    </th>
    <td translate=${false}>${moment(at)}</td>
    <td>${statusOf(before)} → ${statusOf(after)}</td>
    <td>
      ${reasons.length ? reasonsOf(reasons) : ""} ${
        apart_um &&
        html`<span class="figure" translate=${false}>
          ${axes(apart_um, 1)} µm${apart_sigmas === null ? "" : `, ${number(apart_sigmas, 1)} σ`}
        </span>`
      } ${lost > 0 && t("cycles-lost", { count: lost })}
    </td>
  </tr>`;
}

function Group({ name, list, count }) {
  const [most, setMost] = useState(ROWS);
  if (!count) return null;
  return html`<h4>${t(`cycles-group-${name}`, { count })}</h4>
    <div class="scroll tall" tabindex="0" role="region" aria-label=${t(`cycles-group-${name}`, { count })}>
      <table class="changed">
        <thead>
          <tr>
            <th scope="col">${t("cycles-cycle")}</th><th scope="col">${t("cycles-time")}</th>
            <th scope="col">${t("cycles-result")}</th><th scope="col">${t("cycles-reasons")}</th>
          </tr>
        </thead>
        <tbody>${list.slice(0, most).map((one) => html`<${Changed} key=${one.number} one=${one} />`)}</tbody>
      </table>
    </div>
    ${
      most < list.length &&
      html`<button onClick=${() => setMost(list.length)}>
        ${t("cycles-all-rows", { count: list.length })}
      </button>`
    }`;
}

const PLACES = { teaching: "teachings", calibration: "calibrations" };
function Use() {
  const { what, passes, cycles, counts } = result.value;
  const [isAsked, setAsked] = useState(false);
  if (!PLACES[what.kind] || !mayTake.value) return null;
  const done = async ({ number: made }) => {
    say(t("cycles-used", { number: made }));
    result.value = null;
    await glance(look);
    await search();
  };
  return html`<div class="actions use">
      <button class=${passes ? "primary" : ""} onClick=${() => setAsked(true)}>${t("cycles-use")}</button>
    </div>
    ${
      isAsked &&
      html`<${Releasing}
        title=${t(`cycles-of-${what.kind}`, { id: what.id })} label=${t("cycles-use")}
        barred=${passes ? null : { cycles, good_to_bad: counts.good_to_bad }}
        send=${(body) => ask("POST", `${PLACES[what.kind]}/${what.id}/activate`, body)} onDone=${done}
        onClose=${() => setAsked(false)}
      />`
    }`;
}

function Result() {
  const {
    what,
    at,
    by,
    cycles,
    passes,
    counts,
    motion,
    spread,
    good_to_bad,
    apart,
    bad_to_good,
    skipped,
    seconds,
  } = result.value;
  return html`<section class="result" aria-labelledby="result">
    <h3 id="result">${t(`cycles-of-${what.kind}`, { id: what.id })}</h3>
    <p class="big figure">
      <${Shape} is=${passes ? "tick" : "gap"} />${" "}
      <strong>${verdictOf(result.value)}</strong>
    </p>
    <p class="muted" translate=${false}>${moment(at)} · ${by} · ${number(seconds, 0)} s</p>
    <dl class="facts">
      <dt>${t("cycles-tried")}</dt><dd class="figure">${cycles}</dd>
      <dt>${t("cycles-good-stay")}</dt><dd class="figure">${counts.good_stay}</dd>
      <dt>${t("cycles-bad-good")}</dt><dd class="figure">${counts.bad_to_good}</dd>
      <dt>${t("cycles-bad-stay")}</dt><dd class="figure">${counts.bad_stay}</dd>
      ${
        spread &&
        html`<dt>${t("cycles-spread")}</dt>
          <dd class="figure">
            ${t("cycles-spread-now", {
              rms: number(spread.rms_um, 1),
              max: number(spread.max_um, 1),
              sigmas: number(spread.max_sigmas, 1),
            })}
          </dd>`
      }
      ${
        motion &&
        html`<dt>${t("cycles-motion")}</dt>
          <dd class="figure">
            <span translate=${false}>${axes(motion.shift_um, 1)} µm, ${axes(motion.turn_deg, 4)}°</span>
            <span class="hint">${t("cycles-motion-what")}</span>
          </dd>`
      }
      ${
        counts.skipped > 0 &&
        html`<dt>${t("cycles-skipped")}</dt>
          <dd class="figure">
            ${counts.skipped} <span class="muted" translate=${false}>
              ${skipped
                .slice(0, 5)
                .map(({ number: count }) => count)
                .join(", ")}
            </span>
          </dd>`
      }
    </dl>
    <${Group} name="worse" list=${good_to_bad} count=${counts.good_to_bad} />
    <${Group} name="apart" list=${apart} count=${counts.apart} />
    <${Group} name="better" list=${bad_to_good} count=${counts.bad_to_good} />
    <${Use} key=${result.value.id} />
  </section>`;
}

export function Regressions() {
  useFresh(() => {
    find();
    search();
  });
  return html`<section aria-labelledby="regressions">
    <h2 id="regressions">${t("cycles-regressions")}</h2>
    <p class="hint">${t("cycles-regressions-what")}</p>
    ${running.value && html`<${Progress} key=${running.value.task} />`}
    ${result.value && html`<${Result} />`}
    ${
      mayTake.value &&
      candidates.value?.length > 0 &&
      html`<h3>${t("cycles-candidates")}</h3>
        <ul class="lines">
          ${candidates.value.map(
            (one) =>
              html`<li key=${`${one.kind} ${one.id}`}>
                <span>
                  ${t(`cycles-kind-of-${one.kind}`)} <span translate=${false}>${one.what}</span>${" "}
                  <span class="muted" translate=${false}>${moment(one.at)}</span>
                </span>
                <button
                  disabled=${running.value !== null}
                  aria-label=${t("cycles-test-name", {
                    what: `${t(`cycles-kind-of-${one.kind}`)} ${one.what}`,
                  })}
                  onClick=${() => startRegression(bodyOf(one))}
                >
                  ${t("cycles-test-all")}
                </button>
              </li>`,
          )}
        </ul>`
    }
    ${
      kept.value?.length > 0 &&
      html`<h3>${t("cycles-kept")}</h3>
        <ul class="lines">
          ${kept.value.map(
            (one) =>
              html`<li key=${one.id}>
                <span>
                  <${Shape} is=${one.passes ? "tick" : "gap"} />${" "}
                  ${t(`cycles-of-${one.what.kind}`, { id: one.what.id })}${" "}
                  <span class="muted" translate=${false}>${moment(one.at)} · ${one.by}</span>${" "}
                  ${verdictOf(one)}
                </span>
                <button
                  aria-label=${t("cycles-show-name", { at: moment(one.at) })} onClick=${() => show(one.id)}
                >
                  ${t("cycles-show")}
                </button>
              </li>`,
          )}
        </ul>`
    }
  </section>`;
}
