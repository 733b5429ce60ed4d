// How PLCs and robots connect: host, writers, convention, TLS, lines for robots, OPC UA; as a draft.
import { html, useEffect, useState } from "../../vendor/ui.js";
import { ask, attempt, glance, trouble } from "../shared/api.js";
import { BRANDS } from "../shared/brands.js";
import { mayTake, told, useFresh } from "../shared/live.js";
import { NumberField, Shape } from "../shared/pieces.js";
import { t } from "../shared/texts.js";
import { SettingsDraft } from "./settingsdraft.js";

const CONVENTIONS = ["fixed_xyz", "kuka_abc", "ur_rotation_vector", "staubli_xyz", "kawasaki_oat", "abb_zyx"];
export const CONVENTION_NAMES = {
  fixed_xyz: "W P R, Rx Ry Rz (FANUC, Yaskawa)",
  kuka_abc: "A B C (KUKA)",
  ur_rotation_vector: "rx ry rz (Universal Robots)",
  staubli_xyz: "rx ry rz (Stäubli)",
  kawasaki_oat: "O A T (Kawasaki)",
  abb_zyx: "EulerZYX (ABB)",
};
const ONLY_HERE = "127.0.0.1";
const EVERYWHERE = "0.0.0.0";
const NEW_SOCKET = { port: 1503, brand: "", allow_simulated: false };
const NEW_TLS = { certificate: "", key: "", authority: "", writer_roles: ["operator"] };
const NEW_OPCUA = {
  host: ONLY_HERE,
  port: 4840,
  certificate: null,
  key: null,
  trusted: null,
  user: "operator",
  password: null,
  anonymous: true,
  readers: [],
};

const listed = (text) =>
  text
    .split(/[\s,;]+/)
    .map((one) => one.trim())
    .filter(Boolean);

const Text = ({ label, name, value, onValue, hint = "", type = "text" }) => html`<label class="field">
  <span>${label}</span>
  <input
    name=${name} type=${type === "text" ? undefined : type}
      autocomplete=${type === "text" ? "off" : "new-password"}
    maxlength="200" value=${value ?? ""} onInput=${(event) => onValue(event.currentTarget.value)}
  />
  ${hint && html`<span class="hint">${hint}</span>`}
</label>`;

// A list is typed as text, so that a comma can be typed, too.
function Listed({ label, name, values, onValues, hint }) {
  const [text, setText] = useState(values.join(", "));
  useEffect(() => {
    if (listed(text).join() !== values.join()) setText(values.join(", "));
  }, [values.join()]);
  const type = (typed) => {
    setText(typed);
    onValues(listed(typed));
  };
  return html`<${Text} label=${label} name=${name} value=${text} onValue=${type} hint=${hint} />`;
}

// isGiven: names that are not translated.
const Choice = ({ label, name, value, options, onValue, isGiven = false }) => html`<label class="field">
  <span>${label}</span>
  <select name=${name} value=${value} onChange=${(event) => onValue(event.currentTarget.value)}>
    ${options.map(
      ([id, text]) => html`<option
        key=${id} value=${id} selected=${id === value} translate=${isGiven && id ? false : undefined}
      >
        ${text}
      </option>`,
    )}
  </select>
</label>`;

const Tick = ({ label, name, value, onValue }) => html`<label class="choice">
  <input
    type="checkbox" name=${name} checked=${value} onChange=${(event) => onValue(event.currentTarget.checked)}
  /> ${label}
</label>`;

const Port = ({ label, name, value, onValue, low = 1, high = 65535 }) => html`<${NumberField}
  label=${label} unit="" digits=${0} low=${low} high=${high} value=${value} name=${name} isForm
  onValue=${(number) => onValue(Math.round(number))}
/>`;

// The robot's brand and the PLC's convention disagree: which of them is right, a person knows.
function Asks({ modbus, brand, conventions, onConvention, isSure, onSure }) {
  const fitting = conventions[brand];
  if (!brand || !fitting || fitting === modbus.convention) return null;
  return html`<div class="signature" role="alert">
    <p>
      <${Shape} is="doubt" /> ${t("plc-set-disagree", {
        brand: BRANDS[brand],
        theirs: CONVENTION_NAMES[fitting],
        ours: CONVENTION_NAMES[modbus.convention],
      })}
    </p>
    <div class="actions">
      <button type="button" onClick=${() => onConvention(fitting)}>
        ${t("plc-set-take", { convention: CONVENTION_NAMES[fitting] })}
      </button>
      <button type="button" aria-pressed=${isSure} onClick=${onSure}>${t("plc-set-sure")}</button>
    </div>
  </div>`;
}

