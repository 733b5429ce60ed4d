// Reference marks: whether they correct this cell, a look at them in one pair, and teaching them.
import { html, useState } from "../../vendor/ui.js";
import { ask, attempt, glance } from "../shared/api.js";
import { cell, holds, rawSize, sign, token, useFresh, useTask } from "../shared/live.js";
import { Pair } from "../shared/picture.js";
import { Failed, Shape, say, Underway } from "../shared/pieces.js";
import { inWords, moment, number, t } from "../shared/texts.js";

const RING_SHARE = 0.02; // radius of a ring, of the picture's width
const KINDS = { good: "tick", wrong: "gap", gone: "none" };

// seen: in one picture, or in either.
const kindOf = ({ excluded }, { code }, seen) => (excluded.includes(code) ? "wrong" : seen ? "good" : "gone");
const shapeOf = ({ state, valid }) => (state === "CORRECTED" ? "tick" : valid ? "doubt" : "gap");
const off = (now, was) => (now ? `${number(Math.hypot(now[0] - was[0], now[1] - was[1]), 2)} px` : "–");

// Where each mark was taught, dashed, and where it is; one that disagrees is crossed.
const over = (look) => (side) => {
  if (!look) return null;
  const { width } = rawSize(side);
  const r = RING_SHARE * width;
  const isRight = (x) => x > 0.9 * width; // a code beyond the picture is not seen
  return html`<g class="rings">
    ${look.marks.map((mark) => {
      const [was, now] = [mark[`was_${side}`], mark[side]];
      const [x, y] = now ?? was;
      const kind = kindOf(look, mark, now);
      return html`<g key=${mark.code} class=${kind}>
        <circle class="under" cx=${x + 0.5} cy=${y + 0.5} r=${r} />
        <circle class="line" cx=${x + 0.5} cy=${y + 0.5} r=${r} />
        ${
          kind === "wrong" &&
          html`<path
            class="line"
            d="M${x - r} ${y - r}l${2 * r} ${2 * r}m0 ${-2 * r}l${-2 * r} ${2 * r}"
          />`
        }
        ${now && html`<path class="line" d="M${was[0] + 0.5} ${was[1] + 0.5}L${x + 0.5} ${y + 0.5}" />`}
        <text
          x=${x + (isRight(x) ? -1.2 : 1.2) * r} y=${y - 0.8 * r} font-size=${1.4 * r}
          text-anchor=${isRight(x) ? "end" : "start"}
        >
          ${mark.code}
        </text>
      </g>`;
    })}
  </g>`;
};

function Looked({ look }) {
  const counted = look.marks.filter((mark) => kindOf(look, mark, mark.left ?? mark.right) === "good").length;
  const moved = { left: number(1e3 * look.left_mm, 0), right: number(1e3 * look.right_mm, 0) };
  return html`<p class="big figure" role="status">
      <${Shape} is=${shapeOf(look)} /> <strong>${inWords("marks-state", look.state)}</strong>
    </p>
    <p>
      ${t(look.valid ? "marks-results" : "marks-no-results")}${" "}
      ${t("marks-seen", { seen: counted, taught: look.taught })}${" "}
      ${counted > 0 && t("marks-moved", moved)}
    </p>
    ${look.state !== "CORRECTED" && html`<p>${inWords("marks-remedy", look.state)}</p>`}
    ${look.state !== "COASTING" && html`<p class="hint" translate=${false} lang="en">${look.text}</p>`}
    <div class="scroll">
      <table class="marks">
        <thead>
          <tr>
            <th>${t("marks-mark")}</th><th>${t("left")}</th><th>${t("right")}</th><td></td>
          </tr>
        </thead>
        <tbody>
          ${look.marks.map((mark) => {
            const kind = kindOf(look, mark, mark.left ?? mark.right);
            return html`<tr key=${mark.code}>
              <td>${mark.code}</td>
              <td>${off(mark.left, mark.was_left)}</td>
              <td>${off(mark.right, mark.was_right)}</td>
              <td><${Shape} is=${KINDS[kind]} /> ${t(`marks-is-${kind}`)}</td>
            </tr>`;
          })}
        </tbody>
      </table>
    </div>`;
}

function Teaching({ exposures, onTaught }) {
  const [id, setId] = useState(null);
  const [failed, setFailed] = useState(null);
  const begin = () =>
    attempt(async () => {
      sign();
      setFailed(null);
      setId((await ask("POST", "marks/teach", { token: token.value })).task);
    });
  const state = useTask(id, async (ended) => {
    setId(null);
    if (ended.state !== "done") setFailed(ended);
    else if (await onTaught()) say(t("marks-taught"));
  });
  return html`<section aria-labelledby="marks-teach">
    <h2 id="marks-teach">${t("marks-teach")}</h2>
    <ol>
      <li>${t("marks-step-plate")}</li>
      <li>${t("marks-step-fresh")}</li>
      <li>${t("marks-step-still", { count: exposures })}</li>
    </ol>
    <div class="actions">
      <button class="big" disabled=${!holds.value || Boolean(id)} onClick=${begin}>
        ${t("marks-teach-now", { count: exposures })}
      </button>
    </div>
    ${id && html`<${Underway} text=${t("marks-teaching")} state=${state} />`}
    ${failed && html`<${Failed} text=${t("marks-failed")} ended=${failed} />`}
  </section>`;
}

export default function Marks() {
  const [known, setKnown] = useState(null);
  const [look, setLook] = useState(null);
  const find = () =>
    glance(async () => {
      const found = await ask("GET", "marks");
      setKnown(found);
      return found;
    });
  useFresh(find);
  const lookNow = async () => {
    sign();
    const found = await attempt(() => ask("POST", "marks/look", { token: token.value }));
    if (!found) return;
    setLook(found);
    say(inWords("marks-state", found.state));
  };
  const head = html`<h1>${t("marks-title")}</h1><p class="lead">${t("marks-what")}</p>`;
  if (cell.value.missing.includes("rig"))
    return html`${head}<p><${Shape} is="gap" /> ${t("marks-no-rig")}</p>
      <div class="actions"><a class="button primary" href="#/calibrate">${t("step-calibrate")}</a></div>`;
  const last = known?.last;
  const sigma = last && ["x", "y", "z"].map((axis) => number(last.sigma_um[axis], 1));
  return html`${head}
    <${Pair} over=${over(look)} />
    <section aria-labelledby="marks-now">
      <h2 id="marks-now">${t("marks-now")}</h2>
      ${
        known &&
        !look &&
        html`<p>
          <${Shape} is=${known.in_use ? "tick" : "none"} />${" "}
          ${t(known.in_use ? "marks-in-use" : "marks-none")}
        </p>`
      }
      ${
        last &&
        html`<p class="muted">
          ${t("marks-last", { count: last.codes.length, x: sigma[0], y: sigma[1], z: sigma[2] })}${" "}
          <span translate=${false}>${moment(last.at)} · ${last.by}</span>
        </p>`
      }
      <div class="actions">
        <button class="primary big" disabled=${!holds.value || !known?.in_use} onClick=${lookNow}>
          ${t("marks-look")}
        </button>
      </div>
      ${!holds.value && html`<p class="hint">${t("marks-take")}</p>`}
      ${look && html`<${Looked} look=${look} />`}
    </section>
    <${Teaching}
      exposures=${known?.exposures ?? 0}
      onTaught=${() => {
        setLook(null);
        return find();
      }}
    />`;
}
