// Registration: the rig's pose to the robot, by touched points or by flange poses.
import { effect, html, useEffect, useState } from "../../vendor/ui.js";
import { Releasing } from "../releases/releasing.js";
import { ask, attempt, glance } from "../shared/api.js";
import { BoardFields, PitchField, SIZE, specOf } from "../shared/board.js";
import { BRANDS } from "../shared/brands.js";
import { Begun, Discard } from "../shared/drafts.js";
import {
  cell,
  checked,
  hasManual,
  holds,
  look,
  mayTake,
  newest,
  sign,
  token,
  useFresh,
} from "../shared/live.js";
import { Pair } from "../shared/picture.js";
import { Shape, say, useKept } from "../shared/pieces.js";
import { dashed, number, t } from "../shared/texts.js";
import { Shown } from "./numbers.js";
import { More, Places, titleOf } from "./places.js";
import {
  another,
  change,
  current,
  find,
  goOn,
  hear,
  heard,
  placeName,
  sampleName,
  throwAway,
} from "./registration.js";
import { RobotMap } from "./robotmap.js";
import { Samples } from "./samples.js";
import { Sky } from "./sky.js";

/** @typedef {import("./numbers.js").Entered} Entered */

const OTHER = "";
const PART = "part:";
const registered = () =>
  ({ yes: ["tick", "robot-is-fixed"], on_flange: ["tick", "robot-is-flange"] })[cell.value.rig?.robot] ?? [
    "none",
    cell.value.rig ? "robot-is-none" : "robot-is-unknown",
  ];

// --- new ---

const Choice = ({ name, value, chosen, onChoose, children }) => html`<label class="choice">
  <input
    type="radio" name=${name} value=${value} checked=${chosen === value} onChange=${() => onChoose(value)}
  /> <span>${children}</span>
</label>`;

