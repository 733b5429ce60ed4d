// A study of a size: people lay parts in as the page says, and the cell measures one after another.
import { html, useState } from "../../vendor/ui.js";
import { ask, attempt, glance } from "../shared/api.js";
import { checked, holds, sign, token, useFresh } from "../shared/live.js";
import { Dialog, NumberField, Shape, say, useKept, useMainAction } from "../shared/pieces.js";
import { number, t } from "../shared/texts.js";

export const signs = (text) => text.replaceAll(/\bum\b/g, "µm").replaceAll(/\bchi2\b/g, "χ²");
export const verdictOf = (good) => (good === null ? "doubt" : good ? "tick" : "gap");
export const Figures = ({ figures }) => html`<dl class="figures" translate=${false} lang="en">
  ${Object.entries(figures).map(([what, value]) => html`<dt>${signs(what)}</dt><dd>${signs(value)}</dd>`)}
</dl>`;

const MM = [0.001, 100_000];
const FIELDS = {
  master: { low_mm: MM, high_mm: MM, reference_mm: MM, trials: [25, 100] },
  parts: { low_mm: MM, high_mm: MM, parts: [5, 100], people: [2, 100], trials: [2, 100] },
};
const FIRST = { master: { trials: 25 }, parts: { parts: 10, people: 3, trials: 3 } };

const Select = ({ label, name, options, chosen, onChoose, wording }) => html`<label class="field">
  <span>${label}</span>
  <select
    name=${name} translate=${Boolean(wording)}
    onChange=${({ currentTarget }) => onChoose(currentTarget.value)}
  >
    ${options.map(
      (value) => html`<option key=${value} value=${value} selected=${value === chosen}>
        ${wording ? wording(value) : value}
      </option>`,
    )}
  </select>
</label>`;

function Plan({ job, isBusy, onBegin }) {
  const [kind, setKind] = useKept("study-kind", "master");
  const [typed, setTyped] = useKept("study", FIRST);
  const [chosen, setSize] = useKept("study-size", "");
  const part = checked.value?.parts.find((offered) => offered.job === job);
  const sizes = (part?.lengths ?? []).map(({ name }) => name);
  const size = sizes.includes(chosen) ? chosen : sizes[0];
  const fields = Object.entries(FIELDS[kind]);
  const given = typed[kind];
  const plan = { job, size, ...Object.fromEntries(fields.map(([name]) => [name, given[name]])) };
  return html`<div class="row">
      <${Select}
        label=${t("accept-study-size")} name="size" options=${sizes} chosen=${size} onChoose=${setSize}
      />
      <${Select}
        label=${t("accept-study-kind")} name="kind" options=${Object.keys(FIELDS)} chosen=${kind}
        onChoose=${setKind} wording=${(value) => t(`accept-study-of-${value}`)}
      />
      ${fields.map(([name, [low, high]]) => {
        const [, unit] = /_(mm)$/.exec(name) ?? [];
        return html`<${NumberField}
          key=${`${kind} ${name}`} label=${t(`accept-study-${name}`)} unit=${unit} digits=${unit ? 4 : 0}
          low=${low} high=${high} value=${given[name]} name=${name} isForm
          onValue=${(value) => setTyped({ ...typed, [kind]: { ...given, [name]: value } })}
        />`;
      })}
    </div>
    <div class="actions">
      <button
        disabled=${!holds.value || isBusy || !Object.values(plan).every(Boolean)}
        onClick=${() => onBegin({ plan })}
      >
        ${t("accept-study-begin")}
      </button>
    </div>`;
}

const Planned = ({ plan }) => html`<p class="muted figure" translate=${false}>
  ${plan.job} · ${plan.size} · ${number(plan.low_mm, 4)} … ${number(plan.high_mm, 4)} mm${
    plan.reference_mm !== null && ` · = ${number(plan.reference_mm, 4)} mm`
  }
</p>`;

function Running({ study, canMeasure, measure, onBack }) {
  const { plan, needed, values_mm: values, next, is_current: isCurrent } = study;
  const taken = values.length;
  return html`<p>
      ${plan.reference_mm === null ? t("accept-study-lay", next) : t("accept-study-lay-master")}
    </p>
    ${!isCurrent && html`<p><${Shape} is="doubt" /> ${t("accept-study-other")}</p>`}
    <label class="meter">
      <span class="figure">
        ${t("accept-taken", { taken, needed })}${
          taken > 0 && ` · ${t("accept-study-last", { mm: number(values.at(-1), 4) })}`
        }
      </span>
      <progress max=${needed} value=${taken}></progress>
    </label>
    <div class="actions">
      <button class="primary big" disabled=${!canMeasure} onClick=${measure}>
        ${t("accept-study-measure")}
      </button>
      ${
        taken > 0 &&
        html`<button disabled=${!canMeasure} onClick=${onBack}>${t("accept-study-back")}</button>`
      }
    </div>`;
}

const Found = ({ study: { good, figures } }) => html`<p class="big figure">
    <${Shape} is=${verdictOf(good)} />${" "}
    <strong>${t(`accept-study-is-${good === null ? "open" : good ? "good" : "bad"}`)}</strong>
  </p>
  <${Figures} figures=${figures} />
  <div class="actions">
    <a class="button" href="/api/v1/acceptance/study/report" target="_blank">${t("accept-report")}</a>
  </div>`;

export function Study({ job }) {
  const [study, setStudy] = useState(null);
  const [isBusy, setBusy] = useState(false);
  const [isEnding, setEnding] = useState(false);
  const find = () => glance(async () => setStudy(await ask("GET", "acceptance/study")));
  useFresh(find);
  const change = async (path, body) => {
    sign();
    setBusy(true);
    const place = `acceptance/study${path}`;
    const found = await attempt(() => ask("POST", place, { token: token.value, ...body }));
    setBusy(false);
    setEnding(false);
    if (!found) return find(); // it may be another by now
    say(t("accept-taken", { taken: found.values_mm.length, needed: found.needed }));
    return setStudy(found);
  };
  const done = study?.values_mm.length;
  const canMeasure = Boolean(holds.value && study?.next && study.is_current && !isBusy);
  const measure = () => change("/measure", { done });
  useMainAction(canMeasure && t("accept-study-measure"), measure);
  const title = t("accept-study");
  return html`<section aria-labelledby="accept-study">
    <h2 id="accept-study">${title}</h2>
    <p>${t("accept-study-how")}</p>
    ${study?.plan && html`<${Planned} plan=${study.plan} />`}
    ${
      study &&
      !study.plan &&
      html`<${Plan} job=${job} isBusy=${isBusy} onBegin=${(body) => change("", body)} />`
    }
    ${
      study?.next &&
      html`<${Running}
        study=${study} canMeasure=${canMeasure} measure=${measure} onBack=${() => change("/back", { done })}
      />`
    }
    ${study?.plan && !study.next && html`<${Found} study=${study} />`}
    ${
      study?.plan &&
      html`<div class="actions">
        <button disabled=${!holds.value || isBusy} onClick=${() => setEnding(true)}>
          ${t("accept-study-end")}
        </button>
      </div>`
    }
    <${Dialog} title=${title} isOpen=${isEnding} onClose=${() => setEnding(false)}>
      <p>${t("accept-study-sure", { taken: done })}</p>
      <div class="actions">
        <button onClick=${() => setEnding(false)}>${t("back")}</button>
        <button class="primary" onClick=${() => change("/end", {})}>${t("accept-study-end")}</button>
      </div>
    <//>
  </section>`;
}
