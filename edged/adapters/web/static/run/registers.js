// The Modbus map, live while it is open. Its texts are loaded with it.

import { fetched } from "../setup/shared/fetched.js";
import { dashed, has, learn, t } from "../setup/shared/texts.js";
import { $, data, detail, element, muted } from "./dom.js";
import { figure } from "./sentences.js";

const MEANINGS = { "no value": "register-no-value", none: "register-none", unknown: "register-unknown" };
const NAMES = /^[\dA-Z_, ]+$/;
const CODES = /\d+ [A-Z][A-Z0-9_]+(?:, \d+ [A-Z][A-Z0-9_]+)*/; // names, not translated
let timer = 0;
let texts = null; // or false: asked for again

export async function loadRegisters() {
  texts ||= learn("run/registers").then((isKnown) => (texts = isKnown));
  const [all] = await Promise.all([fetched("/registers.json"), texts]);
  if (!all) return;
  const wanted = $("find").value.trim().toLowerCase();
  const rows = all.filter(
    (r) => !wanted || r.name.toLowerCase().includes(wanted) || String(r.address) === wanted,
  );
  $("words").replaceChildren(...rows.map(registerRow));
}

// The help of a register; rows of a table, and axes of a pose, share a text.
function helpOf({ name, address, help }) {
  const alike = name
    .replace(/^([TJ])\d+_/, "$1_")
    .replace(/_NAME_\d+$/, "_NAME")
    .replace(/_R[XYZ]$/, "_ROTATION")
    .replace(/(^|_)[XYZABC]$/, "$1AXIS");
  const id = `register-${dashed(alike)}`;
  const known = [`${id}-${Math.floor(address / 100)}`, id].find(has); // some names occur in two blocks
  const codes = help.match(CODES)?.[0] ?? "";
  if (known) return t(known, { codes });
  return name.startsWith("N_") ? t("register-n-reject", { code: name.slice(2) }) : null;
}

function registerRow(r) {
  const help = helpOf(r);
  const value = element(
    "td",
    { class: "value" },
    data(r.text),
    ...(r.meaning ? [" ", muted(meaningOf(r, help))] : []),
  );
  return element(
    "tr",
    {},
    element("td", {}, String(r.address)),
    element("td", {}, data(r.name)),
    value,
    element("td", {}, data(r.unit)),
    element("td", {}, help === null ? detail(r.help) : NAMES.test(help) ? data(help) : help),
  );
}

// A word listed in the register's help, a figure, or names of bits and codes.
function meaningOf({ text, meaning, help: english }, help) {
  if (/^[A-Z0-9_]+$/.test(meaning)) return data(meaning);
  const listed = new RegExp(`(?:^|, )${text}:? (\\p{L}[\\p{L}_ -]*)`, "u");
  if (english.match(listed)?.[1] === meaning) return data(help?.match(listed)?.[1] ?? meaning);
  if (MEANINGS[meaning]) return t(MEANINGS[meaning]);
  const [, amount, unit] = meaning.match(/^(-?\d+\.\d+)( mm|°)$/) ?? [];
  return data(amount ? figure(amount) + unit : meaning);
}

$("registers").addEventListener("toggle", () => {
  clearInterval(timer);
  if ($("registers").open) {
    loadRegisters();
    timer = setInterval(loadRegisters, 1000);
  }
});
$("find").addEventListener("input", loadRegisters);
