// Which camera is which: cameras found, live pictures, a wave of the hand, and a test pair.
import { html, useState } from "../../vendor/ui.js";
import { ask, attempt } from "../shared/api.js";
import { cameras, holds, lookAtCameras, mayTake, SIDES, token, useFresh } from "../shared/live.js";
import { Pair } from "../shared/picture.js";
import { Shape, say } from "../shared/pieces.js";
import { inWords, number, t } from "../shared/texts.js";
import { Keep } from "./keepsettings.js";

// The cell compares whole pictures, and exchanges the cameras if they are swapped.
function Wave() {
  const [state, setState] = useState("idle"); // idle, watching, nobody, right (as it is), swapped
  const watch = async () => {
    setState("watching");
    const waved = await attempt(() => ask("POST", "cameras/wave", { token: token.value, side: "left" }));
    const seen = !waved ? "idle" : !waved.moved ? "nobody" : waved.exchanged ? "swapped" : "right";
    setState(seen);
    if (seen !== "idle") say(t(`wave-${seen}`));
    await lookAtCameras();
  };
  const SHAPE = { nobody: "doubt", right: "tick", swapped: "tick" };
  return html`<section aria-labelledby="wave">
    <h2 id="wave">${t("wave-title")}</h2>
    <p>${t("wave-what")}</p>
    ${
      state === "watching" &&
      html`<p class="verdict">
        <span class="pulse"><${Shape} is="hand" /></span> ${t("wave-now")}
      </p>`
    }
    ${state in SHAPE && html`<p class="verdict"><${Shape} is=${SHAPE[state]} /> ${t(`wave-${state}`)}</p>`}
    <div class="actions">
      <button disabled=${!holds.value || state === "watching"} onClick=${watch}>
        ${t(state === "idle" || state === "watching" ? "wave-start" : "wave-again")}
      </button>
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
    <div class="actions">
      <button disabled=${!holds.value || isTaking} onClick=${capture}>${t("test-take")}</button>
    </div>
    ${
      pair &&
      html`<p class="verdict">
          <${Shape} is=${pair.skew_ms < 1 ? "tick" : "doubt"} />${" "}
          ${t("test-skew", { skew: number(pair.skew_ms, 3) })}${" "}
          ${t(pair.skew_ms < 1 ? "test-together" : "test-apart")}
        </p>
        <div class="pair">
          ${SIDES.map(
            (side) => html`<figure>
              <figcaption>${t(side)}</figcaption><img src=${pair[side]} alt=${t(`test-${side}`)} />
            </figure>`,
          )}
        </div>`
    }
  </section>`;
}

const isChoosable = (serial) => Boolean(serial) && mayTake.value;
async function use(side, serial) {
  const done = await attempt(() => ask("PUT", `cameras/${side}`, { token: token.value, serial }));
  if (done) say(t(`used-as-${side}`, { serial }));
  await lookAtCameras();
}

async function giveAddress(serial, wanted = "") {
  const given = await attempt(() =>
    ask("POST", "cameras/address", { token: token.value, serial, ...(wanted ? { address: wanted } : {}) }),
  );
  if (given) say(t(given.is_kept ? "address-kept" : "address-given", { serial, address: given.address }));
  await lookAtCameras();
}

// An address that the plant has for it. A camera that the cell controls keeps its own.
function Address({ serial }) {
  const [wanted, setWanted] = useState("");
  const give = (event) => {
    event.preventDefault();
    giveAddress(serial, wanted.trim());
  };
  return html`<details>
    <summary>${t("address-other")}</summary>
    <form onSubmit=${give}>
      <label class="field">
        <span>${t("address-wanted")}</span>
        <input
          name="address" autocomplete="off" inputmode="text" maxlength="15" value=${wanted}
          onInput=${({ currentTarget }) => setWanted(currentTarget.value)}
        />
      </label>
      <div class="actions">
        <button disabled=${!holds.value || !wanted.trim()}>${t("address-give")}</button>
      </div>
    </form>
  </details>`;
}

