// PLC and go live: addresses, last commands, clients' sources; what is missing for READY.
import { html, useEffect, useState } from "../../vendor/ui.js";
import { ask, glance } from "../shared/api.js";
import { cell, hasManual, holds, leave, mayTake, offers } from "../shared/live.js";
import { Dialog, Shape, say } from "../shared/pieces.js";
import { number, t } from "../shared/texts.js";
import { isBuilt, STEPS, State } from "../steps.js";
import { Exchanges } from "./plcexchanges.js";
import { verdictOf } from "./plcprobe.js";
import { CONVENTION_NAMES, Settings } from "./plcsettings.js";

// --- go live ---

const BEFORE = ["cameras", "calibrate", "check", "teach", "robot"];

function GoLive() {
  const [isAsked, setAsked] = useState(false);
  const { state, setup, missing, error, plc } = cell.value;
  const isReady = state === "READY" || state === "BUSY";
  const steps = STEPS.filter(({ id }) => BEFORE.includes(id)).map((step) => ({ ...step, is: step.state() }));
  const blocks = missing.length > 0;
  const give = async () => {
    setAsked(false);
    await leave();
    say(t("plc-given"));
  };
  const now = isReady
    ? ["tick", t("plc-ready")]
    : blocks
      ? ["gap", t("plc-blocked")]
      : error
        ? ["doubt", t("plc-fault")]
        : holds.value
          ? ["hand", t("plc-yours")]
          : setup?.name
            ? ["hand", t("plc-theirs", { name: setup.name })]
            : ["none", t("plc-not-ready")];
  return html`<section aria-labelledby="plc-live">
    <h2 id="plc-live">${t("plc-live")}</h2>
    <p class="big figure" role="status"><${Shape} is=${now[0]} /> <strong>${now[1]}</strong></p>
    ${error && html`<p class="hint" translate=${false} lang="en">${error}</p>`}
    <ul class="plc-before">
      ${steps.map(
        ({ is, ...step }) => html`<li key=${step.id}>
          <${State} is=${is} /> ${
            isBuilt(step)
              ? html`<a href="#/${step.id}">${t(`step-${step.id}`)}</a>`
              : html`<span>${t(`step-${step.id}`)}</span>`
          } <span class="muted">${t(`plc-before-${is}`)}</span>
        </li>`,
      )}
      <li>
        <${State} is=${plc.owner ? "tick" : "none"} /> <span>${t("plc-writes")}</span> <span class="muted">
          ${plc.owner ? html`<span translate=${false}>${plc.owner}</span>` : t("plc-writes-nobody")}
        </span>
      </li>
    </ul>
    ${plc.auto_lock && html`<p><${Shape} is="plant" /> ${t("plc-auto-lock")}</p>`}
    ${
      holds.value &&
      html`<div class="actions">
        <button class="primary big" disabled=${!mayTake.value} onClick=${() => setAsked(true)}>
          ${t(blocks ? "plc-give" : "plc-give-ready")}
        </button>
      </div>`
    }
    <${Dialog} title=${t("ask-leave-title")} isOpen=${isAsked} onClose=${() => setAsked(false)}>
      <p>${t("ask-leave")}</p>
      <div class="actions">
        <button onClick=${() => setAsked(false)}>${t("back")}</button>
        <button class="primary" onClick=${give}>${t("ask-leave-yes")}</button>
      </div>
    <//>
  </section>`;
}

// --- addresses ---

function Reach({ plc }) {
  if (!plc.listening)
    return html`<section aria-labelledby="plc-reach">
      <h2 id="plc-reach">${t("plc-reach")}</h2><p><${Shape} is="gap" /> ${t("plc-off")}</p>
    </section>`;
  const { host, port, unit_id, word_order, base_address, convention, connected, owner, refused } = plc;
  const where = host === "0.0.0.0" || host === "::" ? location.hostname : host;
  const isHere = /^(127\.|::1$|localhost$)/.test(host);
  return html`<section aria-labelledby="plc-reach">
    <h2 id="plc-reach">${t("plc-reach")}</h2>
    <dl class="facts">
      <dt>${t("plc-address")}</dt><dd translate=${false}>Modbus TCP ${where}:${port}, unit ${unit_id}</dd>
      <dt>${t("plc-base")}</dt><dd>${number(base_address)}</dd>
      <dt>${t("plc-order")}</dt><dd>${t(`plc-order-${word_order}`)}</dd>
      <dt>${t("plc-convention")}</dt><dd translate=${false}>${CONVENTION_NAMES[convention] ?? convention}</dd>
      <dt>${t("plc-connected")}</dt><dd>${number(connected)}</dd>
      <dt>${t("plc-owner-now")}</dt>
      <dd>${owner ? html`<span translate=${false}>${owner}</span>` : t("plc-owner-none")}</dd>
    </dl>
    ${isHere && html`<p><${Shape} is="doubt" /> ${t("plc-only-here")}</p>`}
    ${
      refused.length > 0 &&
      html`<p>
        <${Shape} is="doubt" /> ${t("plc-refused")} <span translate=${false}>${refused.join(", ")}</span>
      </p>`
    }
    <p class="hint">${t("plc-owner-what")}</p>
    <${Probe} plc=${plc} />
  </section>`;
}

