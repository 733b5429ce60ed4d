// Calibration: the board, hands-free views until the goal is reached, the solution and its release.
import { html, signal, useEffect, useRef, useState } from "../../vendor/ui.js";
import { startRegression } from "../recordings/regression.js";
import { Releasing } from "../releases/releasing.js";
import { ask, attempt, glance, sentence } from "../shared/api.js";
import { BoardFields, PitchField, SIZE, specOf } from "../shared/board.js";
import { Begun, Discard, discard, putAside, unfinished } from "../shared/drafts.js";
import {
  draft,
  holds,
  look,
  mayTake,
  newest,
  offers,
  sign,
  token,
  useFresh,
  useTask,
} from "../shared/live.js";
import { Pair, points } from "../shared/picture.js";
import { Failed, NumberField, Shape, say, useKept, useMainAction } from "../shared/pieces.js";
import { inWords, number, t } from "../shared/texts.js";
import { Filmstrip, short } from "./filmstrip.js";

const GOAL_UM = 5;
const FEW = 3; // least number of views
const worst = (sigma) => (sigma ? Math.max(...["x", "y", "z"].map((axis) => sigma[axis] ?? 0)) : null);
const micrometres = (value) => number(value, value < 9.5 ? 1 : 0);
const place = () => `calibrations/${draft.value.id}`;
const change = (method, path, body = {}) =>
  attempt(async () => {
    draft.value = await newest(draft, ask(method, `${place()}${path}`, body));
    return true;
  });

const KIND = "calibrations";
const drafts = signal([]);
async function list() {
  ({ calibrations: drafts.value } = await ask("GET", KIND));
}

// Opens the unfinished draft, unless another one was opened while it was looked for.
async function find() {
  const before = draft.peek();
  await list();
  const begun = unfinished(KIND, drafts.value);
  const found = begun && (await newest(draft, ask("GET", `${KIND}/${begun.id}`)));
  if (draft.peek() === before) draft.value = found;
}

// Automatic views end first: views of the next board do not belong to this one.
const another = () =>
  attempt(async () => {
    if (draft.value.auto && holds.value)
      draft.value = await ask("PUT", `${place()}/auto`, { token: token.value, on: false });
    await list();
    putAside(KIND, drafts.value);
    draft.value = null;
  });
async function throwAway(id) {
  await glance(list);
  putAside(KIND, drafts.value);
  if (!(await discard(KIND, id))) return;
  if (draft.value?.id === id) draft.value = null;
  await glance(list);
}
const goOn = (id) =>
  attempt(async () => {
    draft.value = await newest(
      draft,
      mayTake.value ? ask("POST", `${KIND}/${id}/go-on`) : ask("GET", `${KIND}/${id}`),
    );
  });

const nameOf = ({ boards: specs, id }) => (specs.length ? specs.join(", ") : t("calibrate-nameless", { id }));
const inTile = (line) => ({
  name: nameOf(line),
  isGiven: line.boards.length > 0,
  more: t("calibrate-begun-views", { views: line.views }),
});

// --- which board ---

function Board() {
  const [isStated, setStated] = useKept("calibrate-stated", false);
  const [mm, setMm] = useKept("calibrate-mm", null);
  const [goal, setGoal] = useKept("calibrate-goal", GOAL_UM);
  const [size, setSize] = useKept("calibrate-size", SIZE);
  const begin = (isAuto) =>
    attempt(async () => {
      draft.value = await newest(
        draft,
        ask("POST", "calibrations", {
          ...(isStated ? { boards: [specOf(size, mm)] } : { recognise: true, mm }),
          goal_um: goal,
        }),
      );
      if (isAuto) await change("PUT", "/auto", { token: token.value, on: true });
    });
  return html`<section aria-labelledby="board">
    <h2 id="board">${t("board-title")}</h2>
    <div class="choices" role="radiogroup" aria-label=${t("board-title")}>
      ${[false, true].map(
        (stated) => html`<label class="choice">
          <input
            type="radio" name="board" checked=${isStated === stated} onChange=${() => setStated(stated)}
          /> ${t(stated ? "board-state" : "board-recognise")}
        </label>`,
      )}
    </div>
    ${isStated && html`<${BoardFields} size=${size} onSize=${setSize} />`}
    <div class="row">
      <${PitchField} size=${size} mm=${mm} onMm=${setMm} />
      <${NumberField}
        label=${t("board-goal")} unit="µm" digits=${1} low=${0.1} high=${1000} value=${goal}
        onValue=${setGoal} name="goal" isForm
      />
    </div>
    <p class="hint"><${Shape} is="doubt" /> ${t("board-proof")}</p>
    <div class="actions">
      <button class="primary" disabled=${mm === null || !holds.value} onClick=${() => begin(true)}>
        ${t("board-begin-auto")}
      </button>
      <button disabled=${mm === null || !mayTake.value} onClick=${() => begin(false)}>
        ${t("board-begin")}
      </button>
    </div>
  </section>`;
}