function Modbus({ modbus, set }) {
  const isHere = modbus.host === ONLY_HERE || modbus.host === "localhost";
  return html`<${Tick}
      label=${t("plc-set-enabled")} name="enabled" value=${modbus.enabled}
      onValue=${(enabled) => set({ enabled })}
    />
    <div class="row">
      <${Choice}
        label=${t("plc-set-reach")} name="reach"
        value=${isHere ? ONLY_HERE : modbus.host === EVERYWHERE ? EVERYWHERE : "one"}
        options=${[
          [ONLY_HERE, t("plc-set-here")],
          [EVERYWHERE, t("plc-set-everywhere")],
          ["one", t("plc-set-one")],
        ]}
        onValue=${(host) => set({ host: host === "one" ? location.hostname : host })}
      />
      ${
        !isHere &&
        modbus.host !== EVERYWHERE &&
        html`<${Text}
          label=${t("plc-set-host")} name="host" value=${modbus.host} onValue=${(host) => set({ host })}
        />`
      }
      <${Port} label=${t("plc-set-port")} name="port" value=${modbus.port}
          onValue=${(port) => set({ port })} />
      <${Port}
        label=${t("plc-set-unit")} name="unit" value=${modbus.unit_id} high=${247}
        onValue=${(unit_id) => set({ unit_id })}
      />
    </div>
    <div class="row">
      <${Listed}
        label=${t("plc-set-writers")} name="writers" values=${modbus.writers}
        onValues=${(writers) => set({ writers })} hint=${t("plc-set-writers-what")}
      />
      <${Listed}
        label=${t("plc-set-readers")} name="readers" values=${modbus.readers}
        onValues=${(readers) => set({ readers })} hint=${t("plc-set-readers-what")}
      />
    </div>
    <div class="row">
      <${Choice}
        label=${t("plc-order")} name="order" value=${modbus.word_order}
        options=${["high", "low"].map((one) => [one, t(`plc-order-${one}`)])}
        onValue=${(word_order) => set({ word_order })}
      />
      <${Port}
        label=${t("plc-base")} name="base" value=${modbus.base_address} low=${0} high=${60000}
        onValue=${(base_address) => set({ base_address })}
      />
      <${Choice}
        label=${t("plc-convention")} name="convention" value=${modbus.convention} isGiven
        options=${CONVENTIONS.map((one) => [one, CONVENTION_NAMES[one]])}
        onValue=${(convention) => set({ convention })}
      />
    </div>`;
}

function Tls({ tls, set }) {
  const change = (values) => set({ tls: { ...tls, ...values } });
  const file = (name) => html`<${Text}
    label=${t(`plc-set-${name}`)} name="tls-${name}" value=${tls[name]}
    onValue=${(value) => change({ [name]: value })}
  />`;
  return html`<${Tick}
      label=${t("plc-set-tls")} name="tls" value=${tls !== null}
      onValue=${(isOn) => set({ tls: isOn ? NEW_TLS : null, ...(isOn ? { socket: null } : {}) })}
    />
    ${
      tls &&
      html`<p class="hint">${t("plc-set-files")}</p>
        <div class="row">
          ${file("certificate")} ${file("key")} ${file("authority")}
          <${Listed}
            label=${t("plc-set-roles")} name="tls-roles" values=${tls.writer_roles}
            onValues=${(writer_roles) => change({ writer_roles })}
          />
        </div>`
    }`;
}

function Lines({ socket, set }) {
  const change = (values) => set({ socket: { ...socket, ...values } });
  return html`<${Tick}
      label=${t("plc-set-socket")} name="socket" value=${socket !== null}
      onValue=${(isOn) => set({ socket: isOn ? NEW_SOCKET : null, ...(isOn ? { tls: null } : {}) })}
    />
    ${
      socket &&
      html`<div class="row">
        <${Choice}
          label=${t("plc-set-brand")} name="brand" value=${socket.brand} isGiven
          options=${[...(socket.brand ? [] : [["", t("plc-set-choose")]]), ...Object.entries(BRANDS)]}
          onValue=${(brand) => change({ brand })}
        />
        <${Port}
          label=${t("plc-set-port-lines")} name="socket-port" value=${socket.port}
          onValue=${(port) => change({ port })}
        />
        <${Tick}
          label=${t("plc-set-simulated")} name="simulated" value=${socket.allow_simulated}
          onValue=${(allow_simulated) => change({ allow_simulated })}
        />
      </div>`
    }`;
}

