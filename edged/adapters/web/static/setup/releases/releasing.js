// The dialog of a new release: its note, and a signature if recorded cycles get worse or were not tried.
import { html, useState } from "../../vendor/ui.js";
import { attempt, Problem, sentence } from "../shared/api.js";
import { holds, token } from "../shared/live.js";
import { Dialog, Shape } from "../shared/pieces.js";
import { t } from "../shared/texts.js";

const Words = ({ name, label, value, onValue }) => html`<label class="field">
  <span>${label}</span>
  <input
    name=${name} value=${value} maxlength="200" onInput=${(event) => onValue(event.currentTarget.value)}
  />
</label>`;

// barred: the cell's verdict on the recorded cycles. test: starts a regression, if possible.
function Signature({ barred, test, reason, onReason, onClose }) {
  const { cycles, good_to_bad: bad } = barred;
  const isTried = Number.isFinite(bad);
  const look = async (work) => {
    onClose();
    location.hash = "#/cycles";
    await work?.();
  };
  return html`<div class="signature">
    <p role="alert">
      <${Shape} is="doubt" /> ${t(isTried ? "sign-worse" : "sign-untried", { count: isTried ? bad : cycles })}
    </p>
    ${
      (isTried || test) &&
      html`<div class="actions">
        <button onClick=${() => look(isTried ? undefined : test)}>
          ${t(isTried ? "sign-look" : "sign-try")}
        </button>
      </div>`
    }
    <p>${t("sign-what")}</p>
    <${Words} name="signed" label=${t("sign-reason")} value=${reason} onValue=${onReason} />
  </div>`;
}

// send(body): the request; onDone(answer). label: of the button. suggested: a note, to be changed or taken.
export function Releasing({
  title,
  label,
  isReady = true,
  barred: known = null,
  suggested = "",
  test,
  send,
  onDone,
  onClose,
  children,
}) {
  const [note, setNote] = useState(suggested);
  const [reason, setReason] = useState("");
  const [barred, setBarred] = useState(known);
  const [failed, setFailed] = useState(null);
  const [isBusy, setBusy] = useState(false); // a release is tried before it is used, which takes time
  const act = async () => {
    setBusy(true);
    setFailed(null);
    try {
      const made = await send({
        note,
        ...(barred ? { signed: reason } : {}),
        ...(holds.value ? { token: token.value } : {}),
      });
      onClose();
      await attempt(() => onDone(made));
    } catch (problem) {
      if (!(problem instanceof Problem)) throw problem;
      if (problem.code === "regression") setBarred(problem.params);
      else setFailed(problem); // here, as the page's own message lies behind this dialog
    } finally {
      setBusy(false);
    }
  };
  return html`<${Dialog} title=${title} isOpen=${true} onClose=${onClose}>
    ${children}
    <${Words} name="note" label=${t("release-note")} value=${note} onValue=${setNote} />
    ${
      barred &&
      html`<${Signature}
        barred=${barred} test=${test} reason=${reason} onReason=${setReason} onClose=${onClose}
      />`
    }
    ${failed && html`<p class="wrong" role="alert"><${Shape} is="doubt" /> ${sentence(failed)}</p>`}
    <div class="actions">
      <button onClick=${onClose}>${t("back")}</button>
      <button
        class="primary"
        disabled=${isBusy || !isReady || !note.trim() || (barred !== null && !reason.trim())}
        onClick=${act}
      >
        ${isBusy ? t("release-making") : barred ? t("sign", { label }) : label}
      </button>
    </div>
  <//>`;
}
