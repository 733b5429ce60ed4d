// The frame of every page: state of the cell, steps, lease and errors.
import { html, signal, useEffect, useLayoutEffect, useRef, useState } from "../vendor/ui.js";
import { enter, pageOf, wear } from "./pages.js";
import { ask, attempt, confirming, glance, sentence, trouble, troubled } from "./shared/api.js";
import { Keys, listKeys } from "./shared/keys.js";
import { cell, end, hasManual, holds, isConnected, leave, mayTake, me, take, wake } from "./shared/live.js";
import { Chip, Dialog, mainAction, Shape, Spoken } from "./shared/pieces.js";
import { choose, LANGUAGES, language, t } from "./shared/texts.js";
import { Stage } from "./stage.js";
import { BESIDE, isBuilt, PAGES, STEPS, State } from "./steps.js";

const hash = () => location.hash.replace(/^#\//, "");
const stepAt = (place) => PAGES.find((one) => isBuilt(one) && one.id === place);
const here = signal(hash());
const follow = () => {
  here.value = hash();
};

const STATES = {
  READY: ["good", "tick"],
  BUSY: ["idle", "busy"],
  SETUP: ["warn", "hand"],
  FAULT: ["bad", "gap"],
};
function StateChip() {
  const { state, setup } = cell.value;
  const [kind, shape] = STATES[state] ?? ["idle", "none"];
  const text =
    state === "SETUP"
      ? setup?.name
        ? t("state-setup-by", { name: setup.name })
        : t("state-setup-nobody")
      : t(`state-${(state ?? "starting").toLowerCase()}`);
  return html`<${Chip} kind=${kind} shape=${shape} role="status" id="state">
    <span class="label">${text}</span>
  <//>`;
}

function PlcChip() {
  const { owner, auto_lock } = cell.value.plc;
  if (auto_lock) return html`<${Chip} kind="warn" shape="plant">${t("plc-locked")}<//>`;
  return html`<${Chip} kind="plain" shape="plant">
    <span class="words">
      ${owner ? html`${t("plc-owner")} <span translate=${false}>${owner}</span>` : t("plc-nobody")}
    </span>
  <//>`;
}

// Kept on this device and with the user.
async function speakFrom(tag) {
  await choose(tag);
  if (me.value.name) await attempt(() => ask("PUT", "me", { language: tag }));
}

// Language, manual and log-out, behind the user's name.
function Menu() {
  const menu = useRef(null);
  const shut = () => menu.current?.removeAttribute("open");
  const left = ({ relatedTarget }) => menu.current.contains(relatedTarget) || shut();
  const onKey = ({ key }) => key === "Escape" && shut();
  return html`<details class="menu" ref=${menu} onFocusOut=${left} onKeyDown=${onKey}>
    <summary><span class="unseen">${t("menu")}</span> <span class="words" translate=${false}>${
      me.value.name || me.value.role
    }</span></summary>
    <div class="panel" tabindex="-1">
      <p class="muted" translate=${false}>${me.value.name || me.value.role}</p>
      <label class="language">
        <span>${t("language")}</span>
        <select onChange=${(event) => speakFrom(event.currentTarget.value)}>
          ${Object.entries(LANGUAGES).map(
            ([tag, name]) => html`<option
              value=${tag} lang=${tag} translate=${false} selected=${tag === language.value}
            >
              ${name}
            </option>`,
          )}
        </select>
      </label>
      ${hasManual && html`<a class="button" href="/manual/how-to/setup/">${t("nav-manual")}</a>`}
      <button class="keyboard" onClick=${listKeys}>${t("keys")}</button>
      <form method="post" action="/logout"><button>${t("log-out")}</button></form>
    </div>
  </details>`;
}

function Head() {
  return html`<header>
    <p class="cell" translate=${false}>${cell.value.name}</p>
    <${StateChip} />
    <${PlcChip} />
    ${!isConnected.value && html`<${Chip} kind="bad" shape="gap" role="alert">${t("connection-lost")}<//>`}
    <nav aria-label=${t("nav")}>
      <a href="/">${t("nav-run")}</a>
      <a href="#/welcome" aria-current=${!BESIDE.some(({ id }) => id === here.value)}>${t("nav-setup")}</a>
      ${BESIDE.filter(isBuilt).map(
        ({ id }) => html`<a href="#/${id}" aria-current=${here.value === id}>${t(`nav-${id}`)}</a>`,
      )}
    </nav>
    <${Menu} />
  </header>`;
}

function Steps() {
  const menu = useRef(null);
  const list = html`<ol class="steps">
    ${STEPS.map((step, i) => {
      const { id, state } = step;
      const inside = html`<span class="count" aria-hidden="true">${i + 1}</span>
        <span class="what">${t(`step-${id}`)}</span><${State} is=${state()} />`;
      const shut = () => menu.current?.removeAttribute("open");
      return html`<li key=${id}>
        ${
          isBuilt(step)
            ? html`<a href="#/${id}" aria-current=${here.value === id ? "step" : undefined} onClick=${shut}>
              ${inside}
            </a>`
            : html`<span class="closed">${inside}</span>`
        }
      </li>`;
    })}
  </ol>`;
  const at = STEPS.findIndex(({ id }) => id === here.value);
  return html`<nav class="path" aria-label=${t("steps")}>
    <div class="wide">${list}</div>
    <details ref=${menu}>
      <summary>
        ${
          at < 0
            ? t("steps")
            : html`${t("step-of", { number: at + 1, count: STEPS.length })}${" "}
              ${t(`step-${here.value}`)}`
        }
      </summary>${list}
    </details>
  </nav>`;
}

// The password once more. onSaid(): it was right; for a dialog, which lies before what went wrong.
/** @param {{ text: string, label: string, onSaid?: () => void }} props */
function Wake({ text, label, onSaid }) {
  const [password, setPassword] = useState("");
  const [failed, setFailed] = useState(null);
  const submit = async (event) => {
    event.preventDefault();
    const isRight = await wake(password);
    setPassword("");
    setFailed(isRight || !onSaid ? null : trouble.peek());
    if (isRight) onSaid?.();
  };
  return html`<form class="wake" onSubmit=${submit}>
    <p><${Shape} is="doubt" /> ${text}</p>
    ${failed && html`<p class="wrong" role="alert"><${Shape} is="doubt" /> ${sentence(failed)}</p>`}
    <input type="text" autocomplete="username" value=${me.value.name} readonly hidden />
    <label class="field">
      <span>${t("password")}</span>
      <input
        type="password" autocomplete="current-password" value=${password}
        onInput=${(event) => setPassword(event.currentTarget.value)}
      />
    </label>
    <button class="primary" disabled=${!password}>${label}</button>
  </form>`;
}

// In front of whatever asks for it, dialogs too.
function Confirm() {
  const waits = confirming.value;
  return html`<${Dialog}
    title=${t("confirm-title")} isOpen=${Boolean(waits)} onClose=${() => waits.answer(false)}
  >
    <${Wake}
      text=${t("confirm", { name: me.value.name })} label=${t("confirm-yes")}
      onSaid=${() => waits.answer(true)}
    />
    <div class="actions">
      <button type="button" onClick=${() => waits.answer(false)}>${t("back")}</button>
    </div>
  <//>`;
}

// A camera's fault in words, and what ends it. It stays for a while: pictures may be lost every other time.
const FAULT_STAYS_MS = 3000;
function Fault() {
  const { error, error_code } = cell.value;
  const [shown, show] = useState(null);
  useEffect(() => {
    if (error) {
      const [, camera] = error.match(/^camera (\w+)/) ?? [];
      show(sentence({ code: `camera_${error_code}`, detail: error, params: { camera } }));
      return undefined;
    }
    const timer = setTimeout(() => show(null), FAULT_STAYS_MS);
    return () => clearTimeout(timer);
  }, [error, language.value]);
  if (!shown) return null;
  return html`<p class="fault" role="status"><${Shape} is="gap" /> ${shown} ${t("measures-again")}</p>`;
}

// Who has the cell, and the buttons to take or leave it.
function Lease() {
  const [isAsked, setAsked] = useState("");
  const { setup, plc, state } = cell.value;
  const person = setup?.source === "person" || setup?.name ? setup : null;
  const close = () => setAsked("");
  const act = (work) => async () => {
    close();
    await work();
  };
  let [text, buttons] = [t("lease-free"), null];
  const button = (key, what, isPrimary) => html`<button
    type="button" class=${isPrimary ? "primary" : ""} onClick=${what}
  >
    ${t(key)}
  </button>`;
  if (plc.auto_lock && !holds.value) text = t("lease-locked");
  else if (!mayTake.value)
    text = person?.name ? t("lease-others-view", { name: person.name }) : t("lease-view");
  else if (holds.value) [text, buttons] = [t("lease-yours"), button("lease-leave", () => setAsked("leave"))];
  else if (person?.yours)
    [text, buttons] = [
      t("lease-elsewhere"),
      button(
        "lease-continue",
        act(() => take(true)),
        true,
      ),
    ];
  else if (person?.name)
    [text, buttons] = [
      t("lease-others", { name: person.name }),
      button("lease-take-over", () => setAsked("over")),
    ];
  else if (person)
    [text, buttons] = [
      t("lease-unattended"),
      html`${button(
        "lease-take",
        act(() => take(true)),
        true,
      )} ${button("lease-end", () => setAsked("end"))}`,
    ];
  else if (state)
    [text, buttons] = [
      t(setup ? "lease-incomplete" : "lease-free"),
      button("lease-take", setup ? act(() => take(false)) : () => setAsked("take"), true),
    ];
  const question = (id, work) => html`<${Dialog}
    title=${t(`ask-${id}-title`, { name: person?.name ?? "" })} isOpen=${isAsked === id} onClose=${close}
  >
    <p>${t(`ask-${id}`, { name: person?.name ?? "" })}</p>
    <div class="actions">
      <button type="button" onClick=${close}>${t("back")}</button>
      <button type="button" class="primary" onClick=${act(work)}>${t(`ask-${id}-yes`)}</button>
    </div>
  <//>`;
  return html`<aside class="lease ${holds.value ? "mine" : ""}" aria-label=${t("lease")}>
    <p><${Shape} is=${holds.value ? "hand" : "none"} /> ${text}</p>
    <div class="actions">${buttons}</div>
    ${me.value.idle && html`<${Wake} text=${t("idle", { name: me.value.name })} label=${t("idle-wake")} />`}
    ${question("take", () => take(false))} ${question("over", () => take(true))} ${question(
      "leave",
      leave,
    )} ${question("end", end)}
  </aside>`;
}

// Below or above what was pressed, as long as that is there; else above the page. It comes into sight, and
// follows.
const GAP_PX = 6;
function Trouble() {
  const box = useRef(null);
  const [place, setPlace] = useState(null);
  const shown = trouble.value;
  useLayoutEffect(() => {
    if (!shown) return undefined;
    let frame = 0;
    let isSeen = false;
    const stay = () => {
      const control = troubled.peek();
      const { left, top, bottom, width } = control?.getBoundingClientRect() ?? {};
      const { offsetWidth, offsetHeight } = box.current ?? { offsetWidth: 0, offsetHeight: 0 };
      const room = innerWidth - offsetWidth - GAP_PX;
      const isAbove = bottom + GAP_PX + offsetHeight > innerHeight; // as at the foot of the window
      const y = isAbove ? top - offsetHeight - GAP_PX : bottom + GAP_PX;
      setPlace(width ? `${Math.max(GAP_PX, Math.min(left, room)) + scrollX}px ${y + scrollY}px` : null);
      frame = requestAnimationFrame(stay);
      if (isSeen) return;
      isSeen = true;
      setTimeout(() => box.current?.scrollIntoView({ block: "nearest" }));
    };
    stay();
    return () => cancelAnimationFrame(frame);
  }, [shown]);
  if (!shown) return null;
  const [left, top] = place?.split(" ") ?? [];
  return html`<div
    ref=${box} class="trouble ${place ? "beside" : ""}" role="alert" style=${place ? { left, top } : {}}
  >
    <p><${Shape} is="doubt" /> ${sentence(shown)}</p>
    <button type="button" onClick=${() => (trouble.value = null)}>${t("understood")}</button>
  </div>`;
}

// The steps before and after this one.
function beside() {
  const steps = STEPS.filter(isBuilt);
  const at = steps.findIndex(({ id }) => id === here.value);
  return at < 0 ? [] : [steps[at - 1], steps[at], steps[at + 1]];
}
function goTo(where) {
  const [before, , after] = beside();
  const step = Number.isInteger(where) ? STEPS[where - 1] : where === "next" ? after : before;
  if (step && isBuilt(step)) location.hash = `#/${step.id}`;
}
const UNBROKEN = "\u00a0"; // an arrow stands in no line of its own
function Foot() {
  const [before, step, after] = beside();
  if (!before && !mainAction.value) return null;
  return html`<nav class="foot" aria-label=${t("foot")}>
    ${
      before &&
      html`<a class="button" href="#/${before.id}">
        ‹<span class="where">${UNBROKEN}${t(`step-${before.id}`)}</span>
      </a>`
    }
    ${
      mainAction.value &&
      html`<button class="primary" onClick=${mainAction.value.act}>${mainAction.value.text}</button>`
    }
    ${
      after &&
      html`<a
        class="button ${step.state() === "tick" && !mainAction.value ? "primary" : ""}"
        href="#/${after.id}">
        <span class="where">${t(`step-${after.id}`)}${UNBROKEN}</span>›
      </a>`
    }
  </nav>`;
}

export function Shell() {
  const main = useRef(null);
  useEffect(() => {
    addEventListener("hashchange", follow);
    return () => removeEventListener("hashchange", follow);
  }, []);
  const step = stepAt(here.value) ?? STEPS[0];
  const page = pageOf(step);
  useLayoutEffect(() => wear(step.id), [step.id, page]);
  useEffect(() => {
    glance(() => enter(step));
    return () => {
      if (trouble.peek()?.code !== "lease_lost") trouble.value = null; // an error of that page
    };
  }, [step.id]);
  useEffect(() => {
    // another step may have been chosen while this one was drawn
    if (!stepAt(hash())) history.replaceState(null, "", `#/${step.id}`);
    follow();
    document.title = `${cell.value.name}: ${t(STEPS.includes(step) ? `step-${step.id}` : `nav-${step.id}`)}`;
  }, [step.id, language.value]);
  const skip = (event) => {
    event.preventDefault();
    main.current.focus();
  };
  return html`<a class="skip" href="#main" onClick=${skip}>${t("skip")}</a>
    <${Head} />
    <div class="body ${BESIDE.includes(step) ? "alone" : ""}">
      ${!BESIDE.includes(step) && html`<${Steps} />`}
      <div class="column">
        <${Lease} />
        <${Fault} />
        <${Trouble} />
        <main id="main" ref=${main} tabindex="-1" data-page=${page ? step.id : undefined} aria-busy=${!page}>
          ${page && html`<${page} key=${step.id} />`}
        </main>
        ${cell.value.stage && me.value.role !== "viewer" && html`<${Stage} />`}
      </div>
    </div>
    <${Foot} />
    <${Confirm} />
    <${Keys} go=${goTo} />
    <${Spoken} />`;
}
