// What else the configuration can say: each setting as its schema has it, chosen here, tried at once.
import { html, useState } from "../../vendor/ui.js";
import { ask, attempt, glance } from "../shared/api.js";
import { holds, mayTake, token, useFresh } from "../shared/live.js";
import { Shape, say } from "../shared/pieces.js";
import { number, parseNumber, t } from "../shared/texts.js";

const GROUPS = ["cycle", "cameras", "drift", "modbus", "opcua", "recorder", "zenoh"];
const MODE = "cameras.trigger.mode";
const LETTERS = 200;
const DIGITS = 6;

// As people write it, without zeros behind.
const written = (value) =>
  typeof value === "number" ? number(value, DIGITS).replace(/[.,]?0+$/, "") || "0" : (value ?? "");

function Choice({ setting, value, onValue }) {
  const { kind, options, can_be_left_out: isOptional } = setting;
  const offered = kind === "yes_no" ? [true, false] : options;
  const word = (one) => (kind === "yes_no" ? t(one ? "settings-yes" : "settings-no") : one);
  return html`<select
    name=${setting.name} value=${String(value)}
    onChange=${({ currentTarget }) =>
      onValue([...offered, null].find((one) => String(one) === currentTarget.value))}
  >
    ${isOptional && html`<option value="null" selected=${value === null}>${t("settings-left-out")}</option>`}
    ${offered.map(
      (one) => html`<option
        key=${one} value=${String(one)} selected=${one === value}
        translate=${kind === "choice" ? false : undefined}
      >
        ${word(one)}
      </option>`,
    )}
  </select>`;
}

// What is typed counts when it is a value; until then it stays, and is marked.
function Typed({ setting, value, onValue, onWrong }) {
  const { kind, low, high, can_be_left_out: isOptional } = setting;
  const [typed, setTyped] = useState(null);
  const read = (text) => {
    if (kind === "text") return text;
    if (!text.trim()) return isOptional ? null : undefined;
    const parsed = parseNumber(text.replace(/\s/g, ""));
    const isGood = parsed >= (low ?? -Infinity) && parsed <= (high ?? Infinity);
    return isGood && (kind === "number" || Number.isInteger(parsed)) ? parsed : undefined;
  };
  const isWrong = typed !== null && read(typed) === undefined;
  const type = ({ currentTarget }) => {
    const found = read(currentTarget.value);
    setTyped(currentTarget.value);
    onWrong(setting.name, found === undefined);
    if (found !== undefined) onValue(found);
  };
  return html`<input
      name=${setting.name} autocomplete="off" maxlength=${LETTERS}
      inputmode=${kind === "text" ? "text" : "decimal"}
      placeholder=${isOptional ? t("settings-left-out") : ""}
      value=${typed ?? written(value)} aria-invalid=${isWrong}
      onInput=${type} onBlur=${() => !isWrong && setTyped(null)}
    />
    ${
      isWrong && html`<span class="wrong" role="alert"><${Shape} is="doubt" /> ${t("settings-wrong")}</span>`
    }`;
}

