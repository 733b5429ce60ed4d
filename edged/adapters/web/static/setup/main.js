// Starts the page: texts first, then what the cell is, then what people see.
import { html, render } from "../vendor/ui.js";
import { Problem, sentence } from "./api.js";
import { me, start } from "./live.js";
import { Shell } from "./shell.js";
import { preferred, speak } from "./texts.js";

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
