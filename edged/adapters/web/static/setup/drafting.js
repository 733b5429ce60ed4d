// Drafts, on every page that makes one: which is shown, the way to another one, and out of it.
import { html, signal, useState } from "../vendor/ui.js";
import { ask, attempt } from "./api.js";
import { Dialog, Shape } from "./pieces.js";
import { moment, t } from "./texts.js";

// Whoever begins another one puts all aside that there are: they are shown again when somebody says so. An identity begins with its time.
const ASIDE = "edged.aside.";
export const isAside = (kind, id) => id <= (sessionStorage.getItem(ASIDE + kind) ?? "");
export function putAside(kind, drafts) {
  const youngest = drafts.map(({ id }) => id).reduce((one, other) => (one > other ? one : other), "");
  if (!isAside(kind, youngest)) sessionStorage.setItem(ASIDE + kind, youngest);
}

// The one to go on with unasked, here or on another screen: that which the cell is at, else the youngest. What is in use is done.
export function unfinished(kind, drafts) {
  const readable = drafts.filter(({ trouble }) => !trouble);
  const found = readable.find(({ current }) => current) ?? readable[0];
  return found && !found.active && !isAside(kind, found.id) ? found : null;
}

// What was discarded, here or on another screen, is listed no longer, also where nobody has asked for the list since.
const gone = signal(new Set());
export function forget(kind, id) {
  putAside(kind, [{ id }]);
  gone.value = new Set([...gone.peek(), id]);
}

// True where it is gone.
export const discard = (kind, id) =>
  attempt(async () => {
    await ask("DELETE", `${kind}/${id}`);
    forget(kind, id);
    return true;
  });

// The button, and its question. what: is lost.
export function Discard({ name, what, isDisabled, onDiscard }) {
  const [isAsked, setAsked] = useState(false);
  const act = async () => {
    setAsked(false);
    await onDiscard();
  };
  return html`<button type="button" disabled=${isDisabled} aria-label=${t("draft-discard-name", { name })} onClick=${() => setAsked(true)}>${t("draft-discard")}</button>
    <${Dialog} title=${t("draft-discard-title", { name })} isOpen=${isAsked} onClose=${() => setAsked(false)}>
      <p>${what}</p>
      <div class="actions"><button type="button" onClick=${() => setAsked(false)}>${t("back")}</button><button type="button" class="primary" onClick=${act}>${t("draft-discard")}</button></div>
    <//>`;
}

// What was begun and is not in use: to go on with, or to be rid of. about: a draft, {name, isGiven, more}; isGiven: the name is no words of ours.
export function Begun({ drafts, about, what, isDisabled, onOpen, onDiscard }) {
  const begun = drafts.filter(({ active, id }) => !active && !gone.value.has(id));
  if (!begun.length) return null;
  return html`<section aria-labelledby="begun">
    <h2 id="begun">${t("draft-begun")}</h2>
    <ul class="tiles">${begun.map((draft) => {
      const { id, created, author, trouble } = draft;
      const { name, isGiven, more } = trouble ? { name: id, isGiven: true } : about(draft);
      return html`<li class="tile" key=${id}><h3 translate=${isGiven ? false : undefined}>${name}</h3>
        ${trouble ? html`<p class="wrong"><${Shape} is="doubt" /> ${t("draft-broken")}</p>` : html`<p class="muted">${more && html`${more} · `}<span translate=${false}>${moment(created)} · ${author}</span></p>`}
        <div class="actions">
          ${!trouble && html`<button type="button" aria-label=${t("draft-go-on-with", { name })} onClick=${() => onOpen(id)}>${t("draft-go-on")}</button>`}
          <${Discard} name=${name} what=${what} isDisabled=${isDisabled} onDiscard=${() => onDiscard(id)} />
        </div></li>`;
    })}</ul>
  </section>`;
}