// Whether packets as large as the link allows arrive, and all of them.
const LARGE_BYTES = 8000;
function Packets() {
  const [tested, setTested] = useState(null);
  const [isTesting, setTesting] = useState(false);
  const test = async () => {
    setTesting(true);
    const found = await attempt(() => ask("POST", "cameras/packets", { token: token.value }));
    setTesting(false);
    if (!found) return;
    setTested(found);
    say(t("packets-came", { came: found.came, pairs: found.pairs }));
    await lookAtCameras();
  };
  const verdict = ({ packet_bytes: bytes, lost, resent }) => {
    if (bytes === null) return ["none", t("packets-none")];
    if (lost || resent)
      return ["doubt", t("packets-lost", { bytes: number(bytes), lost: lost ?? 0, resent: resent ?? 0 })];
    return [
      bytes < LARGE_BYTES ? "doubt" : "tick",
      t(bytes < LARGE_BYTES ? "packets-small" : "packets-good", { bytes: number(bytes) }),
    ];
  };
  return html`<section aria-labelledby="packets">
    <h2 id="packets">${t("packets-title")}</h2>
    <p>${t("packets-what")}</p>
    <div class="actions">
      <button disabled=${!holds.value || isTesting} onClick=${test}>
        ${t(isTesting ? "packets-testing" : "packets-test")}
      </button>
    </div>
    ${
      tested &&
      html`<p class="verdict">
          <${Shape} is=${tested.came === tested.pairs ? "tick" : "gap"} />${" "}
          ${t("packets-came", { came: tested.came, pairs: tested.pairs })}
        </p>
        <dl class="facts">
          ${SIDES.filter((side) => tested.open[side]).map((side) => {
            const [shape, text] = verdict(tested.open[side]);
            return html`<dt key=${side}>${t(side)}</dt><dd><${Shape} is=${shape} /> ${text}</dd>`;
          })}
        </dl>`
    }
  </section>`;
}

function Trigger() {
  const { mode, line, rate_hz: rate } = cameras.value.trigger;
  return html`<section aria-labelledby="trigger">
    <h2 id="trigger">${t("trigger-title")}</h2>
    <p>${t(`trigger-${mode}`, { line, rate: number(rate, 1) })}</p>
    <div class="actions"><a class="button" href="#/settings">${t("trigger-change")}</a></div>
  </section>`;
}

export default function Cameras() {
  useFresh(lookAtCameras, [holds.value]);
  const { found, configured } = cameras.value ?? {};
  return html`<h1>${t("cameras-title")}</h1>
    <p class="lead">${t("cameras-what")}</p>
    <${Pair} />
    <section aria-labelledby="found">
      <h2 id="found">${t("cameras-found")}</h2>
      ${!mayTake.value && html`<p class="hint">${t("cameras-engineer")}</p>`}
      ${found && !found.length && html`<p>${t("cameras-none")}</p>`}
      <ul class="tiles">
        ${found?.map(
          ({ vendor, model, serial, address, address_by: by, is_lost: isLost, trouble, side }) =>
            html`<li class="tile">
              <h3 translate=${false}>${vendor} ${model}</h3>
              <p class="muted" translate=${false}>${[serial, address, by].filter(Boolean).join(" · ")}</p>
              <p>
                ${
                  side
                    ? html`<${Shape} is="tick" /> ${t(`is-${side}`)}`
                    : html`<${Shape} is="none" />${" "}
                      ${t("is-neither")}`
                }
              </p>
              ${
                configured[side]?.open &&
                html`<p class="muted">
                  ${t("camera-firmware", { version: configured[side].open.firmware || "–" })}
                  ${
                    configured[side].open.packet_bytes !== null &&
                    ` · ${t("camera-packets", { bytes: number(configured[side].open.packet_bytes) })}`
                  }
                </p>`
              }
              ${
                isChoosable(serial) &&
                !isLost &&
                html`<div class="actions">
                  ${SIDES.filter((one) => one !== side).map(
                    (one) => html`<button
                      key=${one} disabled=${!holds.value} onClick=${() => use(one, serial)}
                      aria-label=${t(`use-as-${one}-name`, { serial })}
                    >
                      ${t(`use-as-${one}`)}
                    </button>`,
                  )}
                </div>`
              }
              ${address && !side && isChoosable(serial) && html`<${Address} serial=${serial} />`}
              ${trouble && html`<p class="wrong"><${Shape} is="doubt" /> ${inWords("trouble", trouble)}</p>`}
              ${
                isLost &&
                isChoosable(serial) &&
                html`<div class="actions">
                  <button disabled=${!holds.value} onClick=${() => giveAddress(serial)}>
                    ${t("give-address")}
                  </button>
                </div>`
              }
            </li>`,
        )}
      </ul>
      <div class="actions">
        <button disabled=${!mayTake.value} onClick=${lookAtCameras}>${t("cameras-again")}</button>
      </div>
    </section>
    <${Wave} />
    <${Keep} />
    <${Test} />
    ${found?.some(({ address }) => address) && html`<${Packets} />`}
    ${cameras.value && html`<${Trigger} />`}`;
}
