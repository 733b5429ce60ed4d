// Texts and numbers in the chosen language. All texts are in the .ftl files.
import { computed, FluentBundle, FluentResource, signal } from "../../vendor/ui.js";
import { fetched } from "./fetched.js";

export const LANGUAGES = { en: "English", de: "Deutsch", fr: "Français", ja: "日本語", zh: "简体中文" };
const PSEUDO = new URLSearchParams(location.search).has("pseudo");
const KEPT = /(?:^|; )edged_language=(\w+)/; // a cookie, so that the log-in form has it too
const YEAR_S = 365 * 24 * 3600;
const parts = new Set(["setup/"]); // loaded parts: the shell and each opened page
const resources = new Map(); // by path
const path = (part, tag) => `/static/${part}${part.endsWith("/") ? "" : "."}${tag}.ftl`;
export const language = signal("en");

const heard = signal(0); // counts loaded files, so that the bundle is made again
const bundle = computed(() => {
  void heard.value;
  // no isolating marks: every text is in one language, and tests compare it
  const made = new FluentBundle(language.value, {
    useIsolating: false,
    transform: PSEUDO ? stretched : (text) => text,
  });
  for (const part of parts)
    if (resources.has(path(part, language.value)))
      made.addResource(resources.get(path(part, language.value)));
  return made;
});

// Longer by two fifths and accented: shows texts that are not translated, or do not fit.
const ACCENTS = {
  a: "á",
  e: "é",
  i: "í",
  o: "ó",
  u: "ú",
  A: "Á",
  E: "É",
  I: "Í",
  O: "Ó",
  U: "Ú",
  n: "ñ",
  s: "š",
  c: "č",
};
function stretched(text) {
  if (!text.trim()) return text;
  const accented = [...text].map((letter) => ACCENTS[letter] ?? letter).join("");
  return `⟦${accented}${"~".repeat(Math.round(text.trim().length * 0.4))}⟧`;
}

async function load(part, tag) {
  if (resources.has(path(part, tag))) return;
  const text = await fetched(path(part, tag), "text");
  if (text !== null) resources.set(path(part, tag), new FluentResource(text));
}

// Loads the texts of a page, such as "setup/teaching/teach"; whether they are there.
export async function learn(part) {
  parts.add(part);
  // the language may change meanwhile
  for (let tag = ""; tag !== language.value; await load(part, tag)) tag = language.value;
  heard.value += 1;
  return resources.has(path(part, language.value));
}

export async function speak(tag) {
  for (let known = 0; known < parts.size; ) {
    // may grow meanwhile
    known = parts.size;
    await Promise.all([...parts].map((part) => load(part, tag)));
  }
  language.value = tag;
  document.documentElement.lang = tag;
}

export async function choose(tag) {
  document.cookie = `edged_language=${tag}; path=/; max-age=${YEAR_S}; samesite=lax`;
  await speak(tag);
}

// The language chosen here, else the user's, else the browser's.
export const preferred = (users) =>
  [KEPT.exec(document.cookie)?.[1], users, ...navigator.languages.map((tag) => tag.split("-")[0])].find(
    (tag) => tag in LANGUAGES,
  ) ?? "en";

export const has = (id) => bundle.value.hasMessage(id);
export function t(id, values) {
  const message = bundle.value.getMessage(id);
  if (!message?.value) return id;
  return bundle.value.formatPattern(message.value, values, []);
}

// A code as spelt in text ids: LOW_QUALITY is low-quality.
export const dashed = (code) => String(code).toLowerCase().replaceAll(/[ _/]/g, "-");
// The text of a code in a family of ids, or the code itself.
export function inWords(family, code) {
  const id = `${family}-${dashed(code)}`;
  return has(id) ? t(id) : String(code);
}

const formats = computed(() => ({ tag: language.value, by: new Map() }));
export function number(value, digits = 0) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  const { tag, by } = formats.value;
  if (!by.has(digits))
    by.set(
      digits,
      new Intl.NumberFormat(tag, {
        minimumFractionDigits: digits,
        maximumFractionDigits: digits,
        useGrouping: false,
      }),
    );
  // ungrouped: 8.000 in a field would be read again as 8
  return by.get(digits).format(isShownAsZero(value, digits) ? 0 : value);
}
// What rounds to zero has no sign: −0.000 would look like a finding.
const isShownAsZero = (value, digits) => Math.abs(value) < 0.5 * 10 ** -digits;
export function sign(value, digits) {
  const shown = number(Math.abs(value), digits);
  if (isShownAsZero(value, digits)) return shown;
  return `${value < 0 ? "−" : "+"}${shown}`;
}

/** @param {string} iso @param {"short" | "medium"} timeStyle medium: with seconds */
export const moment = (iso, timeStyle = "short") =>
  new Intl.DateTimeFormat(language.value, { dateStyle: "medium", timeStyle }).format(new Date(iso));

// Parses 0,5 and 0.5 alike; NaN for everything else, also for 1.000,5.
export function parseNumber(text) {
  const plain = text.trim().replace("−", "-").replace(",", ".");
  return /^-?(\d+\.?\d*|\.\d+)$/.test(plain) ? Number(plain) : NaN;
}
