// Users and the audit trail, for engineers.
import { html, signal, useState } from "../../vendor/ui.js";
import { ask, attempt, glance } from "../shared/api.js";
import { mayTake, me, offers, useFresh } from "../shared/live.js";
import { Dialog, Shape, say } from "../shared/pieces.js";
import { moment, t } from "../shared/texts.js";

const ROLES = ["viewer", "operator", "engineer"];
const LEAST_LETTERS = 8;
const SHOWN = 50;
const users = signal(null);
const entries = signal(null);

const find = () =>
  glance(async () => {
    users.value = (await ask("GET", "users")).users;
  });
const findEntries = () =>
  glance(async () => {
    const { count } = await ask("GET", "audit?most=1");
    entries.value = await ask("GET", `audit?after=${Math.max(0, count - SHOWN)}&most=${SHOWN}`);
  });

const Roles = ({ value, onRole, label, disabled }) => html`<select
  aria-label=${label} value=${value} disabled=${disabled}
  onChange=${(event) => onRole(event.currentTarget.value)}
>
  ${ROLES.map((role) => html`<option value=${role} selected=${role === value}>${t(`role-${role}`)}</option>`)}
</select>`;

function Newcomer() {
  const [name, setName] = useState("");
  const [password, setPassword] = useState("");
  const [role, setRole] = useState(ROLES[1]);
  const add = async (event) => {
    event.preventDefault();
    const sent = { name, role, password };
    const added = await attempt(() => ask("POST", "users", { ...sent, name: name.trim() }));
    if (!added) return;
    say(t("user-added", { name: added.name }));
    // the next person may have been begun meanwhile
    setName((now) => (now === sent.name ? "" : now));
    setPassword((now) => (now === sent.password ? "" : now));
    await find();
  };
  return html`<form onSubmit=${add}>
    <h3>${t("user-new")}</h3>
    <div class="row">
      <label class="field">
        <span>${t("user-name")}</span>
        <input
          autocomplete="off" maxlength="64" value=${name}
          onInput=${(event) => setName(event.currentTarget.value)}
        />
      </label>
      <label class="field">
        <span>${t("user-role")}</span><${Roles} value=${role} onRole=${setRole} label=${t("user-role")} />
      </label>
      <label class="field">
        <span>${t("user-password", { least: LEAST_LETTERS })}</span>
        <input
          type="password" autocomplete="new-password" value=${password}
          onInput=${(event) => setPassword(event.currentTarget.value)}
        />
      </label>
    </div>
    <div class="actions">
      <button disabled=${!name.trim() || password.length < LEAST_LETTERS}>${t("user-add")}</button>
    </div>
  </form>`;
}

// Changing the own password logs out the user's other screens.
export function OwnPassword() {
  const [old, setOld] = useState("");
  const [next, setNext] = useState("");
  const change = async (event) => {
    event.preventDefault();
    const isDone = await attempt(() => ask("PUT", "me/password", { old, new: next }).then(() => true));
    if (!isDone) return;
    say(t("own-changed"));
    setOld("");
    setNext("");
  };
  const field = (key, value, set, purpose) => html`<label class="field">
    <span>${t(key, { least: LEAST_LETTERS })}</span>
    <input
      type="password" autocomplete=${purpose} value=${value}
      onInput=${(event) => set(event.currentTarget.value)}
    />
  </label>`;
  return html`<section aria-labelledby="own">
    <h2 id="own">${t("own-title")}</h2>
    <form class="own" onSubmit=${change}>
      <input type="text" autocomplete="username" value=${me.value.name} readonly hidden />
      <div class="row">
        ${field("own-old", old, setOld, "current-password")}${" "}
        ${field("own-new", next, setNext, "new-password")}
      </div>
      <div class="actions">
        <button disabled=${!old || next.length < LEAST_LETTERS}>${t("own-change")}</button>
      </div>
    </form>
  </section>`;
}

// Where the user is logged in; ending them ends this one, too.
export function OwnSessions() {
  const [shown, setShown] = useState([]);
  useFresh(() =>
    glance(async () => {
      setShown((await ask("GET", "me/sessions")).sessions);
    }),
  );
  const end = () => attempt(() => ask("DELETE", "me/sessions")).then(() => location.reload());
  return html`<section aria-labelledby="sessions">
    <h2 id="sessions">${t("sessions-title")}</h2>
    <ul class="people">
      ${shown.map(
        ({ address, age_s, idle_s, this: isThis }, i) => html`<li key=${i}>
          <span translate=${false}>${address}</span>
          <span>
            ${t("session", { age: Math.round(age_s / 60), idle: Math.round(idle_s / 60) })}
            ${isThis && html` <em>${t("session-this")}</em>`}
          </span>
        </li>`,
      )}
    </ul>
    <div class="actions"><button type="button" onClick=${end}>${t("sessions-end")}</button></div>
  </section>`;
}

