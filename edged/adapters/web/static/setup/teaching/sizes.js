// The job's other settings: published point, gripping point, judged sizes, name and number.
import { html, useEffect, useState } from "../../vendor/ui.js";
import { mayTake } from "../shared/live.js";
import { NumberField, Shape } from "../shared/pieces.js";
import { number, t } from "../shared/texts.js";
import { tool } from "./region.js";
import { change, teaching } from "./teaching.js";

const MM = ["x_mm", "y_mm", "z_mm"];

// A gripping point without its place in the pictures.
const stays = ({ left, right, ...rest }) => rest;

// Chosen by a tap in the left picture: the middle of the feature there.
function ByTap({ name, is }) {
  return html`<button
    aria-pressed=${tool.value === name} disabled=${!mayTake.value}
    onClick=${() => (tool.value = tool.value === name ? "choose" : name)}
  >
    ${t(is)}
  </button>`;
}

export function Reference() {
  const { reference, gripping, features } = teaching.value;
  const places = features.filter(({ taken, kind }) => taken && kind !== "edge");
  const grip = (values) => change("PUT", "", { gripping: values });
  return html`<section aria-labelledby="teach-reference">
    <h2 id="teach-reference">${t("teach-reference")}</h2>
    <p class="hint">${t("teach-reference-what")}</p>
    <div class="actions">
      <${ByTap} name="reference" is="teach-reference-tap" />
      ${
        places.length > 0 &&
        html`<label class="field">
          <span>${t("teach-reference-feature")}</span>
          <select
            disabled=${!mayTake.value}
            onChange=${({ currentTarget }) => change("PUT", "", { reference: currentTarget.value })}
          >
            ${places.map(
              ({ key }) => html`<option
                key=${key} value=${key} translate=${false} selected=${reference?.key === key}
              >
                ${key}
              </option>`,
            )}
          </select>
        </label>`
      }
    </div>
    <h3>${t("teach-gripping")}</h3>
    <p class="hint">${t("teach-gripping-what")}</p>
    ${
      gripping
        ? html`<div class="row">
            ${MM.map(
              (name) => html`<${NumberField}
                key=${name} name="grip-${name[0]}" label=${name[0].toUpperCase()} unit="mm" digits=${3}
                low=${-1000} high=${1000} value=${gripping[name]} disabled=${!mayTake.value}
                onValue=${(value) => grip({ ...stays(gripping), [name]: value })}
              />`,
            )}
          </div>
          <div class="actions">
            <${ByTap} name="gripping" is="teach-gripping-tap" />
            <button disabled=${!mayTake.value} onClick=${() => grip(null)}>
              ${t("teach-gripping-none")}
            </button>
          </div>`
        : html`<div class="actions">
          <${ByTap} name="gripping" is="teach-gripping-tap" />
          <button disabled=${!mayTake.value} onClick=${() => grip({ x_mm: 0, y_mm: 0, z_mm: 0 })}>
            ${t("teach-gripping-type")}
          </button>
        </div>`
    }
  </section>`;
}

// Kinds of size by the features they are taken of.
const ENDS = ["circle", "slot", "corner", "edge"];
const ALONE = { circle: ["radius"], slot: ["width", "length"], corner: [], edge: [] };
function kindsOf(first, second) {
  if (!first) return [];
  if (!second) return ALONE[first.kind] ?? [];
  const both = [first.kind, second.kind];
  const isBoth = (...kinds) => both.every((kind) => kinds.includes(kind));
  return [
    ...(isBoth(...ENDS) ? ["distance"] : []),
    ...(isBoth("edge", "slot") ? ["angle"] : []),
    ...(isBoth("circle") ? ["height"] : []),
  ];
}

const stated = ({ key, kind, of, nominal, tolerance }) => ({
  ...(key ? { key } : {}),
  kind,
  of,
  nominal: nominal ?? null,
  tolerance: tolerance ?? null,
});
const put = (sizes) => change("PUT", "", { sizes: sizes.map(stated) });

