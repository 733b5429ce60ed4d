// A recorded exposure measured with other limits: before, after, and what would have helped.
import { html, useState } from "../../vendor/ui.js";
import { ask, attempt } from "../shared/api.js";
import { offers } from "../shared/live.js";
import { NumberField, Shape, say } from "../shared/pieces.js";
import { dashed, number, t } from "../shared/texts.js";
import { Sigmas } from "./comparison.js";
import { reasonsOf, statusOf } from "./recorded.js";
import { startRegression } from "./regression.js";

// Name, unit, digits, and shown units per unit of the cell (a sigma in µm).
/** @type {[string, string, number, number][]} */
const FIELDS = [
  ["max_sigma_mm", "µm", 1, 1000],
  ["max_rms_px", "px", 2, 1],
  ["min_support", "%", 0, 100],
  ["max_epipolar_px", "px", 2, 1],
  ["radius_tolerance_mm", "mm", 3, 1],
  ["form_tolerance_mm", "mm", 3, 1],
  ["min_score", "%", 0, 100],
  ["contrast", "", 1, 1],
  ["light", "×", 2, 1],
];
const LIMITS = {
  max_sigma_mm: [0.001, 100],
  max_rms_px: [0.01, 100],
  min_support: [0, 1],
  max_epipolar_px: [0.01, 100],
  radius_tolerance_mm: [0.0001, 100],
  form_tolerance_mm: [0.0001, 100],
  min_score: [0.1, 1],
  contrast: [0.1, 255],
  light: [0.1, 10],
};
const field = (name) => FIELDS.find(([one]) => one === name);

function shownAs(name, value) {
  const [, unit, digits, factor] = field(name) ?? ["", "mm", 0, 1];
  return `${number(value * factor, digits)} ${unit}`.trim();
}

// The fields as a request.
function changeOf(typed, without) {
  const { contrast, light, ...limits } = typed;
  return {
    ...(Object.keys(limits).length ? { limits } : {}),
    ...(without.length ? { features: Object.fromEntries(without.map((key) => [key, false])) } : {}),
    ...(contrast === undefined ? {} : { contrast }),
    ...(light === undefined ? {} : { light }),
  };
}

function Verdict({ title, verdict }) {
  return html`<tr>
    <th scope="row">${title}</th>
    <td>${statusOf(verdict.status)}</td>
    <td>${reasonsOf(verdict.reasons) || "–"}</td>
    <td>${verdict.sigma_um ? html`<${Sigmas} of=${verdict.sigma_um} />` : "–"}</td>
  </tr>`;
}

function Remedy({ remedy, onTake, onTest }) {
  const { code, name, before, after, cost, sigma_um, change } = remedy;
  const values = {
    name: name ?? "",
    before: before ? before.map((one) => shownAs(code, one)).join(" – ") : "",
    after: after ? after.map((one) => shownAs(code, one)).join(" – ") : "",
  };
  return html`<li class="tile">
    <h4>${t(`cycles-remedy-${dashed(code)}`, values)}</h4>
    <p><${Shape} is=${cost === "light" ? "tick" : "doubt"} /> ${t(`cycles-cost-${dashed(code)}`)}</p>
    ${sigma_um && html`<p class="muted">${t("cycles-then")} <${Sigmas} of=${sigma_um} /></p>`}
    <div class="actions">
      <button onClick=${onTake}>${t("cycles-take")}</button>
      ${onTest && change.light === null && html`<button onClick=${onTest}>${t("cycles-test-all")}</button>`}
    </div>
  </li>`;
}

