// Teaching a job: a pair, the features to measure by, the predicted precision, the release.
import { html, useEffect, useState } from "../../vendor/ui.js";
import { startRegression } from "../recordings/regression.js";
import { Releasing } from "../releases/releasing.js";
import { ask, attempt, glance, sentence } from "../shared/api.js";
import { Begun, Discard, discard } from "../shared/drafts.js";
import { useUndoKeys } from "../shared/keys.js";
import { cell, holds, look, mayTake, newest, SIDES, sign, token, useFresh } from "../shared/live.js";
import { Pair } from "../shared/picture.js";
import { Shape, say, useMainAction } from "../shared/pieces.js";
import { moment, t } from "../shared/texts.js";
import { Drawing } from "./drawing.js";
import {
  around,
  centre,
  extent,
  FeatureList,
  Features,
  featureAt,
  Outlines,
  Places,
  Predicted,
  toggle,
  Warnings,
} from "./features.js";
import { FurtherPairs } from "./further.js";
import { draws, Region, RegionTools, stroked, TOOLS, tapped, tool } from "./region.js";
import { Naming, Reference, Sizes, Tray } from "./sizes.js";
import { change, drafts, find, jobs, lit, lookAgain, open, pushed, see, teaching } from "./teaching.js";
import { box, lookAt, ZoomButtons, Zoomed } from "./zoom.js";

const ROOM = 1.3; // of the view, to the part found

// --- new ---

function Begin() {
  const [isTaking, setTaking] = useState(false);
  const begin = (body) =>
    attempt(async () => {
      sign();
      setTaking(true);
      try {
        open(await newest(pushed, ask("POST", "teachings", body)));
        tool.value = "tap";
        box.value = null;
      } finally {
        setTaking(false);
      }
    });
  const goOn = (id) => attempt(async () => open(await newest(pushed, ask("GET", `teachings/${id}`))));
  const known = (jobs.value ?? []).filter(({ retired }) => !retired);
  const fresh = { token: token.value };
  useMainAction(holds.value && !isTaking && t("teach-take"), () => begin(fresh));
  return html`<h1>${t("teach-title")}</h1>
    <p class="lead">${t("teach-what")}</p>
    <${Pair} />
    <section aria-labelledby="teach-begin">
      <h2 id="teach-begin">${t("teach-begin")}</h2>
      <p>${t("teach-begin-what")}</p>
      <div class="actions">
        <button class="primary big" disabled=${!holds.value || isTaking} onClick=${() => begin(fresh)}>
          ${t(isTaking ? "teach-taking" : "teach-take")}
        </button>
      </div>
      ${!holds.value && html`<p class="hint">${t("teach-take-cell")}</p>`}
    </section>
    <${Begun}
      drafts=${drafts.value ?? []} about=${({ name }) => ({ name, isGiven: true })}
      what=${t("teach-discard-what")} isDisabled=${!mayTake.value} onOpen=${goOn} onDiscard=${throwAway}
    />
    ${
      known.length > 0 &&
      html`<section aria-labelledby="teach-known">
        <h2 id="teach-known">${t("teach-known")}</h2>
        <p class="hint">${t("teach-known-what")}</p>
        <ul class="tiles">${known.map(
          ({ folder, name, number: count, editable }) =>
            html`<li class="tile" key=${name}>
              <h3 translate=${false}>${count} ${name}</h3>
              <div class="actions">
                <button
                  disabled=${!mayTake.value || isTaking || !editable}
                  aria-label=${t("teach-edit-job", { name })}
                  onClick=${() => startRegression({ job: folder })}
                >
                  ${t("teach-edit")}
                </button>
                <button
                  disabled=${!holds.value || isTaking} aria-label=${t("teach-again-job", { name })}
                  onClick=${() => startRegression({ ...fresh, job: folder })}
                >
                  ${t("teach-again")}
                </button>
              </div>
            </li>`,
        )}</ul>
      </section>`
    }`;
}

