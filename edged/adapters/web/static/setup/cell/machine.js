// The machine under the cell: what edged doctor finds, with what helps; backups; a file for who helps.
import { html, useState } from "../../vendor/ui.js";
import { Releasing } from "../releases/releasing.js";
import { ask, attempt, glance } from "../shared/api.js";
import { holds, look, token, useFresh } from "../shared/live.js";
import { Shape, say } from "../shared/pieces.js";
import { moment, t } from "../shared/texts.js";

const SHAPES = { ok: "tick", warn: "doubt", bad: "gap", skip: "none" };
const isTrouble = ({ verdict }) => verdict === "warn" || verdict === "bad";

const MOST_OFF_MS = 2000; // a request and its answer on a slow network

// What is set on the machine alone: the page has no right to, and whoever takes it over has none either.
function Kept({ version, now, took }) {
  const off = Math.abs(new Date(now).getTime() - took);
  const isOff = off > MOST_OFF_MS;
  return html`<h3>${t("machine-kept")}</h3>
    <p class="hint">${t("machine-kept-how")}</p>
    <dl class="facts">
      <dt>${t("machine-software")}</dt>
      <dd translate=${false}>
        edged ${version}<br />
        <code lang="en">sudo tools/install</code><br />
        <code lang="en">sudo tools/install --rollback</code>
      </dd>
      <dt>${t("machine-clock")}</dt>
      <dd>
        <span translate=${false}>${moment(now)}</span>${" "}
        <${Shape} is=${isOff ? "doubt" : "tick"} />${" "}
        ${isOff ? t("machine-clock-off", { s: Math.round(off / 1000) }) : t("machine-clock-same")}<br />
        <code lang="en" translate=${false}>sudo timedatectl set-ntp true</code>
      </dd>
      <dt>${t("machine-network")}</dt>
      <dd><code lang="en" translate=${false}>sudo nmtui</code></dd>
    </dl>`;
}

// A command is copied where the browser lets pages do that: over TLS, or on the machine itself.
function Remedy({ text }) {
  const copy = async () => {
    await navigator.clipboard.writeText(text);
    say(t("machine-copied"));
  };
  return html`<p>${t("machine-help")} <code lang="en" translate=${false}>${text}</code></p>
    ${
      navigator.clipboard &&
      html`<div class="actions"><button type="button" onClick=${copy}>${t("machine-copy")}</button></div>`
    }`;
}

// What the page can do itself stands as a button in place of the command.
function Check({ check, isBusy, onMend }) {
  const { name, verdict, finding, consequence, remedy, mend } = check;
  const [what] = mend.split(" ");
  return html`<li class=${verdict}>
    <p>
      <${Shape} is=${SHAPES[verdict] ?? "none"} /> <strong lang="en" translate=${false}>${name}</strong>${" "}
      <span class="muted">${t(`machine-${verdict}`)}</span>
    </p>
    <p lang="en" translate=${false}>${finding}</p>
    ${
      isTrouble(check) &&
      html`<p>${t("machine-then")} <span lang="en" translate=${false}>${consequence}</span></p>
        ${
          what
            ? html`<div class="actions">
              <button
                type="button" disabled=${isBusy || (what === "address" && !holds.value)} onClick=${onMend}
              >
                ${t(`machine-mend-${what}`)}
              </button>
            </div>`
            : html`<${Remedy} text=${remedy} />`
        }`
    }
  </li>`;
}

export function Machine() {
  const [found, setFound] = useState({ at: null, checks: [], version: "", now: "", took: 0 });
  const [isBusy, setBusy] = useState(false);
  useFresh(() => glance(async () => setFound({ ...(await ask("GET", "machine")), took: Date.now() })));
  const doing = async (work) => {
    setBusy(true);
    const next = await attempt(work);
    setBusy(false);
    if (next) setFound({ ...next, took: Date.now() });
    return next;
  };
  const examine = () => doing(() => ask("POST", "machine/examination"));
  const mend =
    ({ mend: wanted }) =>
    async () => {
      const [what, serial] = wanted.split(" ");
      const done = await doing(async () => {
        if (what !== "address") return ask("POST", "machine/mend", { what });
        await ask("POST", "cameras/address", { token: token.value, serial });
        return ask("POST", "machine/examination");
      });
      if (done) say(t("machine-mended"));
    };
  const { at, checks } = found;
  const list = (some) => html`<ul class="checks">
    ${some.map(
      (check, i) => html`<${Check} key=${i} check=${check} isBusy=${isBusy} onMend=${mend(check)} />`,
    )}
  </ul>`;
  const count = (verdict) => checks.filter((check) => check.verdict === verdict).length;
  return html`<section aria-labelledby="machine">
    <h2 id="machine">${t("machine-title")}</h2>
    <p class="hint">${t("machine-what")}</p>
    ${at && html`<p>${t("machine-at", { at: moment(at), bad: count("bad"), warn: count("warn") })}</p>`}
    ${list(checks.filter(isTrouble))}
    <div class="actions">
      <button disabled=${isBusy} onClick=${examine}>
        ${t(isBusy ? "machine-examining" : "machine-examine")}
      </button>
    </div>
    ${
      at &&
      html`<details>
        <summary>${t("machine-rest", { count: checks.filter((check) => !isTrouble(check)).length })}</summary>
        ${list(checks.filter((check) => !isTrouble(check)))}
      </details>`
    }
    ${found.version && html`<${Kept} ...${found} />`}
  </section>`;
}