function Begin() {
  const [mount, setMount] = useKept("robot-mount", "fixed");
  const [way, setWay] = useKept("robot-way", "touch");
  const [brand, setBrand] = useKept("robot-brand", current.brands.value[0]?.id ?? OTHER);
  const [what, setWhat] = useKept(`robot-what ${cell.value.rig?.id}`, null); // null: the first known
  const [size, setSize] = useKept("robot-size", SIZE);
  const [mm, setMm] = useKept("robot-mm", null);
  const kind = mount === "flange" ? "poses" : way;
  const known = checked.value?.boards ?? [];
  const jobs = kind === "touch" ? (checked.value?.parts ?? []).map(({ job }) => PART + job) : [];
  const choice =
    what !== null && [...known, ...jobs, OTHER].includes(what) ? what : ([...known, ...jobs][0] ?? OTHER);
  const board = choice === OTHER ? mm && specOf(size, mm) : choice.startsWith(PART) ? "" : choice;
  const begin = () =>
    attempt(async () => {
      current.job.value = choice.startsWith(PART) ? choice.slice(PART.length) : null;
      current.draft.value = await newest(
        heard,
        ask("POST", "registrations", { mount, kind, brand: brand || null, board: board || "" }),
      );
    });
  return html`<section aria-labelledby="robot-how">
    <h2 id="robot-how">${t("robot-how")}</h2>
    <fieldset>
      <legend>${t("robot-mount")}</legend>
      <${Choice} name="mount" value="fixed" chosen=${mount} onChoose=${setMount}>${t("robot-mount-fixed")}<//>
      <${Choice} name="mount" value="flange" chosen=${mount} onChoose=${setMount}>
        ${t("robot-mount-flange")}
      <//>
    </fieldset>
    ${
      mount === "fixed" &&
      html`<fieldset>
        <legend>${t("robot-way")}</legend>
        <${Choice} name="way" value="touch" chosen=${way} onChoose=${setWay}>${t("robot-way-touch")}<//>
        <${Choice} name="way" value="poses" chosen=${way} onChoose=${setWay}>${t("robot-way-poses")}<//>
      </fieldset>`
    }
    <fieldset>
      <legend>
        ${t(
          kind === "touch" ? "robot-what-touch" : mount === "fixed" ? "robot-what-held" : "robot-what-lies",
        )}
      </legend>
      <div class="choices">
        ${known.map(
          (one) => html`<${Choice} key=${one} name="what" value=${one} chosen=${choice} onChoose=${setWhat}>
            <span translate=${false}>${one}</span>
          <//>`,
        )}
        ${jobs.map(
          (one) => html`<${Choice} key=${one} name="what" value=${one} chosen=${choice} onChoose=${setWhat}>
            ${t("robot-what-part", { job: one.slice(PART.length) })}
          <//>`,
        )}
        <${Choice} name="what" value=${OTHER} chosen=${choice} onChoose=${setWhat}>
          ${t("robot-what-board")}
        <//>
      </div>
      ${
        choice === OTHER &&
        html`<${BoardFields} size=${size} onSize=${setSize} />
          <div class="row">
            <${PitchField} size=${size} mm=${mm} onMm=${setMm} />
          </div>`
      }
    </fieldset>
    <div class="row">
      <${BrandField} value=${brand} onValue=${setBrand} mayBeUnknown=${kind === "poses"} />
    </div>
    <div class="actions">
      <button class="primary" disabled=${!mayTake.value || board === null} onClick=${begin}>
        ${t("robot-begin")}
      </button>
    </div>
    <p class="hint">
      ${t("robot-program")} ${cell.value.setup?.source === "person" && t("robot-program-later")}
    </p>
    ${
      hasManual &&
      html`<div class="actions">
        <a class="button" href="/manual/how-to/robot-frame/#by-the-robots-own-program">
          ${t("robot-program-how")}
        </a>
      </div>`
    }
  </section>`;
}

function BrandField({ value, onValue, mayBeUnknown }) {
  return html`<label class="field">
    <span>${t("robot-brand")}</span>
    <select name="brand" disabled=${!mayTake.value} onChange=${(event) => onValue(event.currentTarget.value)}>
      ${current.brands.value.map(
        ({ id }) => html`<option key=${id} value=${id} selected=${id === value} translate=${false}>
          ${BRANDS[id] ?? id}
        </option>`,
      )}
      ${
        (mayBeUnknown || !value) &&
        html`<option value="" selected=${!value}>${t("robot-brand-unknown")}</option>`
      }
    </select>
  </label>`;
}

// --- another pose ---

function Pose() {
  const { samples, wanted } = current.draft.value;
  const [shown, setShown] = useState(/** @type {Entered} */ ({}));
  const [isTaking, setTaking] = useState(false);
  const bare = samples.filter(({ why }) => why === "no_numbers");
  const take = async () => {
    sign();
    setTaking(true);
    const done = await change("POST", "/samples", { token: token.value, ...shown.body });
    setTaking(false);
    if (!done) return;
    shown.clear?.();
    setShown({});
    const { name, why } = done.samples.at(-1);
    say(
      t(why === "not_seen" || why === "length" ? "robot-pose-unseen" : "robot-pose-taken", {
        name: sampleName(name),
      }),
    );
  };
  // pasted lines, one for each picture without numbers
  const spread = async (lines) => {
    for (const [i, text] of lines.slice(0, bare.length).entries())
      if (!(await change("PUT", `/samples/${bare[i].name}`, { text }))) return;
  };
  return html`<${More} title=${titleOf("pose", samples.length + 1, wanted)}>
    <p class="lead">${t(current.draft.value.mount === "fixed" ? "robot-pose-fixed" : "robot-pose-flange")}</p>
    <${Pair} />
    <${Shown} draft=${current.draft.value} onShown=${setShown} onLines=${bare.length > 1 ? spread : null} />
    <div class="actions">
      <button class="primary big" disabled=${!holds.value || isTaking || shown.isWrong} onClick=${take}>
        ${t(isTaking ? "robot-taking" : "robot-pose-take")}
      </button>
    </div>
    ${!holds.value && html`<p class="hint">${t("robot-take-cell")}</p>`}
    ${
      bare.length > 0 &&
      html`<p class="hint">
        <${Shape} is="doubt" /> ${t("robot-bare", { count: bare.length })}
      </p>`
    }
  <//>`;
}

