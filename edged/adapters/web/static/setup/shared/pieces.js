// Components of all pages: shapes, number fields, sliders, dialogs.
import { html, signal, useEffect, useLayoutEffect, useRef, useState } from "../../vendor/ui.js";
import { sentence } from "./api.js";
import { number, parseNumber, t } from "./texts.js";

const SHAPES = {
  tick: "M3 8.5l3.5 3.5L13 4.5",
  doubt: "M8 2.2L14.5 13.8H1.5ZM8 6.4v3.6M8 11.6v.6",
  gap: "M3.5 3.5l9 9M12.5 3.5l-9 9",
  none: "M8 2.5a5.5 5.5 0 1 0 .01 0",
  hand: `M5 13V6.2a1 1 0 0 1 2 0V3.4a1 1 0 0 1 2 0V6a1 1 0 0 1 2 0v1a1 1 0 0 1 2 0v3.4
    A3.6 3.6 0 0 1 9.4 14H7.6L3.6 9.6a1 1 0 0 1 1.4-1.4`,
  busy: "M8 2.5v3M8 10.5v3M2.5 8h3M10.5 8h3",
  plant: "M2.5 13.5V6l4 2.4V6l4 2.4V2.5h3v11Z",
};

// Every state has its own shape, and a word beside it: colour is never alone.
export const Shape = ({ is }) => html`<svg class="shape" viewBox="0 0 16 16" aria-hidden="true">
  <path d=${SHAPES[is]} />
</svg>`;

export const Chip = ({ kind, shape, children, ...rest }) => html`<span class="chip ${kind}" ...${rest}>
  <${Shape} is=${shape} /> ${children}
</span>`;

// A task under way. state: of `useTask`.
export const Underway = ({ text, state }) => html`<div role="status">
  <label class="meter">
    <span>${text}</span>
    <progress max="1" value=${state?.done ?? undefined}></progress>
  </label>
</div>`;

// A task that failed. ended: its last state, with the problem if it is known.
export const Failed = ({ text, ended }) => html`<p class="wrong" role="alert">
  <${Shape} is="doubt" /> ${text} ${ended.problem && sentence(ended.problem)}
</p>`;

// State that survives leaving the page and reloading. name: null for state that does not.
const TYPED = "edged.typed.";
export function useKept(name, first) {
  const [value, set] = useState(
    () => JSON.parse((name && sessionStorage.getItem(TYPED + name)) || "null") ?? first,
  );
  const put = (next) => {
    if (name) sessionStorage.setItem(TYPED + name, JSON.stringify(next));
    set(next);
  };
  return [value, put];
}

// A number typed with comma or point; invalid or out of limits, it is marked and not sent.
// onValue(number): may return a promise, of undefined if it failed, as `attempt` does. isForm: the number is
// not sent by itself, and counts with each key.
export function NumberField({
  label,
  unit,
  value,
  digits = 1,
  low = -Infinity,
  high = Infinity,
  onValue,
  disabled,
  name,
  isForm,
}) {
  const [typed, setTyped] = useState(null);
  const shown = typed ?? (value === null || value === undefined ? "" : number(value, digits));
  const read = (text) => parseNumber(text.replace(/\s/g, ""));
  const parsed = read(shown);
  const type = ({ currentTarget: { value: text } }) => {
    setTyped(text);
    if (isForm && read(text) >= low && read(text) <= high) onValue(read(text));
  };
  const isWrong = typed !== null && !(parsed >= low && parsed <= high);
  // a rejected value stays, to be corrected
  const end = async () => {
    if (typed === null || isWrong) return;
    const answer = onValue(parsed);
    if (answer instanceof Promise && (await answer) === undefined) return;
    setTyped(null);
  };
  const limits =
    Number.isFinite(low) && Number.isFinite(high)
      ? t("field-limits", { low: number(low, digits), high: number(high, digits), unit })
      : t("field-number");
  return html`<label class="field">
    <span>${label}</span>
    <span class="typed">
      <input
        inputmode="decimal" autocomplete="off" name=${name} value=${shown} disabled=${disabled}
        aria-invalid=${isWrong} onInput=${type} onBlur=${end}
        onKeyDown=${(event) => event.key === "Enter" && end()}
      />
      <span class="unit" translate=${false}>${unit}</span>
    </span>${isWrong && html`<span class="wrong" role="alert"><${Shape} is="doubt" /> ${limits}</span>`}
  </label>`;
}

// A slider, logarithmic for exposure times. Reports moves at most every EVERY_MS, and the last one.
const EVERY_MS = 200;
const SETTLED_MS = 600; // until a camera has answered, so that the slider does not jump back
export function Slider({ label, value, low, high, isLogarithmic, onValue, disabled, describe }) {
  const STEPS = 500;
  const to = (x) =>
    (isLogarithmic ? Math.log(x / low) / Math.log(high / low) : (x - low) / (high - low)) * STEPS;
  const from = (step) =>
    isLogarithmic ? low * (high / low) ** (step / STEPS) : low + (high - low) * (step / STEPS);
  const [dragged, setDragged] = useState(null);
  const timer = useRef(0);
  const last = useRef(null);
  const tell = () => {
    timer.current = 0;
    if (last.current === null) return;
    onValue(last.current);
    last.current = null;
    timer.current = setTimeout(tell, EVERY_MS);
  };
  useEffect(() => () => clearTimeout(timer.current), []);
  const move = (event) => {
    const step = Number(event.currentTarget.value);
    setDragged(step);
    last.current = from(step);
    if (!timer.current) tell();
  };
  return html`<input
    type="range" min="0" max=${STEPS} aria-label=${label}
    aria-valuetext=${describe(dragged === null ? value : from(dragged))}
    value=${dragged ?? Math.round(to(value))} disabled=${disabled} onInput=${move}
    onChange=${() => setTimeout(() => setDragged(null), SETTLED_MS)}
  />`;
}

// What the page is about to do next, offered at the foot of the window too: {text, act}, or null.
export const mainAction = signal(null);
// text: falsy: not now. Of several components at most one has it.
export function useMainAction(text, act) {
  const own = useRef(null);
  const give = () => {
    if (own.current && mainAction.peek() === own.current) mainAction.value = null;
    own.current = null;
  };
  useEffect(() => {
    if (!text) return give();
    own.current = { text, act };
    mainAction.value = own.current;
    return undefined;
  });
  useEffect(() => give, []);
}

// Announcements of the screen reader.
const spoken = signal("");
export const say = (text) => {
  spoken.value = text;
};
export const Spoken = () => html`<p class="unseen" role="status" aria-live="polite">${spoken}</p>`;

// Reports Escape at once: the close event may come after the dialog was opened again.
export function Dialog({ title, isOpen, onClose, children }) {
  const dialog = useRef(null);
  useLayoutEffect(() => {
    if (isOpen && !dialog.current.open) dialog.current.showModal();
    if (!isOpen && dialog.current.open) dialog.current.close();
  }, [isOpen]);
  const closed = () => isOpen && !dialog.current.open && onClose();
  return html`<dialog ref=${dialog} aria-label=${title} onCancel=${onClose} onClose=${closed}>
    <h2>${title}</h2>
    ${isOpen && children}
  </dialog>`;
}