export function Sizes() {
  const { sizes, features } = teaching.value;
  const taken = features.filter((feature) => feature.taken);
  const [first, setFirst] = useState("");
  const [second, setSecond] = useState("");
  const [kind, setKind] = useState("");
  const from = taken.find(({ key }) => key === first) ?? taken[0];
  const to = taken.find(({ key }) => key === second && key !== from?.key);
  const kinds = kindsOf(from, to);
  const chosen = kinds.includes(kind) ? kind : kinds[0];
  const add = () => put([...sizes, { kind: chosen, of: [from.key, ...(to ? [to.key] : [])] }]);
  const pick = (id, name, value, onValue, options) =>
    html`<label class="field">
      <span>${t(id)}</span>
      <select
        name=${name} disabled=${!mayTake.value}
        onChange=${({ currentTarget }) => onValue(currentTarget.value)}
      >
        ${options.map(
          ([one, text, isData]) => html`<option
            key=${one} value=${one} translate=${isData ? false : undefined} selected=${one === value}
          >
            ${text}
          </option>`,
        )}
      </select>
    </label>`;
  const keys = taken.map(({ key }) => [key, key, true]);
  return html`<section aria-labelledby="teach-sizes">
    <h2 id="teach-sizes">${t("teach-sizes")}</h2>
    <p class="hint">${t("teach-sizes-what")}</p>
    <ul class="list">
      ${sizes.map(
        (one, i) => html`<${Size}
          key=${one.key ?? i} ...${one}
          onChange=${(values) => put(sizes.map((old, n) => (n === i ? { ...old, ...values } : old)))}
          onRemove=${() => put(sizes.filter((_, n) => n !== i))}
        />`,
      )}
    </ul>
    ${
      from &&
      html`<div class="row">
          ${pick("teach-size-of", "size-of", from.key, setFirst, keys)}${" "}
          ${pick("teach-size-to", "size-to", to?.key ?? "", setSecond, [
            ["", t("teach-size-alone")],
            ...keys,
          ])}
          ${pick(
            "teach-size-kind",
            "size-kind",
            chosen,
            setKind,
            kinds.map((one) => [one, t(`teach-measure-${one}`)]),
          )}
        </div>
        <div class="actions">
          <button disabled=${!mayTake.value || !chosen} onClick=${add}>${t("teach-size-add")}</button>
        </div>`
    }
  </section>`;
}

function Size({ of, kind, unit, nominal, tolerance, measured, sigma, witness, ok, onChange, onRemove }) {
  const name = of.join(" – ");
  const isAngle = unit === "deg";
  const spread = Number.isFinite(sigma)
    ? isAngle
      ? `± ${number(sigma, 3)}°`
      : `± ${number(1000 * sigma, 1)} µm`
    : "";
  return html`<li class="size">
    <p>
      <strong translate=${false}>${name}</strong> ${t(`teach-measure-${kind}`)}${" "}
      <span class="figures nowrap" translate=${false}>
        ${number(measured, 3)} ${isAngle ? "°" : "mm"}
      </span> <span class="nowrap" translate=${false}>${spread}</span>
      ${
        ok !== null &&
        html`${" "}<span class=${ok ? "" : "wrong"}>
            <${Shape} is=${ok ? "tick" : "gap"} /> ${t(ok ? "teach-size-good" : "teach-size-bad")}
          </span>`
      }
    </p>
    ${
      witness
        ? html`<p class="hint">${t("teach-size-witness")}</p>`
        : html`<div class="row">
            <${NumberField}
              name="nominal" label=${t("teach-nominal")} unit=${isAngle ? "°" : "mm"} digits=${3} low=${0}
              high=${10000} value=${nominal} disabled=${!mayTake.value}
              onValue=${(value) => onChange({ nominal: value })}
            />
            <${NumberField}
              name="tolerance" label=${t("teach-tolerance")} unit=${isAngle ? "°" : "mm"} digits=${3}
              low=${0.0001} high=${1000} value=${tolerance} disabled=${!mayTake.value}
              onValue=${(value) => onChange({ tolerance: value })}
            />
          </div>
          <button
            class="quiet" disabled=${!mayTake.value} aria-label=${t("teach-size-remove", { name })}
            onClick=${onRemove}
          >
            ${t("teach-remove")}
          </button>`
    }
  </li>`;
}