export function WhatIf({ document }) {
  const { number: count, limits, now, job, folder, status, reference } = document;
  const [typed, setTyped] = useState({});
  const [without, setWithout] = useState([]);
  const [told, setTold] = useState(null);
  const [helped, setHelped] = useState(null);
  const [isBusy, setBusy] = useState(false);
  const change = changeOf(typed, without);
  const isChanged = Object.keys(change).length > 0;
  const features = now.parts[0]?.features ?? document.taught.parts[0].features;
  const asked = async (body) => {
    setBusy(true);
    const answer = await attempt(() => ask("POST", `cycles/${count}/what-if`, body));
    setBusy(false);
    return answer;
  };
  const measure = async (body) => {
    const answer = await asked(body);
    if (!answer) return;
    setTold(answer);
    say(t("cycles-after-said", { status: t(`cycles-status-${dashed(answer.after.status)}`) }));
  };
  const help = async () => {
    const answer = await asked({});
    if (!answer) return;
    setHelped(answer.helped);
    say(t("cycles-helped-said", { count: answer.helped.length }));
  };
  const take = (remedy) => {
    const { limits: wanted, features: left, contrast, light } = remedy.change;
    const set = Object.fromEntries(Object.entries(wanted).filter(([, value]) => value !== null));
    const next = { ...set, ...(contrast === null ? {} : { contrast }), ...(light === null ? {} : { light }) };
    setTyped(next);
    setWithout(Object.keys(left));
    measure(changeOf(next, Object.keys(left)));
  };
  const test = (wanted) => {
    const { light, ...rest } = wanted;
    startRegression({ change: { job: folder, ...rest } });
  };
  const plain = (remedy) => {
    const { limits: wanted, features: left, contrast } = remedy.change;
    const set = Object.fromEntries(Object.entries(wanted).filter(([, value]) => value !== null));
    return { limits: set, features: left, ...(contrast === null ? {} : { contrast }) };
  };
  const mayTest = folder && offers("regressions");
  const put = (name, factor) => (value) => {
    const [low, high] = LIMITS[name];
    setTyped({ ...typed, [name]: Math.min(Math.max(value / factor, low), high) });
  };
  return html`<h3>${t("cycles-if")}</h3>
    <p class="hint">${t("cycles-if-what", { job })}</p>
    ${
      status !== "OK" &&
      html`<div class="actions">
        <button class="primary" disabled=${isBusy} onClick=${help}>
          ${t(isBusy ? "cycles-measuring" : "cycles-help")}
        </button>
      </div>`
    }
    ${helped && !helped.length && html`<p><${Shape} is="none" /> ${t("cycles-helped-none")}</p>`}
    ${
      helped?.length > 0 &&
      html`<ul class="tiles">
        ${helped.map(
          (remedy) => html`<${Remedy}
            key=${`${remedy.code} ${remedy.name}`} remedy=${remedy} onTake=${() => take(remedy)}
            onTest=${mayTest && (() => test(plain(remedy)))}
          />`,
        )}
      </ul>`
    }
    <details>
      <summary>${t("cycles-if-form")}</summary>
      <div class="row">
        ${FIELDS.filter(([name]) => name === "light" || (limits?.[name] ?? null) !== null).map(
          ([name, unit, digits, factor]) => html`<${NumberField}
            key=${name} name=${name} label=${t(`cycles-limit-${dashed(name)}`)} unit=${unit}
            digits=${digits} value=${factor * (typed[name] ?? (name === "light" ? 1 : limits[name]))}
            low=${factor * LIMITS[name][0]} high=${factor * LIMITS[name][1]} onValue=${put(name, factor)}
          />`,
        )}
      </div>
      <fieldset class="choices">
        <legend>${t("cycles-if-features")}</legend>
        ${features.map(
          ({ key }) => html`<label class="choice" key=${key}>
            <input
              type="checkbox" checked=${!without.includes(key)} disabled=${key === reference}
              onChange=${(event) =>
                setWithout(
                  event.currentTarget.checked ? without.filter((one) => one !== key) : [...without, key],
                )}
            /> <span translate=${false}>${key}</span>
          </label>`,
        )}
      </fieldset>
      <div class="actions">
        <button class="primary" disabled=${!isChanged || isBusy} onClick=${() => measure(change)}>
          ${t(isBusy ? "cycles-measuring" : "cycles-measure")}
        </button>
        <button
          disabled=${!isChanged}
          onClick=${() => {
            setTyped({});
            setWithout([]);
            setTold(null);
          }}
        >
          ${t("cycles-reset")}
        </button>
        ${
          mayTest &&
          html`<button
            disabled=${!isChanged || (Object.keys(change).length === 1 && "light" in change)}
            onClick=${() => test(change)}
          >
            ${t("cycles-test-all")}
          </button>`
        }
      </div>
      ${"light" in change && html`<p class="hint">${t("cycles-light-hint")}</p>`}
    </details>
    ${
      told &&
      html`<div class="scroll wide" tabindex="0" role="region" aria-label=${t("cycles-if")}>
        <table>
          <thead>
            <tr>
              <td></td><th scope="col">${t("cycles-result")}</th><th scope="col">${t("cycles-reasons")}</th>
              <th scope="col">${t("cycles-sigmas")}</th>
            </tr>
          </thead>
          <tbody>
            <${Verdict} title=${t("cycles-before")} verdict=${told.before} />
            <${Verdict} title=${t("cycles-after")} verdict=${told.after} />
          </tbody>
        </table>
      </div>`
    }`;
}
