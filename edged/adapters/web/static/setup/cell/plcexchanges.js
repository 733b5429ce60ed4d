// The last commands of PLC or robot, each as a ladder: what, by whom, how long after.
import { html, useEffect, useState } from "../../vendor/ui.js";
import { ask } from "../shared/api.js";
import { Shape } from "../shared/pieces.js";
import { dashed, number, t } from "../shared/texts.js";

const EVERY_MS = 1000;
const NEWEST = 3; // older hints are out of date
const clock = (iso) => new Date(iso).toLocaleTimeString(undefined, { hour12: false });

function outcome({ rungs }) {
  const end = rungs.findLast(({ what }) => ["ack", "nack", "barred"].includes(what));
  if (!end) return ["busy", t("plc-open")];
  if (end.what === "nack") return ["gap", t(`plc-nack-${dashed(end.detail)}`)];
  if (end.what === "barred") return ["gap", t("plc-rung-barred")];
  const result = rungs.findLast(({ what }) => what === "result");
  if (!result) return ["tick", t("plc-rung-ack")];
  return [
    result.detail === "OK" || result.detail === "VERIFIED" || result.detail === "GRABBED" ? "tick" : "doubt",
    t(`plc-result-${dashed(result.detail)}`),
  ];
}

function rungInWords({ what, detail, valid }) {
  if (what === "nack") return `${t("plc-rung-nack")} ${t(`plc-nack-${dashed(detail)}`)}`;
  if (what === "result")
    return `${t("plc-rung-result")} ${t(`plc-result-${dashed(detail)}`)} ${valid ? t("plc-valid") : ""}`;
  return t(`plc-rung-${dashed(what)}`);
}

function Ladder({ one }) {
  return html`<ol class="ladder">${one.rungs.map(
    (rung, i) => html`<li key=${i} class=${rung.by}>
      <span class="muted">${t("plc-after", { ms: number(rung.after_ms, rung.after_ms < 100 ? 1 : 0) })}</span>
      <span class="who">${t(rung.by === "plc" ? "plc-by-plc" : "plc-by-cell")}</span>
      <span class="said">
        ${
          rung.what === "command"
            ? html`<span translate=${false}>
              ${one.command || `COMMAND ${one.code}`}, JOB ${one.job}, CMD_SEQ ${one.sequence}
            </span>`
            : rungInWords(rung)
        }
      </span>
    </li>`,
  )}</ol>`;
}

export function Exchanges() {
  const [all, setAll] = useState(null);
  useEffect(() => {
    let timer = 0;
    const look = async () => {
      try {
        setAll((await ask("GET", "plc/exchanges")).exchanges);
      } catch {
        // the head of the page reports the lost connection
      }
      timer = timer === null ? null : setTimeout(look, EVERY_MS);
    };
    look();
    return () => {
      clearTimeout(timer);
      timer = null;
    };
  }, []);
  const hints = [
    ...new Set(
      (all ?? [])
        .slice(0, NEWEST)
        .map(({ hint }) => hint)
        .filter(Boolean),
    ),
  ];
  return html`<section aria-labelledby="plc-exchanges">
    <h2 id="plc-exchanges">${t("plc-exchanges")}</h2>
    <p class="hint">${t("plc-exchanges-what")}</p>
    ${hints.map(
      (hint) => html`<p key=${hint} class="verdict">
        <${Shape} is="gap" /> ${t(`plc-hint-${hint}`)}
      </p>`,
    )}
    ${all?.length === 0 && html`<p class="muted">${t("plc-exchanges-none")}</p>`}
    <div class="plc-exchanges">
      ${(all ?? []).map((one, i) => {
        const [shape, words] = outcome(one);
        return html`<details key=${one.number} open=${i === 0}>
          <summary>
            <${Shape} is=${shape} />${" "}
            <span class="when" translate=${false}>${clock(one.at)} ${one.client}</span>${" "}
            <strong translate=${false}>${one.command || `COMMAND ${one.code}`} ${one.sequence}</strong>${" "}
            <span>${words}</span>
            ${one.times > 1 && html` <span class="muted">${t("plc-times", { count: one.times })}</span>`}
          </summary>
          <${Ladder} one=${one} />
        </details>`;
      })}
    </div>
  </section>`;
}