// --- verdict ---

function Verdict() {
  const { trouble, good, sigma_mm, figures, samples, advice, judging, limit_mm, kind } = current.draft.value;
  const counted = samples.filter(({ used }) => used).length;
  if (!counted && !trouble) return null;
  const shape = trouble
    ? ["too_few", "no_brand"].includes(trouble.code)
      ? "none"
      : "gap"
    : good
      ? "tick"
      : "none";
  const { brand: fitting, mount } = trouble?.params ?? {};
  return html`<section aria-labelledby="robot-verdict" class="robot-verdict">
    <h2 id="robot-verdict">
      ${t("robot-verdict")} ${judging && html`<span class="muted small">${t("robot-judging")}</span>`}
    </h2>
    <p class="big figure" role="status">
      <${Shape} is=${shape} />${" "}
      ${trouble ? said(trouble, current.draft.value) : html`<strong>${t("robot-good")}</strong>`}
    </p>
    ${
      trouble?.code === "other_reading" &&
      fitting &&
      html`<div class="actions">
        <button
          class="primary" disabled=${!mayTake.value}
          onClick=${() => change("PUT", "", { brand: fitting, mount })}
        >
          ${t("robot-read-so", { brand: BRANDS[fitting] ?? fitting })}
        </button>
      </div>`
    }
    ${
      sigma_mm &&
      html`<dl class="facts">
        <dt>${t("robot-sigma")}</dt><dd>${t("robot-um", { um: number(1000 * Math.max(...sigma_mm), 0) })}</dd>
        <dt>${t(kind === "touch" ? "robot-held-out" : "robot-held-rms")}</dt>
        <dd>${t("robot-limit", { mm: number(figures.worst_mm, 3), limit: number(limit_mm, 2) })}</dd>
        ${
          figures.scale &&
          html`<dt>${t("robot-scale")}</dt>
            <dd>
              ${number(figures.scale, 5)}
              ${figures.sigma_scale ? html` ± ${number(figures.sigma_scale, 5)}` : ""}
            </dd>`
        }
      </dl>`
    }
    ${advice && html`<p class="hint"><${Shape} is="doubt" /> ${t(`robot-advice-${advice}`)}</p>`}
    <${Conventions} />
  </section>`;
}

function said({ code, text, params }, { brand }) {
  const mm = (value) => (Number.isFinite(value) ? number(value, 3) : value);
  const readings = params.orientation ? { reading: t(`robot-reading-${params.orientation}`) } : {};
  const names = Object.fromEntries(
    ["name", "one", "two"].filter((key) => params[key]).map((key) => [key, sampleName(params[key])]),
  );
  const lengths = Object.fromEntries(
    ["mm", "others", "limit"].filter((key) => key in params).map((key) => [key, mm(params[key])]),
  );
  const percents =
    code === "scale" ? { percent: number(params.percent, 2), sigma: number(params.sigma, 2) } : {};
  const carried = params.mount ? { mounted: t(`robot-mounted-${params.mount}`) } : {};
  const values = {
    ...params,
    ...readings,
    ...names,
    ...lengths,
    ...percents,
    ...carried,
    said: BRANDS[brand] ?? "",
    whose: BRANDS[params.brand] ?? t("robot-nobodys"),
    detail: text,
  };
  return t(`robot-trouble-${dashed(code)}`, values);
}

