// Trying a job: live results, the map of predicted sigma, and the still test of sigma.
import { html, useEffect, useState } from "../../vendor/ui.js";
import { ask, attempt, glance, sentence } from "../shared/api.js";
import {
  cell,
  holds,
  liveState,
  rawSize,
  SIDES,
  sign,
  token,
  told,
  useFresh,
  useTask,
} from "../shared/live.js";
import { Pair } from "../shared/picture.js";
import { Failed, Shape, say, Underway } from "../shared/pieces.js";
import { dashed, inWords, moment, number, t } from "../shared/texts.js";
import { SigmaMap } from "./sigmamap.js";
import { chosen, findMap, isOn, look, rest, run, trial } from "./trial.js";

const AXES = ["x", "y", "z"];
const TURNS = ["a", "b", "c"];
const LONGEST_SHARE = 0.025; // of the picture's width; one whisker in twenty may be longer
const STEPS = [1, 2, 5];

const line = (outline) => `M${outline.map(([x, y]) => `${x} ${y}`).join("L")}`;

// The largest factor of 1, 2, 5, 10 ... by which 19 of 20 residuals stay short enough.
function magnified(targets, width) {
  const all = targets
    .flatMap(({ residuals }) =>
      SIDES.flatMap((side) => residuals[side].map(([, , dx, dy]) => Math.hypot(dx, dy))),
    )
    .sort((one, other) => one - other);
  if (!all.length) return null;
  const most = Math.max(
    (LONGEST_SHARE * width) / Math.max(all[Math.floor(0.95 * (all.length - 1))], 1e-3),
    1,
  );
  const decade = 10 ** Math.floor(Math.log10(most));
  return Math.max(...STEPS.map((one) => one * decade).filter((one) => one <= most));
}

// Over a live picture: outlines, missing ones dashed, residuals as whiskers with a scale.
function over(side) {
  const targets = isOn.value ? (trial.value?.targets ?? []) : [];
  const { width, height } = rawSize(side);
  const factor = magnified(targets, width);
  const px = width / 640;
  return html`<g class="tried" style=${{ "--px": px }}>
    ${targets.map(
      (target, i) => html`<g key=${i} class=${target.status === "OK" ? "good" : "bad"}>
        ${target.missing[side].map((one, n) => html`<path key=${n} class="missing" d=${line(one)} />`)}
        ${target.outlines[side].map(
          (one, n) => html`<g key=${n}>
            <path class="rim" d=${line(one)} /><path class="line" d=${line(one)} />
          </g>`,
        )}
        ${
          factor &&
          html`<path
            class="whiskers"
            d=${target.residuals[side]
              .map(([x, y, dx, dy]) => `M${x} ${y}l${dx * factor} ${dy * factor}`)
              .join("")}
          />`
        }
        ${
          target[side] &&
          html`<path
            class="centre"
            d="M${target[side][0] - 8 * px} ${target[side][1]}h${16 * px}M${target[side][0]} ${
              target[side][1] - 8 * px
            }v${16 * px}"
          />`
        }
      </g>`,
    )}
    ${
      factor &&
      html`<g class="scale">
        <path
          d="M${20 * px} ${height - 20 * px}h${0.1 * factor}M${20 * px} ${height - 24 * px}v${
            8 * px
          }M${20 * px + 0.1 * factor} ${height - 24 * px}v${8 * px}"
        />
        <text x=${26 * px + 0.1 * factor} y=${height - 15 * px} translate=${false}>
          ${number(0.1, 1)} px ×${factor}
        </text>
      </g>`
    }
  </g>`;
}

function Verdict() {
  if (!isOn.value) return html`<p class="big figure"><${Shape} is="none" /> ${t("try-off")}</p>`;
  if (!trial.value.status && !trial.value.trouble && !liveState.value.code)
    return html`<p class="big figure" role="status">
      <${Shape} is="busy" /> ${t("try-coming")}
    </p>`;
  const { status, reasons, trouble: measured } = trial.value;
  const { on: isLive, code, detail } = liveState.value; // pictures that are lost are not measured
  const trouble = isLive && code ? { code, text: detail ?? "" } : measured;
  const isGood = status === "OK" && !trouble;
  return html`<div class="big figure" role="status">
    <p>
      <${Shape} is=${isGood ? "tick" : trouble ? "doubt" : "gap"} />${" "}
      <strong>${trouble ? t("try-trouble") : t(`try-status-${dashed(status)}`)}</strong>
    </p>
    ${trouble && html`<p class="small">${sentence({ ...trouble, detail: trouble.text })}</p>`}
    ${!isGood && reasons.map((one) => html`<p key=${one} class="small">${inWords("try-why", one)}</p>`)}
  </div>`;
}

