// What runs: the releases of this cell, newest first, and the way back to an older one.
import { html, signal, useEffect, useState } from "../../vendor/ui.js";
import { ask, attempt } from "../api.js";
import { holds, look, mayTake, offers, token } from "../live.js";
import { People } from "./people.js";
import { Dialog, say, Shape } from "../pieces.js";
import { moment, t } from "../texts.js";
import { styled } from "./styles.js";

await styled("system");

const releases = signal(null);
const find = () =>
  attempt(async () => {
    releases.value = (await ask("GET", "releases")).releases;
  });

function Release({ number, created, author, note, rig, jobs, active, was_active, onAsk }) {
  return html`<li class="tile">
    <h3>${t("release", { number })} ${active && html`<span class="now"><${Shape} is="tick" /> ${t("release-active")}</span>`}</h3>
    <p translate=${false}>${note}</p>
    <p class="muted"><span translate=${false}>${moment(created)} · ${author}</span> ${was_active && !active ? t("release-was") : ""}</p>
    <dl class="facts">
      <dt>${t("fact-rig")}</dt><dd translate=${false}>${rig ?? "–"}</dd>
      <dt>${t("fact-jobs")}</dt><dd translate=${false}>${jobs.join(", ") || "–"}</dd>
    </dl>
    ${!active && html`<div class="actions"><button type="button" disabled=${!mayTake.value} onClick=${onAsk} aria-label=${t("release-back-to", { number })}>${t("release-back")}</button></div>`}
  </li>`;
}

function Releases() {
  const [wanted, setWanted] = useState(null);
  const [reason, setReason] = useState("");
  useEffect(() => {
    find();
  }, []);
  const activate = async () => {
    const number = wanted;
    setWanted(null);
    const done = await attempt(() => ask("POST", `releases/${number}/activate`, { reason, ...(holds.value ? { token: token.value } : {}) }));
    if (!done) return;
    say(t("release-back-done", { number }));
    setReason("");
    await find();
    await look();
  };
  return html`<section aria-labelledby="releases">
    <h2 id="releases">${t("releases-title")}</h2>
    <p class="hint">${t("releases-what")}</p>
    ${releases.value && !releases.value.length && html`<p>${t("releases-none")}</p>`}
    <ul class="tiles wide">
      ${releases.value?.map((release) => html`<${Release} key=${release.number} ...${release} onAsk=${() => setWanted(release.number)} />`)}
    </ul>
    <${Dialog} title=${t("release-ask-title", { number: wanted ?? "" })} isOpen=${wanted !== null} onClose=${() => setWanted(null)}>
      <p>${t("release-ask")}</p>
      <label class="field"><span>${t("release-reason")}</span><input value=${reason} maxlength="200" onInput=${(event) => setReason(event.currentTarget.value)} /></label>
      <div class="actions"><button type="button" onClick=${() => setWanted(null)}>${t("back")}</button><button type="button" class="primary" disabled=${!reason.trim()} onClick=${activate}>${t("release-back")}</button></div>
    <//>
  </section>`;
}

export default () => html`<h1>${t("nav-system")}</h1>
  ${offers("releases") && html`<${Releases} />`}
  <${People} />`;