// --- view by view ---

const why = (code) => inWords("why", code);

// "upper-left.near.lower-away": where in the picture, how far, and how it is tilted.
function placed(code) {
  const [at, far, tilt] = code.split(".");
  return [inWords("at", at), inWords("far", far), inWords("tilt", tilt)].join(", ");
}

// The suggested board dashed, the seen one solid, both labelled.
function boards(side) {
  const seen = draft.value.shown?.[side];
  const ghost = draft.value.suggestion?.[side];
  const label = (polygon, key) => {
    const [x, y] = polygon.reduce((top, corner) => (corner[1] < top[1] ? corner : top));
    return html`<text x=${x} y=${y - 12}>${t(key)}</text>`;
  };
  return html`${
    ghost?.length > 0 &&
    html`<g class="ghost">
        <polygon points=${points(ghost)} style=${{ fillOpacity: 0.1 + 0.5 * (draft.value.in_ghost ?? 0) }} />
        ${label(ghost, "ghost-here")}
      </g>`
  }
    ${
      seen?.polygon &&
      html`<g class="seen ${seen.clipped ? "clipped" : ""}">
        <polygon points=${points(seen.polygon)} />
        ${seen.polygon.map(([x, y]) => html`<circle cx=${x} cy=${y} r="7" />`)}
      </g>`
    }`;
}

// A board of another size is recognised at once.
function whyUnseen({ missing, other_board }) {
  if (!other_board) return inWords("missing", missing);
  const [kind, size] = other_board.split(":");
  return t("other-board", { board: `${inWords("kind", kind)} ${size.replace("x", " × ")}` });
}

function Seen({ side }) {
  const seen = draft.value.shown?.[side];
  if (!seen) return null;
  const shape = seen.clipped ? "doubt" : seen.polygon ? "tick" : "gap";
  return html`<p class="verdict small">
    <${Shape} is=${shape} />${" "}
    ${seen.clipped ? t("seen-clipped") : seen.polygon ? t("seen-whole") : whyUnseen(seen)}
  </p>`;
}

let audio = null;
function beep() {
  audio ??= new AudioContext();
  const [tone, gain] = [audio.createOscillator(), audio.createGain()];
  tone.frequency.value = 880;
  gain.gain.setValueAtTime(0.3, audio.currentTime);
  gain.gain.exponentialRampToValueAtTime(0.001, audio.currentTime + 0.25);
  tone.connect(gain).connect(audio.destination);
  tone.start();
  tone.stop(audio.currentTime + 0.25);
}

const isReached = ({ sigma_um, goal_um }) =>
  goal_um !== null && worst(sigma_um) !== null && worst(sigma_um) <= goal_um;

const SOUND = "edged.sound";
function Figure() {
  const { sigma_um, suggestion, goal_um, more_views, views, trouble, guiding } = draft.value;
  const used = views.filter((view) => view.used).length;
  const now = worst(sigma_um);
  const then = worst(suggestion?.sigma_um);
  if (now === null)
    return html`<p class="big figure">${t("sigma-unknown", { used })}</p>
      ${
        trouble &&
        used >= FEW &&
        html`<p class="hint">
          <${Shape} is="doubt" /> ${sentence({ ...trouble, detail: trouble.text })}
        </p>`
      }`;
  return html`<p class="big figure" role="status">
    ${t("sigma-now", { now: micrometres(now) })}
    ${then !== null && html`, ${t("sigma-then", { next: micrometres(then) })}`}
    ${
      goal_um !== null &&
      html`,${" "}
        ${t("sigma-goal", { goal: number(goal_um, Number.isInteger(goal_um) ? 0 : 1) })}`
    }:${" "}
    <strong>
      ${
        isReached(draft.value)
          ? t("sigma-reached")
          : more_views
            ? t("sigma-more", { count: more_views })
            : t("sigma-on")
      }
    </strong> ${guiding && html`<span class="muted small">${t("sigma-again")}</span>`}
  </p>`;
}

