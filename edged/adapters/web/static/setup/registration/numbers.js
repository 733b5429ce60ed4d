// The numbers on the robot's pendant: typed, or pasted in any format of robots and tables.
import { html, useLayoutEffect } from "../../vendor/ui.js";
import { ask, attempt } from "../shared/api.js";
import { cell, mayTake } from "../shared/live.js";
import { Shape, useKept } from "../shared/pieces.js";
import { parseNumber, t } from "../shared/texts.js";

const SEVERAL = /\d[^\d]*[\s,;[{:=][^\d]*\d/; // several numbers: a whole pose
const WHOLE = /^\s*[-−+]?\d+[.,]?\d*\s*$/;

/** @typedef {{ body?: any, isWrong?: boolean, clear?: () => void }} Entered */
// onShown(entered): with a body once complete. point: a place, for the stage's robot.
export function Shown({ draft, onShown, onLines, point, first }) {
  const { labels, units, kind, brand, mount } = draft;
  const count = kind === "touch" ? 3 : labels.length;
  const name = (what) => (first ? null : `${what}-${draft.id}`);
  const [typed, setTyped] = useKept(name("shown"), first ?? []);
  const [pasted, setPasted] = useKept(name("pasted"), "");
  const values = Array.from({ length: count }, (_, i) => parseNumber((typed[i] ?? "").replace(/\s/g, "")));
  const isEmpty = !pasted.trim() && !typed.some((one) => one?.trim());
  const isWhole = values.every(Number.isFinite);
  const lines = pasted.split("\n").filter((line) => /\d/.test(line));
  const body = pasted.trim() ? { text: pasted.trim() } : isWhole ? { numbers: values } : null;
  const clear = () => {
    setTyped([]);
    setPasted("");
  };
  // before the next press, so that the fields are sent as shown
  useLayoutEffect(() => {
    onShown({ body, isWrong: !isEmpty && !body, clear });
  }, [pasted, typed.join("|"), count]);
  const write = (i, text) =>
    setTyped(Array.from({ length: count }, (_, k) => (k === i ? text : (typed[k] ?? ""))));
  const paste = (event) => {
    const text = event.clipboardData?.getData("text") ?? "";
    if (WHOLE.test(text) || !SEVERAL.test(text)) return;
    event.preventDefault();
    setPasted(text);
  };
  const spread = () => {
    onLines(lines);
    clear();
  };
  const borrow = () =>
    attempt(async () => {
      const [x, y] = point?.left ?? [];
      const query = {
        brand: brand ?? "kuka",
        carries: mount === "flange" ? "cameras" : "board",
        ...(point ? { x, y } : {}),
      };
      setPasted((await ask("GET", `stage/robot?${new URLSearchParams(query)}`)).text);
    });
  return html`<div class="robot-numbers">
    <div class="robot-fields" role="group" aria-label=${t("robot-shown")}>
      ${Array.from({ length: count }, (_, i) => {
        const isWrong = Boolean(typed[i]?.trim()) && !Number.isFinite(values[i]);
        return html`<label class="field" key=${i}>
          <span translate=${false}>
            ${labels[i]}${units[i] && html` <span class="muted">${units[i]}</span>`}
          </span>
          <input
            inputmode="text" autocomplete="off" name="shown${i}" value=${typed[i] ?? ""}
            disabled=${!mayTake.value || Boolean(pasted)} aria-invalid=${isWrong}
            onInput=${(event) => write(i, event.currentTarget.value)} onPaste=${paste}
          />
          ${
            isWrong &&
            html`<span class="wrong" role="alert">
              <${Shape} is="doubt" /> ${t("field-number")}
            </span>`
          }
        </label>`;
      })}
    </div>
    <label class="field">
      <span>${t("robot-paste")}</span>
      <textarea
        name="pasted" rows="2" value=${pasted} disabled=${!mayTake.value}
        onInput=${(event) => setPasted(event.currentTarget.value)}
      ></textarea>
    </label>
    <div class="actions">
      ${pasted && html`<button onClick=${clear}>${t("robot-clear")}</button>`}
      ${
        onLines &&
        lines.length > 1 &&
        html`<button onClick=${spread}>${t("robot-spread", { count: lines.length })}</button>`
      }
      ${
        cell.value.stage &&
        html`<button disabled=${!mayTake.value} onClick=${borrow}>${t("robot-stage-shows")}</button>`
      }
      ${
        cell.value.stage &&
        kind === "poses" &&
        html`<button
          disabled=${!mayTake.value} onClick=${() => attempt(() => ask("POST", "stage/robot/walk", {}))}
        >
          ${t("robot-stage-walk")}
        </button>`
      }
    </div>
  </div>`;
}