const END = { columns: "row_end_mm", rows: "column_end_mm" };
const TITLE = { first_mm: "first", row_end_mm: "row-end", column_end_mm: "column-end" };

// Pockets of a tray, as the job's file has them. Layers stay as they are.
export function Tray() {
  const { tray } = teaching.value;
  const wish = (values) => change("PUT", "", { tray: values });
  const count = (what, value, along) => {
    const end = tray[END[what]] ?? tray.first_mm.map((x, i) => x + (i === along ? 40 * (value - 1) : 0));
    wish({ ...tray, [what]: value, [END[what]]: value > 1 ? end : null });
  };
  const whole = (what, along) => html`<${NumberField}
    name="tray-${what}" label=${t(`teach-tray-${what}`)} digits=${0} low=${1} high=${64} value=${tray[what]}
    disabled=${!mayTake.value} onValue=${(value) => count(what, Math.round(value), along)}
  />`;
  const place = (name) =>
    tray[name] &&
    html`<fieldset class="row">
      <legend>${t(`teach-tray-${TITLE[name]}`)}</legend>
      ${tray[name].map(
        (mm, i) => html`<${NumberField}
          key=${i} name="tray-${TITLE[name]}-${"xyz"[i]}" label=${"XYZ"[i]} unit="mm" digits=${3}
          low=${-10000} high=${10000} value=${mm} disabled=${!mayTake.value}
          onValue=${(value) => wish({ ...tray, [name]: tray[name].map((x, n) => (n === i ? value : x)) })}
        />`,
      )}
    </fieldset>`;
  const first = { first_mm: [0, 0, 0], columns: 2, row_end_mm: [40, 0, 0], tolerance_mm: 10 };
  return html`<section aria-labelledby="teach-tray">
    <h2 id="teach-tray">${t("teach-tray")}</h2>
    <p class="hint">${t("teach-tray-what")}</p>
    ${
      tray &&
      html`<div class="row">
          ${whole("columns", 0)} ${whole("rows", 1)}
          <${NumberField}
            name="tray-tolerance" label=${t("teach-tray-tolerance")} unit="mm" digits=${1} low=${0.1}
            high=${1000} value=${tray.tolerance_mm} disabled=${!mayTake.value}
            onValue=${(value) => wish({ ...tray, tolerance_mm: value })}
          />
        </div>
        ${place("first_mm")} ${place("row_end_mm")} ${place("column_end_mm")}`
    }
    <div class="actions">
      <button disabled=${!mayTake.value} onClick=${() => wish(tray ? "none" : first)}>
        ${t(tray ? "teach-tray-none" : "teach-tray-type")}
      </button>
    </div>
  </section>`;
}

export function Naming() {
  const { name, number: count } = teaching.value;
  const [typed, setTyped] = useState(name);
  useEffect(() => setTyped(name), [name]);
  const isWrong = !/^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$/.test(typed);
  const end = () => !isWrong && typed !== name && change("PUT", "", { name: typed });
  return html`<div class="row">
    <label class="field">
      <span>${t("teach-name")}</span>
      <input
        name="job" maxlength="64" value=${typed} aria-invalid=${isWrong} disabled=${!mayTake.value}
        onInput=${(event) => setTyped(event.currentTarget.value)} onBlur=${end}
        onKeyDown=${(event) => event.key === "Enter" && end()}
      />
      ${
        isWrong &&
        html`<span class="wrong" role="alert">
          <${Shape} is="doubt" /> ${t("teach-name-wrong")}
        </span>`
      }
    </label>
    <${NumberField}
      name="number" label=${t("teach-number")} unit="" digits=${0} low=${1} high=${65535} value=${count}
      disabled=${!mayTake.value} onValue=${(value) => change("PUT", "", { number: Math.round(value) })}
    />
  </div>`;
}