function Capture() {
  const { views, still, in_ghost, auto, suggestion, waits } = draft.value;
  const [hasSound, setSound] = useState(localStorage.getItem(SOUND) === "on");
  const [isFlashing, setFlashing] = useState(false);
  const count = useRef(views.length);
  useEffect(() => {
    if (views.length > count.current) {
      const { used, why: code, name } = views[views.length - 1];
      say(
        used
          ? t("view-taken", { name: short(name) })
          : t("view-refused", { name: short(name), why: why(code) }),
      );
      sign(); // holding the board counts as activity
      setFlashing(true);
      setTimeout(() => setFlashing(false), 300);
      if (hasSound) beep();
    }
    count.current = views.length;
  }, [views.length]);
  const mute = () => {
    localStorage.setItem(SOUND, hasSound ? "off" : "on");
    if (!hasSound) beep(); // browsers need a click before they play sounds
    setSound(!hasSound);
  };
  const share = Math.round(100 * (in_ghost ?? 0));
  const take = () => change("PUT", "/auto", { token: token.value, on: !auto });
  const isDue = holds.value && !auto && !draft.value.solved && !isReached(draft.value);
  useMainAction(isDue && t("auto-start"), take);
  return html`<div class="capture">
    ${isFlashing && html`<div class="flash" aria-hidden="true"></div>`}
    ${
      suggestion &&
      html`<label class="meter">
          <span>${t("ghost-share", { percent: number(share) })}</span>
          <progress max="100" value=${share}></progress>
        </label>
        ${
          suggestion.text_code &&
          html`<p class="hint">
            ${t("ghost-where")} ${placed(suggestion.text_code)}.
          </p>`
        }`
    }
    <p class="verdict small">
      <${Shape} is=${(auto && waits) || !still ? "none" : "tick"} />${" "}
      ${auto && waits ? inWords("waits", waits) : t(still ? "board-still" : "board-moves")}
    </p>
    <div class="actions">
      <button
        class=${auto ? "" : "primary"} aria-pressed=${Boolean(auto)} disabled=${!holds.value}
        onClick=${take}
      >
        ${t(auto ? "auto-stop" : "auto-start")}
      </button>
      <button disabled=${!holds.value} onClick=${() => change("POST", "/views", { token: token.value })}>
        ${t("view-take")}
      </button>
      <button aria-pressed=${hasSound} onClick=${mute}>${t(hasSound ? "sound-on" : "sound-off")}</button>
    </div>
    <div class="row">
      <${NumberField}
        label=${t("board-goal")} unit="µm" digits=${1} low=${0.1} high=${1000} value=${draft.value.goal_um}
        disabled=${!mayTake.value} onValue=${(goal_um) => change("PUT", "", { goal_um })} name="goal"
      />
    </div>
  </div>`;
}

// --- solution and release ---

function Progress({ id, onDone }) {
  const state = useTask(id, onDone);
  return html`<div class="task">
    <label class="meter">
      <span>
        ${t("solve-running")}${" "}
        ${state?.text && html`<span class="muted" translate=${false}>${state.text}</span>`}
      </span><progress max="1" value=${state?.done ?? undefined}></progress>
    </label>
    <div class="actions">
      <button onClick=${() => attempt(() => ask("DELETE", `tasks/${id}`, {}))}>${t("solve-cancel")}</button>
    </div>
  </div>`;
}

function Solve() {
  const { views, task: running, solved } = draft.value;
  const [ended, setEnded] = useState(null);
  const used = views.filter((view) => view.used).length;
  const solve = () =>
    attempt(async () => {
      setEnded(null);
      const { task: id } = await ask("POST", `${place()}/solve`, {});
      draft.value = { ...draft.value, task: id, solved: null };
    });
  const isDue = mayTake.value && !running && !solved && used >= FEW && isReached(draft.value);
  useMainAction(isDue && t("solve-start"), solve);
  const done = async (state) => {
    setEnded(state);
    await glance(async () => {
      draft.value = await newest(draft, ask("GET", place()));
    });
    say(t(`solve-${state.state}`));
  };
  return html`<section aria-labelledby="solve">
    <h2 id="solve">${t("solve-title")}</h2>
    ${
      running
        ? html`<${Progress} id=${running} onDone=${done} />`
        : html`<p>${t("solve-what", { used })}</p>
          <div class="actions">
            <button
              class=${solved ? "" : "primary"} disabled=${used < FEW || !mayTake.value} onClick=${solve}
            >
              ${t(solved ? "solve-again" : "solve-start")}
            </button>
          </div>`
    }
    ${ended?.state === "failed" && html`<${Failed} text=${t("solve-failed")} ended=${ended} />`}
    ${ended?.state === "cancelled" && html`<p>${t("solve-cancelled")}</p>`}
    ${solved && !running && html`<${Solved} ...${solved} />`}
  </section>`;
}