function Conventions() {
  const { conventions } = current.draft.value;
  if (!conventions.length) return null;
  return html`<details class="robot-conventions">
    <summary>${t("robot-conventions")}</summary>
    <div class="scroll" tabindex="0" role="region" aria-label=${t("robot-conventions")}>
      <table>
        <thead>
          <tr>
            <th scope="col">${t("robot-reading")}</th><th scope="col">${t("robot-lengths")}</th>
            <th scope="col">${t("robot-cameras")}</th><th scope="col">${t("robot-off")}</th>
          </tr>
        </thead>
        <tbody>${conventions.map(
          ({ code, length_unit, mount, rms_mm, brands, said: isSaid }, i) => html`<tr key=${i}>
            <td>
              ${isSaid && html`<${Shape} is="tick" /> `}${t(`robot-reading-${code}`)} ${
                brands.length > 0 &&
                html`<span class="muted" translate=${false}>
                  (${brands.map((one) => BRANDS[one] ?? one).join(", ")})
                </span>`
              }
            </td><td translate=${false}>${length_unit}</td><td>${t(`robot-mounted-${mount}`)}</td>
            <td>${t("robot-mm", { mm: number(rms_mm, 3) })}</td>
          </tr>`,
        )}</tbody>
      </table>
    </div>
  </details>`;
}

// --- solve, prove, activate ---