// --- the pictures ---

const PLACES = { reference: ([x, y]) => ({ reference: { x, y } }), gripping: (at) => ({ gripping: { at } }) };
async function tap(at, scale) {
  if (!mayTake.value) return;
  if (tool.value in PLACES) {
    if (await change("PUT", "", PLACES[tool.value](at))) say(t(`teach-place-${tool.value}-said`));
    tool.value = "choose";
  } else if (tool.value === "choose") {
    const feature = featureAt(at, scale);
    if (feature) await toggle(feature);
  } else tapped(at, scale);
}
const hover = (at, scale) => {
  lit.value = at && tool.value === "choose" ? (featureAt(at, scale)?.key ?? null) : null;
};

// The mean parallax, px, so that the right picture shows the same.
function parallax({ reference, features }) {
  if (reference?.left && reference?.right)
    return [reference.right[0] - reference.left[0], reference.right[1] - reference.left[1]];
  const both = features.find(({ outline }) => outline.left.length && outline.right?.length)?.outline;
  const middleOf = (line, i) => line.reduce((sum, at) => sum + at[i], 0) / line.length;
  return both ? [0, 1].map((i) => middleOf(both.right, i) - middleOf(both.left, i)) : [0, 0];
}

function Pictures({ size }) {
  const shift = parallax(teaching.value);
  const isEdited = TOOLS.includes(tool.value) && tool.value !== "tap";
  const over = (side) => (scale) =>
    html`${
      side === "left" &&
      (isEdited || !teaching.value.drawing) &&
      html`<${Region} scale=${scale} isEdited=${isEdited} />`
    }
      <${Outlines} side=${side} /><${Features} side=${side} scale=${scale} />
      <${Places} side=${side} scale=${scale} />`;
  return html`<div class="editor">
    <div class="tools" role="group" aria-label=${t("teach-tools")}>
      <button aria-pressed=${tool.value === "choose"} onClick=${() => (tool.value = "choose")}>
        ${t("teach-choose")}
      </button>
      <button aria-pressed=${TOOLS.includes(tool.value)} onClick=${() => (tool.value = "tap")}>
        ${t("teach-part")}
      </button>
      <${ZoomButtons} size=${size} />
    </div>
    ${
      TOOLS.includes(tool.value)
        ? html`<${RegionTools} size=${size} />`
        : html`<p class="hint">${t(`teach-now-${tool.value}`)}</p>`
    }
    <div class="pair">${SIDES.map(
      (side) => html`<div key=${side}>
        <figure>
          <figcaption>${t(side)}</figcaption>
          <${Zoomed}
            side=${side} size=${size} src=${teaching.value.pictures[side]}
            label=${t(`teach-picture-${side}`)} shift=${shift} tool=${tool.value} draw=${over(side)}
            onTap=${side === "left" ? tap : null}
            onStroke=${side === "left" && mayTake.value && draws() ? stroked : null}
            onHover=${side === "left" ? hover : null}
          />
        </figure>
        ${side === "right" && html`<${FeatureList} size=${size} />`}
      </div>`,
    )}</div>
  </div>`;
}

function Trouble() {
  const { proposing, trouble } = teaching.value;
  useEffect(() => {
    if (!proposing) return undefined;
    // also pushed; asked for in case a message was missed
    const timer = setInterval(async () => {
      const fresh = await glance(() => newest(pushed, ask("GET", `teachings/${teaching.value.id}`)));
      if (fresh) see(fresh);
    }, 2000);
    return () => clearInterval(timer);
  }, [proposing]);
  if (proposing || !trouble) return null;
  return html`<p class="wrong" role="alert">
    <${Shape} is="doubt" /> ${t("teach-trouble")} ${sentence({ ...trouble, detail: trouble.text })}
  </p>`;
}

// --- release ---