function Solved({ rms_px, heldout_px, sigma_um, moved_um, verdict, figures }) {
  const [isAsked, setAsked] = useState(false);
  const [release, setRelease] = useState(null);
  const done = async (made) => {
    setRelease(made);
    await look();
  };
  const mayUse = mayTake.value && offers("calibrations/{id}/activate");
  useMainAction(mayUse && !release && !draft.value.active && verdict !== "repeat" && t("activate"), () =>
    setAsked(true),
  );
  return html`<p class="verdict">
      <${Shape} is=${verdict === "good" ? "tick" : verdict === "usable" ? "doubt" : "gap"} />${" "}
      ${inWords("verdict", verdict)}
    </p>
    ${[...(figures?.verdict ?? []), ...(figures?.lens ? [figures.lens] : [])].map(
      (text) => html`<p class="hint" translate=${false} lang="en">${text}</p>`,
    )}
    <dl class="facts">
      <dt>${t("solved-rms")}</dt><dd>${number(rms_px, 3)} px</dd>
      <dt>${t("solved-heldout")}</dt><dd>${number(heldout_px, 3)} px</dd>
      <dt>${t("solved-sigma")}</dt><dd>± ${micrometres(worst(sigma_um))} µm</dd>
      ${
        moved_um !== null &&
        moved_um !== undefined &&
        html`<dt>${t("solved-moved")}</dt>
          <dd>${micrometres(moved_um)} µm</dd>`
      }
    </dl>
    <div class="actions">
      <a class="button" href="/api/v1/${place()}/report" target="_blank" rel="noopener">
        ${t("solved-report")}
      </a>
      ${
        offers("calibrations/{id}/activate") &&
        html`<button
          class=${verdict === "repeat" ? "" : "primary"} disabled=${!mayTake.value}
          onClick=${() => setAsked(true)}
        >
          ${t("activate")}
        </button>`
      }
    </div>
    ${
      release &&
      html`<p class="verdict" role="status">
        <${Shape} is="tick" /> ${t("activated", { number: release.number })}
      </p>`
    }
    ${
      isAsked &&
      html`<${Releasing}
        title=${t("activate-title")} label=${t("activate")}
        suggested=${t("activate-note", { sigma: micrometres(worst(sigma_um)) })}
        test=${() => startRegression({ calibration: draft.value.id })}
        send=${(body) => ask("POST", `${place()}/activate`, body)} onDone=${done}
        onClose=${() => setAsked(false)}
      >
        <p>${t("activate-what")}</p>
      <//>`
    }`;
}

export default function Calibrate() {
  useFresh(() => (!draft.value || draft.value.active) && glance(find), [draft.value === null]);
  if (!draft.value)
    return html`<h1>${t("calibrate-title")}</h1><p class="lead">${t("calibrate-what")}</p><${Pair} />
      <${Board} />
      <${Begun}
        drafts=${drafts.value} about=${inTile} what=${t("calibrate-discard-what")}
        isDisabled=${!mayTake.value} onOpen=${goOn} onDiscard=${throwAway}
      />`;
  const { id, boards: specs } = draft.value;
  return html`<h1>${t("calibrate-title")}</h1>
    <div class="draft-bar">
      <p class="lead">
        ${
          specs.length
            ? html`${t("calibrate-board")}${" "}
              <span translate=${false}>${specs.join(", ")}</span>`
            : t("calibrate-looking")
        }
      </p>
      <div class="actions">
        <button disabled=${!mayTake.value} onClick=${another}>${t("calibrate-new")}</button>
        <${Discard}
          name=${nameOf(draft.value)} what=${t("calibrate-discard-what")} isDisabled=${!mayTake.value}
          onDiscard=${() => throwAway(id)}
        />
      </div>
    </div>
    <${Figure} />
    <${Pair} over=${boards} below=${(side) => html`<${Seen} side=${side} />`} />
    <${Capture} key=${id} />
    <${Filmstrip} change=${change} why=${why} />
    <${Solve} key=${`solve ${id}`} />`;
}
