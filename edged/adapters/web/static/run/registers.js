// The Modbus map, live while somebody looks at it.
import { $, data, detail, element } from "./dom.js";

let timer = 0;
export async function loadRegisters() {
  const answer = await fetch("/registers.json");
  if (!answer.ok) return;
  const wanted = $("find").value.trim().toLowerCase();
  const rows = (await answer.json()).filter((r) => !wanted || r.name.toLowerCase().includes(wanted) || String(r.address) === wanted);
  $("words").replaceChildren(...rows.map(registerRow));
}

function registerRow(r) {
  const value = element("td", { class: "value" }, r.text, ...(r.meaning ? [" ", detail(r.meaning)] : []));
  return element("tr", {}, element("td", {}, String(r.address)), element("td", {}, data(r.name)), value, element("td", {}, data(r.unit)), element("td", {}, data(r.help, { lang: "en" })));
}

$("registers").addEventListener("toggle", () => {
  clearInterval(timer);
  if ($("registers").open) {
    loadRegisters();
    timer = setInterval(loadRegisters, 1000);
  }
});
$("find").addEventListener("input", loadRegisters);
