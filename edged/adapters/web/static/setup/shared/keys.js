// Keys: few, none while somebody types or answers a dialog, none that changes what the cell runs by.
import { html, signal, useEffect, useRef } from "../../vendor/ui.js";
import { Dialog } from "./pieces.js";
import { t } from "./texts.js";

// Fields take letters and Ctrl+Z for themselves; boxes that are ticked do not.
const TYPED =
  "textarea, select, [contenteditable], input:not([type=checkbox], [type=radio], [type=range], [type=file])";
const isFree = ({ target }) => !target.closest?.(TYPED) && !document.querySelector("dialog[open]");

// What changes a draft can be undone, by Ctrl+Z too. undo, redo: null where there is nothing to undo.
export function useUndoKeys(undo, redo) {
  const steps = useRef(null);
  steps.current = { undo, redo };
  useEffect(() => {
    const onKey = (event) => {
      const { ctrlKey, metaKey, shiftKey, altKey, key } = event;
      if (!(ctrlKey || metaKey) || altKey || !/^[zy]$/i.test(key) || !isFree(event)) return;
      event.preventDefault();
      steps.current[shiftKey || /y/i.test(key) ? "redo" : "undo"]?.();
    };
    addEventListener("keydown", onKey);
    return () => removeEventListener("keydown", onKey);
  }, []);
}

// Single keys can be switched off: speech and stray hands press letters, too (WCAG 2.1.4).
const OFF = "edged.keys";
const isOn = signal(localStorage.getItem(OFF) !== "off");
function switchKeys(on) {
  localStorage.setItem(OFF, on ? "on" : "off");
  isOn.value = on;
}

const isAsked = signal(false);
export const listKeys = () => (isAsked.value = true);

const main = () => /** @type {HTMLElement | null} */ (document.querySelector(".foot button"));
const ROWS = [
  ["steps", "1 … 9"],
  ["beside", "N", "P"],
  ["main", "M"],
  ["undo", "ctrl", "Z"],
  ["redo", "ctrl", "Y"],
  ["close", "Esc"],
  ["list", "?"],
];

// The keys and their list. go(to): to the step of a number, "next" or "before".
export function Keys({ go }) {
  useEffect(() => {
    const onKey = (event) => {
      const { key, ctrlKey, metaKey, altKey } = event;
      if (ctrlKey || metaKey || altKey || !isFree(event)) return;
      if (key === "?") listKeys();
      else if (!isOn.peek()) return;
      else if (/^[1-9]$/.test(key)) go(Number(key));
      else if (/^n$/i.test(key)) go("next");
      else if (/^p$/i.test(key)) go("before");
      else if (/^m$/i.test(key)) main()?.focus();
    };
    addEventListener("keydown", onKey);
    return () => removeEventListener("keydown", onKey);
  }, []);
  const shut = () => (isAsked.value = false);
  return html`<${Dialog} title=${t("keys")} isOpen=${isAsked.value} onClose=${shut}>
    <table class="keys">
      <tbody>
        ${ROWS.map(
          ([what, ...keys]) => html`<tr key=${what}>
            <th scope="row">${t(`keys-${what}`)}</th>
            <td>
              ${keys.map(
                (key) => html`<kbd translate=${false}>${key === "ctrl" ? t("keys-ctrl") : key}</kbd> `,
              )}
            </td>
          </tr>`,
        )}
      </tbody>
    </table>
    <label class="choice">
      <input
        type="checkbox" name="keys" checked=${isOn.value}
        onChange=${({ currentTarget }) => switchKeys(currentTarget.checked)}
      />
      ${t("keys-single")}
    </label>
    <div class="actions"><button onClick=${shut}>${t("back")}</button></div>
  <//>`;
}