function Probe({ plc }) {
  const [name, setName] = useState("PROBE_U32");
  const [typed, setTyped] = useState("");
  const { address } = plc.probes.find((one) => one.name === name);
  const verdict = typed.trim() ? verdictOf(name, typed, plc) : null;
  const shape = verdict === "right" ? "tick" : verdict === "no-number" ? "doubt" : "gap";
  return html`<h3>${t("plc-probe")}</h3>
    <p class="hint">${t("plc-probe-what")}</p>
    <div class="row">
      <label class="field">
        <span>${t("plc-probe-register")}</span>
        <select name="probe" onChange=${(event) => setName(event.currentTarget.value)}>${plc.probes
          .filter((one) => one.name !== "MAP_VERSION")
          .map(
            (one) => html`<option
              key=${one.name} value=${one.name} selected=${one.name === name} translate=${false}
            >
              ${one.name} (${one.address})
            </option>`,
          )}</select>
      </label>
      <label class="field">
        <span>${t("plc-probe-shows", { address: number(address) })}</span>
        <input
          inputmode="text" autocomplete="off" name="shows" value=${typed}
          onInput=${(event) => setTyped(event.currentTarget.value)}
        />
      </label>
    </div>
    ${
      verdict &&
      html`<p class="verdict" role="status">
        <${Shape} is=${shape} />${" "}
        ${t(`plc-probe-${verdict}`, { order: plc.word_order === "high" ? "low" : "high" })}
      </p>`
    }`;
}

// --- clients' sources ---

const WHOSE = {
  st: "IEC 61131-3",
  scl: "SIMATIC S7",
  s7db: "SIMATIC S7 (DB)",
  l5x: "Studio 5000 (L5X)",
  plcopen: "CODESYS (PLCopen XML)",
  twincat: "TwinCAT 3",
  urscript: "Universal Robots",
  krl: "KUKA",
  krl6: "KUKA (iiQKA)",
  karel: "FANUC",
  rapid: "ABB",
  motoplus: "Yaskawa",
  val3: "Stäubli",
  as: "Kawasaki",
  drl: "Doosan",
  melfa: "Mitsubishi",
  spel: "Epson",
  pacscript: "Denso",
  eds: "EtherNet/IP (EDS)",
  python: "Python",
  csv: "CSV",
};

const Sources = ({ clients }) => html`<section aria-labelledby="plc-sources">
  <h2 id="plc-sources">${t("plc-sources")}</h2>
  <p class="lead">${t("plc-sources-what")}</p>
  <div class="plc-sources">
    ${clients.map(
      ({ kind, file }) => html`<a
        key=${kind} class="button" href="/api/v1/plc/clients/${kind}" download=${file} translate=${false}
      >
        <span>${WHOSE[kind] ?? kind}<br /><span class="muted">${file}</span></span>
      </a>`,
    )}
  </div>
  ${
    hasManual &&
    html`<div class="actions"><a class="button" href="/manual/how-to/plc/">${t("plc-manual")}</a></div>`
  }
</section>`;

const EVERY_MS = 2000;

// The brand of the registration in use; null where it is not known.
async function registeredBrand() {
  if (!offers("registrations")) return null;
  const { registrations } = await ask("GET", "registrations");
  const used = registrations.find(({ active }) => active);
  return used ? (await ask("GET", `registrations/${used.id}`)).brand : null;
}

export default function Plc() {
  const [plc, setPlc] = useState(null);
  const [robot, setRobot] = useState(null);
  const [looked, setLooked] = useState(0);
  const owner = cell.value.plc.owner;
  useEffect(() => {
    let isHere = true;
    const look = async () => {
      const told = await glance(() => ask("GET", "plc"));
      if (told && isHere) setPlc(told);
    };
    look();
    const timer = setInterval(look, EVERY_MS);
    return () => {
      isHere = false;
      clearInterval(timer);
    };
  }, [owner, looked]);
  useEffect(() => {
    glance(async () => setRobot(await registeredBrand()));
  }, []);
  return html`<h1>${t("plc-title")}</h1>
    <p class="lead">${t("plc-lead")}</p>
    <${GoLive} />
    ${
      plc &&
      html`<${Reach} plc=${plc} />
        ${
          offers("plc/settings") &&
          html`<${Settings} robot=${robot} onSaved=${() => setLooked(looked + 1)} />`
        }
        ${plc.listening && html`<${Exchanges} />`}
        <${Sources} clients=${plc.clients} />`
    }`;
}
