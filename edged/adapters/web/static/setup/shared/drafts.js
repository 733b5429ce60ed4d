// Drafts: which one a page shows, the list of others, and discarding.
import { html, signal, useState } from "../../vendor/ui.js";
import { ask, attempt } from "./api.js";
import { Dialog, Shape } from "./pieces.js";
import { learn, moment, t } from "./texts.js";

// A new draft puts the older ones aside: they open only on request. Ids begin with the time.
const ASIDE = "edged.aside.";
export const isAside = (kind, id) => id <= (sessionStorage.getItem(ASIDE + kind) ?? "");
export function putAside(kind, drafts) {
  const youngest = drafts.map(({ id }) => id).reduce((latest, id) => (latest > id ? latest : id), "");
  if (!isAside(kind, youngest)) sessionStorage.setItem(ASIDE + kind, youngest);
}

// The draft to open unasked: the cell's current one, else the newest; never one in use.
export function unfinished(kind, drafts) {
  const readable = drafts.filter(({ trouble }) => !trouble);
  const found = readable.find(({ current }) => current) ?? readable[0];
  return found && !found.active && !isAside(kind, found.id) ? found : null;
}

// Discarded drafts, on any screen, leave the list before it is asked for again.
const gone = signal(new Set());
export function forget(kind, id) {
  putAside(kind, [{ id }]);
  gone.value = new Set([...gone.peek(), id]);
}

// Returns true if discarded.
export const discard = (kind, id) =>
  attempt(async () => {
    await ask("DELETE", `${kind}/${id}`);
    forget(kind, id);
    return true;
  });

// Starts a draft of a job and opens the page Teach, whose texts also cover the errors.
export const opening = signal(null); // the draft that Teach opens
export const teachFrom = (body) =>
  attempt(async () => {
    await learn("setup/teaching/teach");
    opening.value = await ask("POST", "teachings", body);
    location.hash = "#/teach";
  });

// The button and its question. what: a sentence on what is lost.
export function Discard({ name, what, isDisabled, onDiscard }) {
  const [isAsked, setAsked] = useState(false);
  const act = async () => {
    setAsked(false);
    await onDiscard();
  };
  return html`<button
      disabled=${isDisabled} aria-label=${t("draft-discard-name", { name })}
      onClick=${() => setAsked(true)}
    >
      ${t("draft-discard")}
    </button>
    <${Dialog} title=${t("draft-discard-title", { name })} isOpen=${isAsked} onClose=${() => setAsked(false)}>
      <p>${what}</p>
      <div class="actions">
        <button onClick=${() => setAsked(false)}>${t("back")}</button>
        <button class="primary" onClick=${act}>${t("draft-discard")}</button>
      </div>
    <//>`;
}

// The drafts not in use, to open or discard. about(draft): {name, isGiven, more}; isGiven: a name that is not
// translated.
export function Begun({ drafts, about, what, isDisabled, onOpen, onDiscard }) {
  const begun = drafts.filter(({ active, id }) => !active && !gone.value.has(id));
  if (!begun.length) return null;
  return html`<section aria-labelledby="begun">
    <h2 id="begun">${t("draft-begun")}</h2>
    <ul class="tiles">${begun.map((draft) => {
      const { id, created, author, trouble } = draft;
      const { name, isGiven, more } = trouble ? { name: id, isGiven: true } : about(draft);
      return html`<li class="tile" key=${id}>
        <h3 translate=${isGiven ? false : undefined}>${name}</h3>
        ${
          trouble
            ? html`<p class="wrong"><${Shape} is="doubt" /> ${t("draft-broken")}</p>`
            : html`<p class="muted">
              ${more && html`${more} · `}<span translate=${false}>${moment(created)} · ${author}</span>
            </p>`
        }
        <div class="actions">
          ${
            !trouble &&
            html`<button aria-label=${t("draft-go-on-with", { name })} onClick=${() => onOpen(id)}>
              ${t("draft-go-on")}
            </button>`
          }
          <${Discard} name=${name} what=${what} isDisabled=${isDisabled} onDiscard=${() => onDiscard(id)} />
        </div>
      </li>`;
    })}</ul>
  </section>`;
}
