// The releases of this cell, newest first, the way back to an older one, and the users.
import { html, signal, useState } from "../../vendor/ui.js";
import { Difference } from "../releases/difference.js";
import { ask, attempt, glance } from "../shared/api.js";
import { holds, look, mayTake, offers, token, useFresh } from "../shared/live.js";
import { Dialog, Shape, say } from "../shared/pieces.js";
import { moment, t } from "../shared/texts.js";
import { Care, Machine } from "./machine.js";
import { People } from "./people.js";

const releases = signal(null);
const find = () =>
  glance(async () => {
    releases.value = (await ask("GET", "releases")).releases;
  });

// The release in use is compared with its parent, any other with the one in use.
function Release({
  number,
  created,
  author,
  note,
  parent,
  rig,
  jobs,
  active,
  was_active,
  tested,
  inUse,
  onAsk,
}) {
  const [isOpen, setOpen] = useState(false);
  const other = active ? parent : inUse;
  return html`<li class="tile">
    <h3>
      ${t("release", { number })}${" "}
      ${active && html`<span class="now"><${Shape} is="tick" /> ${t("release-active")}</span>`}
    </h3>
    <p translate=${false}>${note}</p>
    <p class="muted">
      <span translate=${false}>${moment(created)} · ${author}</span>
      ${was_active && !active ? ` · ${t("release-was")}` : ""}
    </p>
    <dl class="facts">
      <dt>${t("fact-rig")}</dt><dd translate=${false}>${rig ?? "–"}</dd>
      <dt>${t("fact-jobs")}</dt><dd translate=${false}>${jobs.join(", ") || "–"}</dd>
    </dl>
    ${
      tested &&
      html`<p>
        <${Shape} is=${tested.signed ? "doubt" : "tick"} />${" "}
        ${t(tested.signed ? "release-signed" : "release-tested", { count: tested.cycles })}${" "}
        ${tested.signed && html`<span translate=${false}>${tested.signed}</span>`}
      </p>`
    }
    <div class="actions">
      ${
        !active &&
        html`<button
          disabled=${!mayTake.value} onClick=${onAsk} aria-label=${t("release-back-to", { number })}
        >
          ${t("release-back")}
        </button>`
      }
      ${
        other &&
        html`<button
          aria-expanded=${isOpen} aria-label=${t("diff-open-name", { number })}
          onClick=${() => setOpen(!isOpen)}
        >
          ${t("diff-open")}
        </button>`
      }
    </div>
    ${isOpen && html`<${Difference} from=${other} to=${number} />`}
  </li>`;
}

function Releases() {
  const [wanted, setWanted] = useState(null);
  const [reason, setReason] = useState("");
  useFresh(find);
  const activate = async () => {
    const number = wanted;
    setWanted(null);
    const done = await attempt(() =>
      ask("POST", `releases/${number}/activate`, { reason, ...(holds.value ? { token: token.value } : {}) }),
    );
    if (!done) return;
    say(t("release-back-done", { number: done.number })); // with the present jobs it may be another one
    setReason("");
    await find();
    await look();
  };
  return html`<section aria-labelledby="releases">
    <h2 id="releases">${t("releases-title")}</h2>
    <p class="hint">${t("releases-what")}</p>
    ${releases.value && !releases.value.length && html`<p>${t("releases-none")}</p>`}
    <ul class="tiles wide">
      ${releases.value?.map(
        (release) => html`<${Release}
          key=${release.number} ...${release} inUse=${releases.value.find(({ active }) => active)?.number}
          onAsk=${() => setWanted(release.number)}
        />`,
      )}
    </ul>
    <${Dialog}
      title=${t("release-ask-title", { number: wanted ?? "" })} isOpen=${wanted !== null}
      onClose=${() => setWanted(null)}
    >
      <p>${t("release-ask")}</p>
      <label class="field">
        <span>${t("release-reason")}</span>
        <input value=${reason} maxlength="200" onInput=${(event) => setReason(event.currentTarget.value)} />
      </label>
      <div class="actions">
        <button onClick=${() => setWanted(null)}>${t("back")}</button>
        <button class="primary" disabled=${!reason.trim()} onClick=${activate}>${t("release-back")}</button>
      </div>
    <//>
  </section>`;
}

export default () => html`<h1>${t("nav-system")}</h1>
  ${mayTake.value && offers("machine") && html`<${Machine} />`}
  ${offers("releases") && html`<${Releases} />`}
  ${mayTake.value && offers("backup") && html`<${Care} onRestored=${find} />`}
  <${People} />`;