function OpcUa({ opcua, hasPassword, onOpcua }) {
  const change = (values) => onOpcua({ ...opcua, ...values });
  const text = (name) => html`<${Text}
    label=${t(`plc-set-${name}`)} name="opcua-${name}" value=${opcua[name]}
    onValue=${(value) => change({ [name]: value || null })}
  />`;
  return html`<${Tick}
      label=${t("plc-set-opcua")} name="opcua" value=${opcua !== null}
      onValue=${(isOn) => onOpcua(isOn ? NEW_OPCUA : null)}
    />
    ${
      opcua &&
      html`<div class="row">
          ${text("host")}
          <${Port}
            label=${t("plc-set-port-opcua")} name="opcua-port" value=${opcua.port}
            onValue=${(port) => change({ port })}
          />
          <${Tick}
            label=${t("plc-set-anonymous")} name="anonymous" value=${opcua.anonymous}
            onValue=${(anonymous) => change({ anonymous })}
          />
        </div>
        <p class="hint">${t("plc-set-secure")}</p>
        <div class="row">
          ${text("certificate")} ${text("key")} ${text("trusted")}
          <${Text}
            label=${t("plc-set-user")} name="opcua-user" value=${opcua.user}
            onValue=${(user) => change({ user })}
          />
          <${Text}
            label=${t(hasPassword ? "plc-set-password-kept" : "plc-set-password")} name="opcua-password"
            type="password" value=${opcua.password}
              onValue=${(password) => change({ password: password || null })}
          />
        </div>`
    }`;
}

// robot: the brand of the last registration, if any.
export function Settings({ robot, onSaved }) {
  const [known, setKnown] = useState(null);
  const [wanted, setWanted] = useState(null);
  const [isOpen, setOpen] = useState(false);
  const [isSaving, setSaving] = useState(false);
  const [isSure, setSure] = useState(false);
  const take = (found) => {
    setKnown(found);
    setWanted({ modbus: found.modbus, opcua: found.opcua });
    setSure(false);
  };
  const find = async () => take(await ask("GET", "plc/settings"));
  useFresh(() => glance(find), [told("settings").value]);
  if (!wanted) return null;
  const { modbus, opcua } = wanted;
  const set = (values) => {
    setWanted({ ...wanted, modbus: { ...modbus, ...values } });
    if ("convention" in values || "socket" in values) setSure(false);
  };
  const send = (method, body) => async () => {
    setSaving(true);
    const revision = known.draft?.revision ?? 0;
    const found = await attempt(() => ask(method, "plc/settings", { revision, ...body }));
    setSaving(false);
    if (found) take(found);
    else if (trouble.value?.code === "stale") await glance(find);
  };
  const submit = (event) => {
    event.preventDefault();
    send("PUT", wanted)();
  };
  const isOther = JSON.stringify(wanted) !== JSON.stringify({ modbus: known.modbus, opcua: known.opcua });
  const brand = modbus.socket?.brand || robot;
  const disagrees = Boolean(brand) && known.conventions[brand] !== modbus.convention;
  const isWhole = !modbus.socket || modbus.socket.brand;
  return html`<section aria-labelledby="plc-settings">
    <h2 id="plc-settings">${t("plc-set")}</h2>
    <p class="hint">${t(known.is_chosen ? "plc-set-chosen" : "plc-set-configured")}</p>
    <details open=${isOpen} onToggle=${(event) => setOpen(event.currentTarget.open)}>
      <summary>${t("plc-set-change")}</summary>
      <form onSubmit=${submit}>
      <fieldset disabled=${!mayTake.value}>
        <${Modbus} modbus=${modbus} set=${set} />
        <${Lines} socket=${modbus.socket} set=${set} />
        <${Tls} tls=${modbus.tls} set=${set} />
        <${OpcUa}
          opcua=${opcua} hasPassword=${known.opcua_password}
          onOpcua=${(next) => setWanted({ ...wanted, opcua: next })}
        />
      </fieldset>
      <${Asks}
        modbus=${modbus} brand=${brand} conventions=${known.conventions} isSure=${isSure}
        onConvention=${(convention) => set({ convention })} onSure=${() => setSure(true)}
      />
      <div class="actions">
        <button
          class="primary"
          disabled=${!mayTake.value || !isOther || isSaving || !isWhole || (disagrees && !isSure)}
        >
          ${t(isSaving ? "plc-set-saving" : "plc-set-save")}
        </button>
        <button type="button" disabled=${!isOther} onClick=${() => take(known)}>${t("plc-set-back")}</button>
        ${
          known.is_chosen &&
          html`<button
            type="button" disabled=${!mayTake.value || isSaving} onClick=${send("DELETE", {})}
          >
            ${t("plc-set-as-configured")}
          </button>`
        }
      </div>
      </form>
    </details>
    <${SettingsDraft}
      draft=${known.draft}
      onDone=${async () => {
        await find();
        onSaved();
      }}
    />
  </section>`;
}