function Keep() {
  const { good, solved, active, judging } = current.draft.value;
  const [isAsked, setAsked] = useState(false);
  const [release, setRelease] = useState(null);
  const { id, brand, samples } = current.draft.value;
  const note = { brand: BRANDS[brand] ?? "", count: samples.filter(({ used }) => used).length };
  const done = async (made) => {
    setRelease(made);
    await find(id);
    await look();
  };
  if (!good && !solved) return null;
  return html`<section aria-labelledby="robot-keep">
    <h2 id="robot-keep">${t("robot-keep")}</h2>
    ${
      !solved
        ? html`<p>${t("robot-keep-what")}</p>
          <div class="actions">
            <button
              class="primary" disabled=${!mayTake.value || judging}
              onClick=${() => change("POST", "/solve")}
            >
              ${t("robot-solve")}
            </button>
          </div>`
        : html`<${GoThere} />
          ${
            active
              ? html`<p class="verdict" role="status">
                <${Shape} is="tick" />${" "}
                ${release ? t("robot-activated", { number: release.number }) : t("robot-active")}
              </p>`
              : html`<div class="actions">
                <button class="primary" disabled=${!mayTake.value} onClick=${() => setAsked(true)}>
                  ${t("robot-activate")}
                </button>
              </div>`
          }`
    }
    ${
      isAsked &&
      html`<${Releasing}
        title=${t("robot-activate-title")} label=${t("robot-activate")} suggested=${t("robot-note", note)}
        send=${(body) => ask("POST", `registrations/${id}/activate`, body)} onDone=${done}
        onClose=${() => setAsked(false)}
      >
        <p>${t("robot-activate-what")}</p>
      <//>`
    }
  </section>`;
}

// The proof: a target in the robot's convention, and how far off the tip was.
function GoThere() {
  const { places, confirmed, mount, limit_mm } = current.draft.value;
  const [chosen, setChosen] = useState(null);
  const [shown, setShown] = useState(/** @type {Entered} */ ({}));
  const open = places.filter(({ robot }) => robot);
  const place = open.find(({ key }) => key === chosen) ?? open.find(({ wanted }) => wanted) ?? open[0];
  const confirm = async () => {
    const done = await change("POST", "/confirm", { place: place.key, ...shown.body });
    if (!done) return;
    shown.clear?.();
    say(t("robot-off-by", { mm: number(done.confirmed.distance_mm, 2) }));
  };
  const isGood = confirmed && confirmed.distance_mm <= 2 * limit_mm;
  return html`<h3>${t("robot-go")}</h3>
    ${!place && html`<p>${t("robot-go-look")}</p>`}
    ${
      (mount === "fixed" || !place) &&
      html`<${Places} isProof=${true} chosen=${place?.key} onChoose=${setChosen} />`
    }
    ${
      place &&
      html`${
        mount === "flange" &&
        html`<p>${t("robot-go-flange")}</p>
            <${Places} isProof=${true} isStill=${true} chosen=${place.key} onChoose=${setChosen} />`
      }
        <p>${t("robot-go-there", { place: placeName(place) })}</p>
        <p class="robot-target" translate=${false}>${place.robot.text}</p>
        <p class="hint">${t("robot-go-slow")}</p>
        <${Shown} draft=${{ ...current.draft.value, kind: "touch" }} point=${place} onShown=${setShown} />
        <div class="actions">
          <button disabled=${!mayTake.value || !shown.body} onClick=${confirm}>${t("robot-confirm")}</button>
        </div>`
    }
    ${
      confirmed &&
      html`<p class="verdict" role="status">
        <${Shape} is=${isGood ? "tick" : "doubt"} />${" "}
        ${t("robot-off-by", { mm: number(confirmed.distance_mm, 2) })} ${!isGood && t("robot-off-more")}
      </p>`
    }`;
}

const wayOf = ({ kind }) => t(kind === "touch" ? "robot-begun-touch" : "robot-begun-poses");
const inTile = (line) => ({ name: wayOf(line), more: t("robot-begun-samples", { samples: line.samples }) });

export default function Robot() {
  useFresh(() => glance(() => find(current.draft.value?.id)), [current.draft.value === null]);
  useEffect(() => effect(hear), []);
  const { draft } = current;
  const head = html`<h1>${t("robot-title")}</h1><p class="lead">${t("robot-lead")}</p>`;
  if (cell.value.missing.includes("rig"))
    return html`${head}<p><${Shape} is="gap" /> ${t("robot-no-rig")}</p>
      <div class="actions"><a class="button primary" href="#/calibrate">${t("step-calibrate")}</a></div>`;
  const [shape, is] = registered();
  const map = current.map.value;
  const now = html`<p><${Shape} is=${shape} /> ${t(is)}</p>${map && html`<${RobotMap} map=${map} />`}`;
  if (!draft.value)
    return html`${head}${now}${current.brands.value.length > 0 && html`<${Begin} />`}
      <${Begun}
        drafts=${current.drafts.value} about=${inTile} what=${t("robot-discard-what")}
        isDisabled=${!mayTake.value} onOpen=${(begun) => attempt(() => goOn(begun))} onDiscard=${throwAway}
      />`;
  const { id, kind, brand, stale, by_program, solved } = draft.value;
  // the robot triggers the pictures
  const isWalking = by_program && !solved && cell.value.setup?.source === "robot";
  return html`${head}${now}
    <div class="draft-bar">
      <p><strong>${wayOf(draft.value)}</strong></p>
      <div class="actions">
        <button disabled=${!mayTake.value} onClick=${() => attempt(another)}>${t("robot-new")}</button>
        <${Discard}
          name=${wayOf(draft.value)} what=${t("robot-discard-what")} isDisabled=${!mayTake.value}
          onDiscard=${() => throwAway(id)}
        />
      </div>
    </div>
    ${stale && html`<p class="verdict"><${Shape} is="gap" /> ${t("robot-stale")}</p>`}
    <div class="row">
      <${BrandField}
        value=${brand ?? ""} onValue=${(one) => change("PUT", "", { brand: one || null })}
        mayBeUnknown=${kind === "poses"}
      />
    </div>
    ${
      by_program &&
      html`<p>
        <${Shape} is=${isWalking ? "busy" : "none"} /> ${t(isWalking ? "robot-walks" : "robot-walked")}
      </p>`
    }
    ${!isWalking && (kind === "touch" ? html`<${Places} />` : html`<${Pose} />`)}
    ${
      kind === "poses" &&
      draft.value.sky.length > 1 &&
      html`<${Sky} sky=${draft.value.sky} missing=${draft.value.missing} />`
    }
    <${Verdict} />
    <${Samples} />
    <${Keep} key=${id} />`;
}