// The file keeps the name that the cell gave it.
function keep(file) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(file);
  link.download = file.name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
}

function Archive({ archive, onUse }) {
  const {
    cell,
    created,
    version,
    rig,
    jobs,
    left_out: leftOut,
    is_same: isSame,
    fits_map: fitsMap,
  } = archive;
  const missing = Object.keys(leftOut);
  return html`<p class="verdict">
      <${Shape} is="tick" />${" "}
      <span translate=${false}>${cell} · ${moment(created)} · edged ${version}</span>
    </p>
    <dl class="facts">
      <dt>${t("fact-rig")}</dt><dd translate=${false}>${rig}</dd>
      <dt>${t("fact-jobs")}</dt><dd translate=${false}>${jobs.join(", ") || "–"}</dd>
      ${
        missing.length > 0 &&
        html`<dt>${t("restore-left-out")}</dt>
          <dd translate=${false}>${missing.join(", ")}</dd>`
      }
    </dl>
    ${!fitsMap && html`<p><${Shape} is="doubt" /> ${t("restore-map")}</p>`}
    ${isSame && html`<p><${Shape} is="tick" /> ${t("restore-same")}</p>`}
    <div class="actions">
      <button class="primary" disabled=${isSame} onClick=${onUse}>${t("restore-use")}</button>
    </div>`;
}

export function Care({ onRestored }) {
  const [busy, setBusy] = useState("");
  const [archive, setArchive] = useState(null);
  const [isAsked, setAsked] = useState(false);
  const during = async (what, work) => {
    setBusy(what);
    const made = await attempt(work);
    setBusy("");
    return made;
  };
  const get = (what) => async () => {
    const file = await during(what, () => ask("POST", what));
    if (file) keep(file);
  };
  const choose = async (input) => {
    const [file] = input.files;
    if (!file) return;
    setArchive(null);
    const checked = await during("restore", () => ask("PUT", "backup", file));
    input.value = ""; // so that choosing the same file again counts as a change
    if (checked) setArchive(checked);
  };
  const restored = async ({ number }) => {
    setArchive(null);
    say(t("release-back-done", { number }));
    await onRestored();
    await look();
  };
  return html`<section aria-labelledby="care">
    <h2 id="care">${t("care-title")}</h2>
    <p class="hint">${t("backup-what")}</p>
    <div class="actions">
      <button disabled=${Boolean(busy)} onClick=${get("backup")}>
        ${t(busy === "backup" ? "release-making" : "backup-get")}
      </button>
    </div>
    <p class="hint">${t("restore-what")}</p>
    <div class="actions">
      <label class="button upload ${busy ? "closed" : ""}">
        <span>${t(busy === "restore" ? "restore-checking" : "restore-choose")}</span>
        <input
          type="file" name="archive" accept=".tar.gz,.tgz,.gz" disabled=${Boolean(busy)}
          onChange=${({ currentTarget }) => choose(currentTarget)}
        />
      </label>
    </div>
    ${archive && html`<${Archive} archive=${archive} onUse=${() => setAsked(true)} />`}
    ${
      isAsked &&
      archive &&
      html`<${Releasing}
        title=${t("restore-title")} label=${t("restore-use")}
        onClose=${() => setAsked(false)} onDone=${restored}
        send=${(body) => ask("POST", "backup/activate", { ...body, digest: archive.digest })}
      >
        <p>${t("release-ask")}</p>
      <//>`
    }
    <p class="hint">${t("support-what")}</p>
    <div class="actions">
      <button disabled=${Boolean(busy)} onClick=${get("support")}>
        ${t(busy === "support" ? "release-making" : "support-get")}
      </button>
    </div>
  </section>`;
}