function Activate() {
  const [isAsked, setAsked] = useState(false);
  const [release, setRelease] = useState(null);
  const { id, name, proposing, features, predicted } = teaching.value;
  const done = async (made) => {
    setRelease(made);
    say(t("teach-activated", { name, number: made.number }));
    await look();
  };
  const isReady = features.some(({ taken }) => taken) && predicted && !proposing;
  return html`<section aria-labelledby="teach-job">
    <h2 id="teach-job">${t("teach-job")}</h2>
    <${Naming} />
    <div class="actions">
      <button class="primary big" disabled=${!isReady || !mayTake.value} onClick=${() => setAsked(true)}>
        ${t("teach-activate")}
      </button>
      <a class="button" href="#/try">${t("teach-try")}</a>
    </div>
    ${
      release &&
      html`<p class="verdict" role="status">
        <${Shape} is="tick" /> ${t("teach-activated", { name, number: release.number })}
      </p>`
    }
    ${
      isAsked &&
      html`<${Releasing}
        title=${t("teach-activate-title", { name })} label=${t("teach-activate")}
        suggested=${name}
        test=${() => startRegression({ teaching: id })}
        send=${(body) => ask("POST", `teachings/${id}/activate`, body)} onDone=${done}
        onClose=${() => setAsked(false)}
      >
        <p>${t("teach-activate-what")}</p>
      <//>`
    }
  </section>`;
}

// --- page ---

const step = (way) => async () =>
  (await change("POST", `/${way}`)) && say(t(way === "undo" ? "teach-undone" : "teach-redone"));
function Bar() {
  const { id, name, job, can_undo, can_redo, author, created } = teaching.value;
  useUndoKeys(mayTake.value && can_undo && step("undo"), mayTake.value && can_redo && step("redo"));
  return html`<div class="draft-bar">
    <p>
      <strong translate=${false}>${name}</strong> <span class="muted">
        <span translate=${false}>${moment(created)} · ${author}</span>
        ${job && html` · ${t("teach-changes", { job })}`}
      </span>
    </p>
    <div class="actions">
      <button disabled=${!can_undo || !mayTake.value} onClick=${step("undo")}>${t("teach-undo")}</button>
      <button disabled=${!can_redo || !mayTake.value} onClick=${step("redo")}>${t("teach-redo")}</button>
      <button onClick=${shut}>${t("teach-other")}</button>
      <${Discard}
        name=${name} what=${t("teach-discard-what")} isDisabled=${!mayTake.value}
        onDiscard=${() => throwAway(id)}
      />
    </div>
  </div>`;
}
function shut() {
  open(null);
  glance(find);
}
async function throwAway(id) {
  if (await discard("teachings", id)) shut();
}

export default function Teach() {
  useFresh(lookAgain);
  const id = teaching.value?.id;
  const isProposed = (teaching.value?.features.length ?? 0) > 0;
  useEffect(() => {
    if (!id) return;
    tool.value = isProposed ? "choose" : "tap"; // the next step, until another is chosen
    const { width, height, features } = teaching.value;
    if (isProposed) lookAt({ width, height }, centre(around(features)), ROOM * extent(around(features)));
  }, [id, isProposed]);
  if (cell.value.missing.includes("rig"))
    return html`<h1>${t("teach-title")}</h1><p class="lead">${t("teach-what")}</p>
      <p><${Shape} is="gap" /> ${t("teach-no-rig")}</p>
      <div class="actions"><a class="button primary" href="#/calibrate">${t("step-calibrate")}</a></div>`;
  if (!teaching.value) return html`<${Begin} />`;
  const size = { width: teaching.value.width, height: teaching.value.height };
  return html`<h1>${t("teach-title")}</h1>
    <${Bar} />
    <${Predicted} />
    <${Trouble} />
    <${Pictures} size=${size} />
    <div class="columns">
      <${Warnings} size=${size} />
      <${Reference} />
      <${Sizes} />
      <${Tray} />
      <${FurtherPairs} />
      <${Drawing} />
      <${Activate} />
    </div>`;
}
