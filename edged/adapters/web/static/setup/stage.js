// Only in `edged demo --stage`: moves the board, the part and the lenses of the virtual cell.
import { html, signal, useEffect } from "../vendor/ui.js";
import { ask, attempt, glance } from "./shared/api.js";
import { draft, SIDES, useFresh } from "./shared/live.js";
import { Slider } from "./shared/pieces.js";
import { number, sign, t } from "./shared/texts.js";

const stage = signal(null);
const tell = (method, path, body) =>
  attempt(async () => {
    stage.value = await ask(method, path, body);
  });
const truth = signal(null);
const TRUTH_MS = 1000;
const compare = () =>
  ask("GET", "stage/truth").then(
    (told) => (truth.value = told),
    () => {},
  );
const WAVE_MS = 4000;
// The hand brings the board to each new dashed place by itself, and looks again whether it is there.
const isFollowing = signal(false);
const LOOK_MS = 4000;
const THERE = 0.8; // moved again, it would not come to rest
const bring = ({ left, right }) => tell("PUT", "stage/hand", { left, right });
function useFollowing(ghost) {
  const isDue = isFollowing.value && ghost;
  const place = isDue ? ghost.left.join() : "";
  useEffect(() => {
    if (!place) return undefined;
    const look = () => {
      const { suggestion, in_ghost } = draft.value ?? {};
      if (suggestion && (in_ghost ?? 0) < THERE) bring(suggestion);
    };
    bring(draft.value.suggestion);
    const timer = setInterval(look, LOOK_MS);
    return () => clearInterval(timer);
  }, [place]);
}
// Who lays something there, or the board down, needs the hand for it: it follows no more.
const byHand = (...request) => {
  isFollowing.value = false;
  return tell(...request);
};
async function wave(side) {
  await tell("PUT", "stage", { waving: side });
  setTimeout(() => tell("PUT", "stage", { waving: "none" }), WAVE_MS);
}

// The true error of the last result, which no real cell knows.
function Truth() {
  const error = truth.value?.error_mm;
  if (!error) return html`<p class="muted">${t("stage-truth-none")}</p>`;
  const [x, y, z] = error.map((mm) => sign(1e3 * mm, 1));
  return html`<p>${t("stage-truth", { x, y, z })}</p>`;
}

export function Stage() {
  useFresh(() => glance(async () => (stage.value = await ask("GET", "stage"))));
  useEffect(() => {
    const timer = setInterval(compare, TRUTH_MS);
    return () => clearInterval(timer);
  }, []);
  const ghost = draft.value?.suggestion;
  useFollowing(ghost);
  if (!stage.value) return null;
  const { showing, waving, rings, board, still } = stage.value;
  const [, size, mm] = board.split(":");
  const [columns, rows] = size.split("x");
  const edge = number(Number(mm), Number.isInteger(Number(mm)) ? 0 : 1);
  return html`<aside class="stage" aria-label=${t("stage-title")}>
    <details>
      <summary>${t("stage-title")}</summary>
      <p>${t("stage-what")} ${t("stage-board", { columns, rows, mm: edge })}</p>
      <div class="actions">
        ${["board", "part", "nothing"].map(
          (what) => html`<button
            aria-pressed=${showing === what} onClick=${() => byHand("PUT", "stage", { showing: what })}
          >
            ${t(`stage-show-${what}`)}
          </button>`,
        )}
        <button onClick=${() => byHand("POST", "stage/lay", {})}>${t("stage-lay")}</button>
        <button
          aria-pressed=${still} disabled=${showing !== "board"}
          onClick=${() => byHand("PUT", "stage", { still: !still })}
        >
          ${t("stage-still")}
        </button>
        <button disabled=${!ghost} onClick=${() => bring(ghost)}>${t("stage-hand")}</button>
        <button
          aria-pressed=${isFollowing.value} onClick=${() => (isFollowing.value = !isFollowing.value)}
        >
          ${t("stage-follow")}
        </button>
        ${SIDES.map(
          (side) => html`<button aria-pressed=${waving === side} onClick=${() => wave(side)}>
            ${t(`stage-wave-${side}`)}
          </button>`,
        )}
      </div>
      <${Truth} />
      ${SIDES.map(
        (side) => html`<p>${t(`stage-ring-${side}`)}</p>
          <${Slider}
            label=${t(`stage-ring-${side}`)} value=${rings[side]} low=${-1} high=${1}
            describe=${(turn) => t("stage-ring", { turn: number(turn, 2) })}
            onValue=${(turn) => tell("PUT", "stage", { rings: { [side]: turn } })}
          />`,
      )}
    </details>
  </aside>`;
}
