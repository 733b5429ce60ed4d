// Which camera is which: what was found on the wire, live pictures, a wave of the hand, and a test pair.
import { effect, html, useEffect, useRef, useState } from "../vendor/ui.js";
import { ask, attempt } from "./api.js";
import { cameras, holds, lookAtCameras, pictures, SIDES, token } from "./live.js";
import { Pair } from "./picture.js";
import { say, Shape } from "./pieces.js";
import { has, number, t } from "./texts.js";

const LOOKED_AT_PX = 64;
const MOVED_GREY = 12; // per pixel, on the average of the picture: noise is below 3, a hand far above 20
const CLEARLY = 3; // times as much as in the other picture
const PICTURES = 4; // in a row: one flicker of a lamp is no hand

const other = (side) => (side === "left" ? "right" : "left");

// How much two pictures differ: the mean of the tenth that differs most, as a hand never fills a picture.
function change(before, now) {
  const differences = now.map((grey, i) => Math.abs(grey - before[i])).sort((a, b) => b - a);
  const tenth = differences.slice(0, Math.ceil(differences.length / 10));
  return tenth.reduce((sum, one) => sum + one, 0) / tenth.length;
}

function small(bitmap, canvas) {
  const height = Math.max(1, Math.round((bitmap.height * LOOKED_AT_PX) / bitmap.width));
  Object.assign(canvas, { width: LOOKED_AT_PX, height });
  const context = canvas.getContext("2d", { willReadFrequently: true });
  context.drawImage(bitmap, 0, 0, LOOKED_AT_PX, height);
  const { data } = context.getImageData(0, 0, LOOKED_AT_PX, height);
  return Array.from({ length: data.length / 4 }, (_, i) => data[4 * i]);
}

// Tells in which picture something moves, and nothing in the other.
function useMotion(isWatched, onMoved) {
  useEffect(() => {
    if (!isWatched) return undefined;
    const canvas = document.createElement("canvas");
    let before = null;
    let runs = { left: 0, right: 0 };
    return effect(() => {
      const [left, right] = SIDES.map((side) => pictures[side].value);
      if (!left || !right) return;
      const now = { left: small(left, canvas), right: small(right, canvas) };
      if (before) {
        const moved = { left: change(before.left, now.left), right: change(before.right, now.right) };
        for (const side of SIDES) runs[side] = moved[side] > MOVED_GREY && moved[side] > CLEARLY * moved[other(side)] ? runs[side] + 1 : 0;
        const found = SIDES.find((side) => runs[side] >= PICTURES);
        if (found) onMoved(found);
      }
      before = now;
    });
  }, [isWatched]);
}

const swap = () =>
  attempt(async () => {
    const { left, right } = cameras.value.configured;
    await ask("PUT", "cameras/left", { token: token.value, serial: right.serial });
    await ask("PUT", "cameras/right", { token: token.value, serial: left.serial });
    await lookAtCameras();
    return true;
  });

function Wave() {
  const [state, setState] = useState("idle"); // idle, watching, left, right, swapped
  useMotion(state === "watching", (side) => {
    setState(side);
    say(t(`wave-${side}`));
  });
  const start = useRef(null);
  return html`<section aria-labelledby="wave">
    <h2 id="wave">${t("wave-title")}</h2>
    <p>${t("wave-what")}</p>
    <p class="verdict" aria-live="polite">
      ${state === "watching" && html`<span class="pulse"><${Shape} is="hand" /></span> ${t("wave-now")}`} ${state === "left" && html`<${Shape} is="tick" /> ${t("wave-left")}`} ${state === "right" && html`<${Shape} is="doubt" /> ${t("wave-right")}`}
      ${state === "swapped" && html`<${Shape} is="tick" /> ${t("wave-swapped")}`}
    </p>
    <div class="actions">
      ${state === "right" && html`<button type="button" class="primary" onClick=${async () => (await swap()) && setState("swapped")}>${t("wave-swap")}</button>`}
      <button type="button" ref=${start} disabled=${!holds.value} onClick=${() => setState(state === "watching" ? "idle" : "watching")}>${t(state === "watching" ? "wave-stop" : state === "idle" ? "wave-start" : "wave-again")}</button>
    </div>
  </section>`;
}

function Test() {
  const [pair, setPair] = useState(null);
  const [isTaking, setTaking] = useState(false);
  const capture = async () => {
    setTaking(true);
    const taken = await attempt(() => ask("POST", "captures", { token: token.value }));
    setTaking(false);
    if (taken) {
      setPair(taken);
      say(t("test-skew", { skew: number(taken.skew_ms, 3) }));
    }
  };
  return html`<section aria-labelledby="test">
    <h2 id="test">${t("test-title")}</h2>
    <p>${t("test-what")}</p>
    <div class="actions"><button type="button" disabled=${!holds.value || isTaking} onClick=${capture}>${t("test-take")}</button></div>
    ${pair &&
    html`<p class="verdict"><${Shape} is=${pair.skew_ms < 1 ? "tick" : "doubt"} /> ${t("test-skew", { skew: number(pair.skew_ms, 3) })} ${t(pair.skew_ms < 1 ? "test-together" : "test-apart")}</p>
      <div class="pair">${SIDES.map((side) => html`<figure><figcaption>${t(side)}</figcaption><img src=${pair[side]} alt=${t(`test-${side}`)} /></figure>`)}</div>`}
  </section>`;
}

const inWords = (trouble) => {
  const id = `trouble-${String(trouble).replaceAll("_", "-")}`;
  return has(id) ? t(id) : trouble;
};

export function Cameras() {
  useEffect(() => {
    lookAtCameras();
  }, []);
  const found = cameras.value?.found;
  return html`<h1>${t("cameras-title")}</h1>
    <p class="lead">${t("cameras-what")}</p>
    <${Pair} />
    <section aria-labelledby="found">
      <h2 id="found">${t("cameras-found")}</h2>
      ${found && !found.length && html`<p>${t("cameras-none")}</p>`}
      <ul class="tiles">
        ${found?.map(
          ({ vendor, model, serial, address, trouble, side }) =>
            html`<li class="tile">
              <h3 translate=${false}>${vendor} ${model}</h3>
              <p class="muted" translate=${false}>${serial} · ${address}</p>
              <p>${side ? html`<${Shape} is="tick" /> ${t(`is-${side}`)}` : html`<${Shape} is="none" /> ${t("is-neither")}`}</p>
              ${trouble && html`<p class="wrong"><${Shape} is="doubt" /> ${inWords(trouble)}</p>`}
            </li>`,
        )}
      </ul>
      <div class="actions"><button type="button" onClick=${lookAtCameras}>${t("cameras-again")}</button></div>
    </section>
    <${Wave} />
    <${Test} />`;
}
