// The check: whether the calibration in use still holds, by one pair of a known board or part.
import { html, useState } from "../../vendor/ui.js";
import { ask, attempt, glance } from "../shared/api.js";
import { BoardFields, PitchField, SIZE, specOf } from "../shared/board.js";
import { cell, checked, holds, lookAtCheck, sign, token } from "../shared/live.js";
import { Pair } from "../shared/picture.js";
import { NumberField, Shape, say, useKept } from "../shared/pieces.js";
import { inWords, moment, number, sign as signed, t } from "../shared/texts.js";

const SHAPES = { OK: "tick", NOT_OK: "gap", UNDECIDED: "doubt" };

// --- figures between their limits ---

const WIDTH = 480;
const FARTHEST = 6; // limits from the middle; beyond is an arrow at the end
const HALF_MARK = 9; // it hides a shorter bar
const MARKS = {
  OK: (x) => html`<circle cx=${x} cy="20" r="7" />`,
  NOT_OK: (x) => html`<path class="cross" d="M${x - 7} 13l14 14M${x + 7} 13l-14 14" />`,
  UNDECIDED: (x) => html`<path d="M${x} 11l9 17h-18Z" />`,
};

// The band is the tolerance, the bar the uncertainty; verdicts differ by shape, not only by colour.
function Gauge({ value, spread = 0, limit, isTwoSided, verdict, limits, label }) {
  const reach = Math.min(FARTHEST * limit, Math.max(2 * limit, 1.1 * (Math.abs(value) + spread)));
  const low = isTwoSided ? -reach : 0;
  const at = (x) => 24 + ((WIDTH - 48) * (Math.min(reach, Math.max(low, x)) - low)) / (reach - low);
  const isBeyond = Math.abs(value) > reach;
  const tip = value > 0 ? WIDTH - 4 : 4;
  return html`<svg
    class="gauge ${verdict.toLowerCase()}" viewBox="0 0 ${WIDTH} 64" role="img" aria-label=${label}
  >
    <rect
      class="band" x=${at(isTwoSided ? -limit : 0)} y="4" width=${at(limit) - at(isTwoSided ? -limit : 0)}
      height="32"
    />
    <line class="axis" x1="4" x2=${WIDTH - 4} y1="20" y2="20" />
    ${limits.map(
      ([x, text]) => html`<g class="limit">
        <line x1=${at(x)} x2=${at(x)} y1="0" y2="40" /><text x=${at(x)} y="58">${text}</text>
      </g>`,
    )}
    <g class="mark">
      ${
        at(value + spread) - at(value) > HALF_MARK &&
        !isBeyond &&
        html`<path
          class="cross"
          d="M${at(value - spread)} 13v14M${at(value - spread)} 20H${at(value + spread)}M${at(
            value + spread,
          )} 13v14"
        />`
      }
      ${
        isBeyond
          ? html`<path d="M${tip} 20l${value > 0 ? "-16 -10v20" : "16 -10v20"}Z" />`
          : MARKS[verdict](at(value))
      }
    </g>
  </svg>`;
}

function Rows({ measured_px, limit_px, verdict }) {
  const values = { now: number(measured_px, 3), limit: number(limit_px, 1) };
  return html`<h3><${Shape} is=${SHAPES[verdict]} /> ${t("check-rows")}</h3>
    <p>${t("check-rows-now", values)}</p>
    <${Gauge}
      value=${measured_px} limit=${limit_px} verdict=${verdict}
      limits=${[[limit_px, t("check-px", values)]]} label=${t("check-rows-now", values)}
    />`;
}

function Length({
  name,
  true_mm,
  measured_mm,
  error_percent,
  spread_percent,
  limit_percent,
  verdict,
  isBoard,
}) {
  const digits = limit_percent < 0.1 ? 2 : 1;
  const values = {
    error: signed(error_percent, 3),
    spread: number(spread_percent, 3),
    limit: number(limit_percent, digits),
  };
  const limits = [-limit_percent, limit_percent].map((x) => [
    x,
    t("check-percent", { limit: signed(x, digits) }),
  ]);
  return html`<h3>
      <${Shape} is=${SHAPES[verdict]} />${" "}
      ${isBoard ? t("check-diagonal") : html`<span translate=${false}>${name}</span>`}
    </h3>
    <p>${t("check-length-now", values)}</p>
    <p class="muted">
      ${t("check-length-mm", { measured: number(measured_mm, 3), truth: number(true_mm, 3) })}
    </p>
    <${Gauge}
      value=${error_percent} spread=${spread_percent} limit=${limit_percent} isTwoSided=${true}
      verdict=${verdict} limits=${limits} label=${t("check-length-now", values)}
    />`;
}

// --- what to do ---

function Remedy({ verdict, rows, lengths, reason }) {
  if (verdict === "OK") return null;
  if (reason)
    return html`<p>${t("remedy-unseen")}</p>
      <p class="hint" translate=${false} lang="en">${reason}</p>`;
  if (verdict === "UNDECIDED") return html`<p>${t("remedy-undecided")}</p>`;
  return html`${rows.verdict === "NOT_OK" && html`<p>${t("remedy-rows")}</p>`}
    ${
      rows.verdict === "OK" &&
      lengths.some((length) => length.verdict === "NOT_OK") &&
      html`<p>${t("remedy-length")}</p>`
    }
    <div class="actions"><a class="button" href="#/calibrate">${t("step-calibrate")}</a></div>`;
}

