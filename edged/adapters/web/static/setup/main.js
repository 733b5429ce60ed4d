// Starts the page: texts, then the state of the cell, then the page.
import { html, render } from "../vendor/ui.js";
import { Problem, sentence } from "./shared/api.js";
import { me, start } from "./shared/live.js";
import { preferred, speak } from "./shared/texts.js";
import { Shell } from "./shell.js";

const place = document.getElementById("setup");
await speak(preferred());
try {
  await start();
  if (preferred(me.value.language) !== preferred()) await speak(preferred(me.value.language));
  render(html`<${Shell} />`, place);
  place.removeAttribute("aria-busy");
} catch (problem) {
  if (!(problem instanceof Problem)) throw problem;
  render(html`<main class="column"><p class="trouble" role="alert">${sentence(problem)}</p></main>`, place);
}