function Pose({ target: { pose, sigma_um, sigma_deg, frame } }) {
  const row = (name, value, digits, unit, sigma, sigmaDigits, sigmaUnit) =>
    html`<tr key=${name}>
      <th scope="row" translate=${false}>${name.toUpperCase()}</th>
      <td translate=${false}>${number(value, digits)} ${unit}</td>
      <td translate=${false}>
        ${Number.isFinite(sigma) ? `± ${number(sigma, sigmaDigits)} ${sigmaUnit}` : "–"}
      </td>
    </tr>`;
  return html`<table class="pose">
    <caption>${t(`try-frame-${frame}`)}</caption>
    <tbody>
      ${AXES.map((axis) =>
        row(axis, pose[`${axis}_mm`], 3, "mm", sigma_um?.[axis], sigma_um?.[axis] < 9.95 ? 1 : 0, "µm"),
      )}
      ${TURNS.map((turn) => row(turn, pose[`${turn}_deg`], 3, "°", sigma_deg?.[turn], 3, "°"))}
    </tbody>
  </table>`;
}

// --- still test ---

const STILL = 30;
const last = told("still");

function Still() {
  const [id, setId] = useState(null);
  const [failed, setFailed] = useState(null);
  const findLast = () =>
    glance(async () => {
      ({ last: last.value } = await ask("GET", "trials/still"));
    });
  const begin = () =>
    attempt(async () => {
      sign();
      setFailed(null);
      setId((await ask("POST", "trials/still", { token: token.value, pictures: STILL })).task);
    });
  const state = useTask(id, (ended) => {
    setId(null);
    if (ended.state === "done") findLast().then(() => last.value && say(sentenceOf(last.value)));
    else setFailed(ended);
  });
  return html`<section aria-labelledby="try-still">
    <h2 id="try-still">${t("try-still")}</h2>
    <p class="hint">${t("try-still-what")}</p>
    <div class="actions">
      <button disabled=${!holds.value || !isOn.value || Boolean(id)} onClick=${begin}>
        ${t("try-still-start", { count: STILL })}
      </button>
    </div>
    ${id && html`<${Underway} text=${t("try-still-running")} state=${state} />`}
    ${failed && html`<${Failed} text=${t("try-still-failed")} ended=${failed} />`}
    ${last.value && !id && html`<${StillResult} ...${last.value} />`}
  </section>`;
}

// Too much scatter is explained by vibration and flicker alone, or also by a sigma that is too small.
const sentenceOf = ({ verdict, covers, chi2, expected: [low, high], n }) =>
  t(`try-verdict-${verdict}${verdict === "larger" && covers ? "-covered" : ""}`, {
    chi2: number(chi2, 2),
    low: number(low, 2),
    high: number(high, 2),
    count: n,
  });
const FINE = ["honest", "smaller"]; // too large a sigma is safe

function StillResult(result) {
  const { at, by, name, scatter_um, noise_um, edges_um, verdict } = result;
  return html`<p class="verdict" role="status">
      <${Shape} is=${FINE.includes(verdict) ? "tick" : "doubt"} /> ${sentenceOf(result)}
    </p>
    <p class="muted" translate=${false}>${name} · ${moment(at)} · ${by}</p>
    ${
      scatter_um &&
      edges_um &&
      html`<div class="scroll" tabindex="0" role="region" aria-label=${t("try-still")}>
        <table class="pose">
          <thead>
            <tr>
              <th scope="col"><span class="unseen">${t("try-axis")}</span></th>
              <th scope="col">${t("try-scatter")}</th><th scope="col">${t("try-noise")}</th>
              <th scope="col">${t("try-edges")}</th>
            </tr>
          </thead>
          <tbody>
            ${AXES.map(
              (axis) => html`<tr key=${axis}>
                <th scope="row" translate=${false}>${axis.toUpperCase()}</th>
                ${[scatter_um, noise_um, edges_um].map(
                  (one) => html`<td translate=${false}>${one ? `${number(one[axis], 2)} µm` : "–"}</td>`,
                )}
              </tr>`,
            )}
          </tbody>
        </table>
      </div>`
    }`;
}