function Verdict() {
  const { last, is_current } = checked.value ?? {};
  if (!last) return html`<p class="muted">${t("checked-never")}</p>`;
  const { at, by, board, job, verdict, rows, lengths, remarks } = last;
  return html`<section class="checked" aria-labelledby="checked">
    <h2 id="checked">${t("checked-last")}</h2>
    <p class="big figure">
      <${Shape} is=${is_current ? SHAPES[verdict] : "none"} /> <strong>${inWords("checked", verdict)}</strong>
    </p>
    ${!is_current && html`<p><${Shape} is="doubt" /> ${t("checked-before")}</p>`}
    <p class="muted" translate=${false}>${moment(at)} · ${by} · ${board ?? job}</p>
    <${Remedy} ...${last} />
    ${rows && html`<${Rows} ...${rows} />`}
    ${lengths.map((length) => html`<${Length} key=${length.name} ...${length} isBoard=${board !== null} />`)}
    ${remarks.map((remark) => html`<p class="hint" translate=${false} lang="en">${remark}</p>`)}
  </section>`;
}

// --- what to check by ---

const OTHER = "";
const PART = "part ";

// Measured lengths of a part; the taught size stands beside each, for comparison only.
function Lengths({ part, known, onKnown }) {
  return html`<p class="hint">${t("check-lengths")}</p>
    <div class="row">
      ${part.lengths.map(({ name, taught_mm }) => {
        const label = html`<span translate=${false}>${name}</span>
          ${
            taught_mm !== null &&
            html` <span class="muted">${t("check-taught", { mm: number(taught_mm, 2) })}</span>`
          }`;
        return html`<${NumberField}
          key=${name} label=${label} unit="mm" digits=${3} low=${0.001} high=${100000}
          value=${known[name] ?? null} onValue=${(mm) => onKnown({ ...known, [name]: mm })}
            name=${name} isForm
        />`;
      })}
    </div>`;
}

export default function Check() {
  const known = checked.value?.boards ?? [];
  const parts = (checked.value?.parts ?? []).filter((measured) => measured.lengths.length);
  const [chosen, setChosen] = useKept(`check-by ${cell.value.rig?.id}`, null); // null: the first known
  const [size, setSize] = useKept("check-size", SIZE);
  const [mm, setMm] = useKept("check-mm", null);
  const [lengths, setLengths] = useKept("check-lengths", {});
  const [isMeasuring, setMeasuring] = useState(false);
  const choice = [...known, OTHER, ...parts.map(({ job }) => PART + job)].includes(chosen)
    ? chosen
    : (known[0] ?? OTHER);
  const part = parts.find(({ job }) => choice === PART + job);
  const board = choice === OTHER ? mm && specOf(size, mm) : choice;
  const by = part ? Object.keys(lengths).length > 0 && { job: part.job, lengths } : board && { board };
  const choose = (one) => {
    setChosen(one);
    setLengths({});
  };
  const check = async () => {
    sign();
    setMeasuring(true);
    const last = await attempt(() => ask("POST", "checks", { token: token.value, ...by }));
    setMeasuring(false);
    if (!last) return;
    setChosen(last.board ?? PART + last.job);
    await glance(lookAtCheck);
    say(inWords("checked", last.verdict));
  };
  const head = html`<h1>${t("check-title")}</h1><p class="lead">${t("check-what")}</p>`;
  if (cell.value.missing.includes("rig"))
    return html`${head}<p><${Shape} is="gap" /> ${t("check-no-rig")}</p>
      <div class="actions"><a class="button primary" href="#/calibrate">${t("step-calibrate")}</a></div>`;
  return html`${head}
    <${Pair} />
    <section aria-labelledby="board">
      <h2 id="board">${t("check-by")}</h2>
      ${
        known.length + parts.length > 0 &&
        html`<div class="choices" role="radiogroup" aria-label=${t("check-by")}>
          ${[...known, OTHER, ...parts.map(({ job }) => PART + job)].map(
            (one) => html`<label class="choice" key=${one}>
              <input
                type="radio" name="board" checked=${one === choice} onChange=${() => choose(one)}
              /> ${
                one === OTHER
                  ? t("check-other")
                  : one.startsWith(PART)
                    ? t("check-part", { job: one.slice(PART.length) })
                    : html`<span translate=${false}>${one}</span>`
              }
            </label>`,
          )}
        </div>`
      }
      ${part && html`<${Lengths} part=${part} known=${lengths} onKnown=${setLengths} />`}
      ${
        choice === OTHER &&
        html`<${BoardFields} size=${size} onSize=${setSize} />
          <div class="row">
            <${PitchField} size=${size} mm=${mm} onMm=${setMm} />
          </div>`
      }
      ${!part && html`<p class="hint">${t("check-proof")}</p>`}
      <div class="actions">
        <button class="primary big" disabled=${!holds.value || !by || isMeasuring} onClick=${check}>
          ${t(isMeasuring ? "check-running" : "check-now")}
        </button>
      </div>
      ${!holds.value && html`<p class="hint">${t("check-take")}</p>`}
    </section>
    <${Verdict} />`;
}
