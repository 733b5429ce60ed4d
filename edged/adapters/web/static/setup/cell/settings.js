// What else the configuration can say: each setting as its schema has it, chosen here as a draft.
import { html, useRef, useState } from "../../vendor/ui.js";
import { ask, attempt, glance } from "../shared/api.js";
import { mayTake, told, useFresh } from "../shared/live.js";
import { Shape } from "../shared/pieces.js";
import { number, parseNumber, t } from "../shared/texts.js";
import { SettingsDraft, Wrong } from "./settingsdraft.js";

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
function Typed({ setting, value, onValue }) {
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

const shown = ({ kind }, value) => {
  const word =
    kind === "yes_no" && value !== null ? t(value ? "settings-yes" : "settings-no") : written(value);
  return word === "" ? t("settings-left-out") : word;
};

function Setting({ setting, value: entered, isChosen, problems, onValue, onBack }) {
  const { name, kind, help, configured, value: inForce } = setting;
  const Entry = kind === "yes_no" || kind === "choice" ? Choice : Typed;
  const value = shown(setting, configured);
  return html`<div class="setting">
    <label class="field">
      <span translate=${false}>${name}</span>
      <${Entry} setting=${setting} value=${entered} onValue=${onValue} />
    </label>
    <${Wrong} problems=${problems} />
    <p class="hint" lang="en" translate=${false}>${help.replaceAll("`", "")}</p>
    ${
      isChosen &&
      html`<p>
        <${Shape} is="hand" />${" "}
        ${
          entered === inForce
            ? t("settings-chosen")
            : t("settings-in-force", { value: shown(setting, inForce) })
        }${" "}
        <button
          type="button" aria-label=${t("settings-back-name", { value, name })}
          onClick=${() => onBack(configured)}
        >
          ${t("settings-back", { value })}
        </button>
      </p>`
    }
  </div>`;
}

export default function Settings() {
  const [known, setKnown] = useState(null);
  const [wanted, setWanted] = useState(/** @type {any} */ ({})); // by name: what is other than configured
  const [fresh, setFresh] = useState(0); // counts when fields forget what is typed in them
  const sending = useRef({ revision: -1, isOn: false, next: null, count: 0 });
  const learn = (found) => {
    sending.current.revision = found.draft?.revision ?? 0;
    setKnown(found);
  };
  const find = async () => {
    const { count } = sending.current;
    const found = await ask("GET", "settings");
    if (sending.current.count !== count) return; // what was entered meanwhile is newer
    learn(found);
    const chosen = found.settings.filter((one) => one.chosen);
    setWanted(Object.fromEntries(chosen.map((one) => [one.name, one.wanted])));
  };
  useFresh(() => sending.current.isOn || glance(find), [told("settings").value]);
  const head = html`<h1>${t("nav-settings")}</h1><p class="lead">${t("settings-what")}</p>`;
  if (!known) return head;
  const { settings: all, not_here: reasons, draft } = known;
  const isShownIn = (chosen) => {
    const { configured } = all.find(({ name }) => name === MODE) ?? {};
    const mode = MODE in chosen ? chosen[MODE] : configured;
    return ({ name, modes }) => name === MODE || !modes.length || modes.includes(mode);
  };
  const visible = all.filter(isShownIn(wanted));
  // One request at a time, then the newest: who types is faster than the cell.
  const send = async (next) => {
    const state = sending.current;
    state.next = next;
    state.count += 1;
    if (state.isOn) return;
    state.isOn = true;
    while (state.next) {
      const chosen = state.next;
      state.next = null;
      const body = () => ({ revision: state.revision, chosen });
      const found = await attempt(() => ask("PUT", "settings", body()));
      if (found) learn(found);
      else await glance(find); // somebody else was quicker
    }
    state.isOn = false;
  };
  const set = (setting) => (value) => {
    const { [setting.name]: _, ...others } = wanted;
    const next = value === setting.configured ? others : { ...others, [setting.name]: value };
    setWanted(next);
    // what belongs to another trigger mode goes with it
    const stays = isShownIn(next);
    const gone = new Set(all.filter((one) => !stays(one)).map(({ name }) => name));
    send(Object.fromEntries(Object.entries(next).filter(([name]) => !gone.has(name))));
  };
  const back = (setting) => (value) => {
    setFresh(fresh + 1);
    set(setting)(value);
  };
  const problemsOf = (name) =>
    (draft?.problems ?? []).filter(
      (one) =>
        one.name === name ||
        (one.name && name.startsWith(`${one.name}.`) && one.text.includes(name.split(".").at(-1))),
    );
  return html`${head}
    <form onSubmit=${(event) => event.preventDefault()}>
      <fieldset disabled=${!mayTake.value}>
        ${GROUPS.filter((group) => visible.some(({ name }) => name.startsWith(`${group}.`))).map(
          (group) => html`<details key=${group} open=${group === "cycle" || group === "cameras"}>
            <summary>${t(`settings-in-${group}`)}</summary>
            <div class="settings">
              ${visible
                .filter(({ name }) => name.startsWith(`${group}.`))
                .map(
                  (setting) => html`<${Setting}
                    key=${`${setting.name} ${fresh}`} setting=${setting}
                    value=${setting.name in wanted ? wanted[setting.name] : setting.configured}
                    isChosen=${setting.name in wanted} problems=${problemsOf(setting.name)}
                    onValue=${set(setting)} onBack=${back(setting)}
                  />`,
                )}
            </div>
          </details>`,
        )}
      </fieldset>
    </form>
    <${SettingsDraft} draft=${draft}
      onDone=${() => {
        setFresh(fresh + 1);
        return find();
      }}
    />
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