// --- choice of the job ---

let offered = null; // the draft that was chosen because it was taught here last

function Choice() {
  const [taught, setTaught] = useState(null);
  useFresh(() => glance(async () => setTaught((await ask("GET", "teachings")).teachings)));
  const drafts = taught?.filter(({ active }) => !active);
  const options = [
    ...(drafts ?? []).map(({ id, name }) => [`teaching:${id}`, name, true]),
    ...cell.value.jobs.map(({ name, number: count }) => [`job:${name}`, `${count} ${name}`, false]),
  ];
  useEffect(() => {
    if (!taught || isOn.value) return;
    const newest = taught.find(({ id }) => id === localStorage.getItem("edged.teaching"));
    const isKnown = options.some(([key]) => key === chosen.value);
    if (isKnown && newest?.id === offered) return;
    offered = newest?.id;
    // the part taught here last comes first, as a draft or as the job that it became
    const its = newest && (newest.active ? `job:${newest.name}` : `teaching:${newest.id}`);
    const found = options.find(([key]) => key === its) ?? (isKnown ? [chosen.value] : options[0]);
    chosen.value = found?.[0] ?? "";
  }, [taught, options.length]);
  const choose = async ({ currentTarget }) => {
    const wasOn = isOn.value;
    chosen.value = currentTarget.value;
    if (wasOn) await run(true);
  };
  if (drafts && !options.length)
    return html`<p><${Shape} is="gap" /> ${t("try-nothing")}</p>
      <div class="actions"><a class="button primary" href="#/teach">${t("step-teach")}</a></div>`;
  return html`<div class="row choice-row">
      <label class="field">
        <span>${t("try-which")}</span>
        <select name="which" onChange=${choose}>
          ${[true, false].map((isDraft) => {
            const group = options.filter(([, , one]) => one === isDraft);
            return (
              group.length > 0 &&
              html`<optgroup key=${isDraft} label=${t(isDraft ? "try-drafts" : "try-jobs")}>
                ${group.map(
                  ([key, name]) => html`<option
                    key=${key} value=${key} translate=${false} selected=${key === chosen.value}
                  >
                    ${name}
                  </option>`,
                )}
              </optgroup>`
            );
          })}
        </select>
      </label>
      <button
        class=${isOn.value ? "" : "primary"} aria-pressed=${isOn.value}
        disabled=${!holds.value || !chosen.value} onClick=${() => run(!isOn.value)}
      >
        ${t(isOn.value ? "try-stop" : "try-start")}
      </button>
    </div>
    ${!holds.value && html`<p class="hint">${t("try-take")}</p>`}`;
}

export default function Try() {
  useFresh(look);
  useEffect(() => rest, []);
  useEffect(() => {
    findMap();
  }, [chosen.value]);
  if (cell.value.missing.includes("rig"))
    return html`<h1>${t("try-title")}</h1><p><${Shape} is="gap" /> ${t("try-no-rig")}</p>
      <div class="actions"><a class="button primary" href="#/calibrate">${t("step-calibrate")}</a></div>`;
  const targets = isOn.value ? (trial.value?.targets ?? []) : [];
  return html`<h1>${t("try-title")}</h1>
    <p class="lead">${t("try-what")}</p>
    <${Choice} />
    <${Verdict} />
    <${Pair} over=${over} />
    <div class="try-columns">
      ${
        targets.length > 0 &&
        html`<section aria-labelledby="try-measured">
          <h2 id="try-measured">${t("try-measured")}</h2>
          ${targets.map((target, i) => html`<${Pose} key=${i} target=${target} />`)}
          <p class="hint">${t("try-whiskers")}</p>
        </section>`
      }
      <${Still} />
      ${chosen.value && html`<${SigmaMap} />`}
    </div>`;
}