export function Users() {
  const [leaving, setLeaving] = useState(null);
  useFresh(find);
  const change = (name, role) =>
    attempt(async () => {
      await ask("PUT", `users/${encodeURIComponent(name)}`, { role });
      await find();
    });
  const remove = async () => {
    const name = leaving;
    setLeaving(null);
    await attempt(() => ask("DELETE", `users/${encodeURIComponent(name)}`, {}));
    await find();
  };
  return html`<section aria-labelledby="users">
    <h2 id="users">${t("users-title")}</h2>
    <p class="hint">${t("users-what")}</p>
    <ul class="people">
      ${users.value?.map(
        ({ name, role }) => html`<li key=${name}>
          <strong translate=${false}>${name}</strong>
          <${Roles}
            value=${role} onRole=${(chosen) => change(name, chosen)} label=${t("user-role-of", { name })}
            disabled=${name === me.value.name}
          />
          <button
            type="button" disabled=${name === me.value.name} aria-label=${t("user-remove-name", { name })}
            onClick=${() => setLeaving(name)}
          >
            ${t("user-remove")}
          </button>
        </li>`,
      )}
    </ul>
    <${Newcomer} />
    <${Dialog}
      title=${t("user-remove-name", { name: leaving ?? "" })} isOpen=${leaving !== null}
      onClose=${() => setLeaving(null)}
    >
      <p>${t("user-remove-what")}</p>
      <div class="actions">
        <button type="button" onClick=${() => setLeaving(null)}>${t("back")}</button>
        <button type="button" class="primary" onClick=${remove}>${t("user-remove")}</button>
      </div>
    <//>
  </section>`;
}

// What was done, in words; else as the route that it is. The first pattern counts: after the path may stand
// a name of what was made.
/** @type {[RegExp, string][]} */
const DID = [
  [/^log in page/, "log-in"],
  [/^run cell/, "run"],
  [/^end setup/, "ended"],
  [/^POST setup/, "take"],
  [/^DELETE setup/, "give"],
  [/^POST cameras\/keep/, "keep"],
  [/^POST cameras\/address/, "address"],
  [/^POST cameras\/packets/, "packets"],
  [/^POST cameras\/wave/, "wave"],
  [/^PUT cameras\//, "camera"],
  [/^PUT plc\/settings/, "connect"], // this and the next two: of versions without a draft of settings
  [/^DELETE plc\/settings/, "connect-back"],
  [/^PUT settings/, "settings"],
  [/^POST settings\/activate/, "settings"],
  [/^DELETE settings/, "settings-discarded"],
  [/^POST machine\/mend/, "mend"],
  [/^POST backup\/activate/, "restore"],
  [/^POST backup/, "backup"],
  [/^POST support/, "support"],
  [/^POST users/, "person"],
  [/^PUT users/, "person-changed"],
  [/^DELETE users/, "person-removed"],
  [/^PUT me\/password/, "password"],
  [/^POST .*\/activate/, "activate"],
  [/^POST .*\/solve/, "solve"],
  [/^POST (calibrations|teachings|registrations)/, "begin"],
  [/^DELETE (calibrations|teachings|registrations)/, "discard"],
  [/^POST checks/, "check"],
  [/^POST trials\/still/, "still"],
  [/^POST regressions/, "test"],
  [/^POST jobs\/.*\/golden/, "golden"],
  [/^POST jobs\/.*\/use/, "use"],
  [/^POST marks\/teach/, "marks"],
  [/^POST acceptance\/accept/, "accept"],
  [/^POST acceptance\/study/, "study"],
  [/^(PUT|POST) jobs\//, "job"],
  [/^POST me\/wake/, "wake"],
  [/^DELETE me\/sessions/, "leave"],
];
function Did({ verb, object }) {
  const route = `${verb} ${object}`;
  const [, did] = DID.find(([pattern]) => pattern.test(route)) ?? [];
  if (!did) return html`<span translate=${false}>${route}</span>`;
  return html`${t(`audit-did-${did}`)} <span class="muted" translate=${false}>${object}</span>`;
}

export function Audit() {
  useFresh(findEntries);
  const { records, problem, first, count } = entries.value ?? {
    records: [],
    problem: null,
    first: 1,
    count: 0,
  };
  return html`<section aria-labelledby="audit">
    <h2 id="audit">${t("audit-title")}</h2>
    <p>
      <${Shape} is=${problem ? "doubt" : "tick"} /> ${
        problem
          ? html`${t("audit-broken")}${" "}
            <span translate=${false}>${problem}</span>`
          : t(first > 1 ? "audit-kept" : "audit-whole", { first, count })
      }
    </p>
    <div class="scroll" tabindex="0" role="region" aria-label=${t("audit-records")}>
      <table>
        <thead>
          <tr>
            ${["time", "user", "what", "outcome", "reason"].map(
              (column) => html`<th scope="col">${t(`audit-${column}`)}</th>`,
            )}
          </tr>
        </thead>
        <tbody>
          ${[...records].reverse().map(
            ({ number, time, user, role, address, verb, object, outcome, reason }) => html`<tr key=${number}>
              <td translate=${false}>${moment(time)}</td>
              <td translate=${false}>${user} <span class="muted">${role} ${address}</span></td>
              <td><${Did} verb=${verb} object=${object} /></td>
              <td translate=${false}>${outcome}</td><td translate=${false}>${reason ?? ""}</td>
            </tr>`,
          )}
        </tbody>
      </table>
    </div>
  </section>`;
}

export const People = () => html`${
  me.value.name && offers("users") && html`<${OwnPassword} /><${OwnSessions} />`
}
  ${mayTake.value && offers("users") && html`<${Users} />`}
  ${mayTake.value && offers("audit") && html`<${Audit} />`}`;
