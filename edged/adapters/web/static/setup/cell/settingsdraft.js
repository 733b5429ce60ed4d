// The draft of settings and connections: what it changes, why it cannot be used, and how it comes into force.
import { html, useState } from "../../vendor/ui.js";
import { Changes } from "../releases/difference.js";
import { Releasing } from "../releases/releasing.js";
import { ask, attempt } from "../shared/api.js";
import { mayTake } from "../shared/live.js";
import { Shape, say, useMainAction } from "../shared/pieces.js";
import { moment, t } from "../shared/texts.js";

export const Wrong = ({ problems }) =>
  problems.map(
    ({ text }) => html`<p key=${text} class="wrong" role="alert">
      <${Shape} is="doubt" /> <span lang="en" translate=${false}>${text}</span>
    </p>`,
  );

// onDone: the draft is in force, or discarded.
export function SettingsDraft({ draft, onDone }) {
  const [isAsked, setAsked] = useState(false);
  const isGood = Boolean(draft) && draft.problems.length === 0 && mayTake.value;
  useMainAction(isGood && t("draft-use"), () => setAsked(true));
  const { changes, problems, author, created } = draft ?? {};
  const discard = () =>
    attempt(async () => {
      await ask("DELETE", "settings", {});
      say(t("draft-discarded"));
      await onDone();
    });
  // the dialog outlives its draft: this page hears that there is none before the answer to its own request
  return html`${
    draft &&
    html`<section class="tile" aria-labelledby="settings-draft">
      <h2 id="settings-draft">${t("draft-settings")}</h2>
      <p class="muted" translate=${false}>${moment(created)} · ${author}</p>
      <${Changes} list=${changes} />
      <${Wrong} problems=${problems} />
      <div class="actions">
        <button class="primary" disabled=${!isGood} onClick=${() => setAsked(true)}>${t("draft-use")}</button>
        <button disabled=${!mayTake.value} onClick=${discard}>${t("draft-discard")}</button>
      </div>
    </section>`
  }
  ${
    isAsked &&
    html`<${Releasing}
      title=${t("draft-use")} label=${t("draft-put")}
      suggested=${changes
        ?.map(({ name }) => name)
        .join(", ")
        .slice(0, 200)}
      send=${(body) => ask("POST", "settings/activate", body)}
      onDone=${() => {
        say(t("draft-used"));
        return onDone();
      }}
      onClose=${() => setAsked(false)}
    />`
  }`;
}