function Setting({ setting, value: entered, isChosen, onValue, onWrong }) {
  const { name, kind, help, configured } = setting;
  const Entry = kind === "yes_no" || kind === "choice" ? Choice : Typed;
  const back =
    kind === "yes_no" && configured !== null
      ? t(configured ? "settings-yes" : "settings-no")
      : written(configured);
  const value = back === "" ? t("settings-left-out") : back;
  return html`<div class="setting">
    <label class="field">
      <span translate=${false}>${name}</span>
      <${Entry} key=${isChosen} setting=${setting} value=${entered} onValue=${onValue} onWrong=${onWrong} />
    </label>
    <p class="hint" lang="en" translate=${false}>${help.replaceAll("`", "")}</p>
    ${
      isChosen &&
      html`<p>
        <${Shape} is="hand" /> ${t("settings-chosen")}${" "}
        <button
          type="button" aria-label=${t("settings-back-name", { value, name })}
          onClick=${() => onValue(configured)}
        >
          ${t("settings-back", { value })}
        </button>
      </p>`
    }
  </div>`;
}

export default function Settings() {
  const [known, setKnown] = useState(null);
  const [wanted, setWanted] = useState(null); // by name: what is other than configured
  const [wrong, setWrong] = useState(/** @type {string[]} */ ([]));
  const [isTrying, setTrying] = useState(false);
  const chosenIn = ({ settings }) =>
    Object.fromEntries(settings.filter(({ chosen }) => chosen).map(({ name, value }) => [name, value]));
  const take = (found) => {
    setKnown(found);
    setWanted(chosenIn(found));
    setWrong([]);
  };
  useFresh(() => glance(async () => take(await ask("GET", "settings"))));
  const head = html`<h1>${t("nav-settings")}</h1><p class="lead">${t("settings-what")}</p>`;
  if (!known) return head;
  const { settings: all, not_here: reasons } = known;
  const inForce = ({ name, configured }) => (name in wanted ? wanted[name] : configured);
  const mode = inForce(all.find(({ name }) => name === MODE) ?? {});
  const shown = all.filter(({ name, modes }) => name === MODE || !modes.length || modes.includes(mode));
  const isShown = (name) => shown.some((one) => one.name === name);
  const set = (setting) => (value) => {
    const { [setting.name]: _, ...others } = wanted;
    setWanted(value === setting.configured ? others : { ...others, [setting.name]: value });
  };
  const mark = (name, isWrong) =>
    setWrong((before) => [...before.filter((one) => one !== name), ...(isWrong ? [name] : [])]);
  // what belongs to another trigger mode goes with it
  const sent = Object.fromEntries(
    Object.entries(wanted).filter(([name]) => isShown(name) || !all.some((one) => one.name === name)),
  );
  const isOther =
    JSON.stringify(Object.entries(sent).sort()) !== JSON.stringify(Object.entries(chosenIn(known)).sort());
  const submit = async (event) => {
    event.preventDefault();
    setTrying(true);
    const found = await attempt(() => ask("PUT", "settings", { token: token.value, chosen: sent }));
    setTrying(false);
    if (!found) return;
    take(found);
    say(t("settings-saved"));
  };
  return html`${head}
    <form onSubmit=${submit}>
      <fieldset disabled=${!mayTake.value}>
        ${GROUPS.filter((group) => shown.some(({ name }) => name.startsWith(`${group}.`))).map(
          (group) => html`<details key=${group} open=${group === "cycle" || group === "cameras"}>
            <summary>${t(`settings-in-${group}`)}</summary>
            <div class="settings">
              ${shown
                .filter(({ name }) => name.startsWith(`${group}.`))
                .map(
                  (setting) => html`<${Setting}
                    key=${setting.name} setting=${setting} value=${inForce(setting)}
                    isChosen=${setting.name in wanted && wanted[setting.name] !== undefined}
                    onValue=${set(setting)} onWrong=${mark}
                  />`,
                )}
            </div>
          </details>`,
        )}
      </fieldset>
      <div class="actions">
        <button class="primary" disabled=${!holds.value || !isOther || wrong.length > 0 || isTrying}>
          ${t(isTrying ? "settings-trying" : "settings-use")}
        </button>
        <button type="button" disabled=${!isOther && !wrong.length} onClick=${() => take({ ...known })}>
          ${t("settings-undo")}
        </button>
      </div>
      ${mayTake.value && !holds.value && html`<p class="hint">${t("settings-take-cell")}</p>`}
    </form>
    <section aria-labelledby="not-here">
      <h2 id="not-here">${t("settings-not-here")}</h2>
      <dl class="reasons">
        ${Object.entries(reasons).map(
          ([reason, names]) => html`<dt key=${reason} translate=${false}>${names.join(", ")}</dt>
            <dd>${t(`settings-not-${reason}`)}</dd>`,
        )}
      </dl>
    </section>`;
}
