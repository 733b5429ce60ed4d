// Words and numbers in the language of whoever looks. No text stands in the pages themselves: see the .ftl files.
import { computed, FluentBundle, FluentResource, signal } from "../vendor/ui.js";

export const LANGUAGES = { en: "English", de: "Deutsch" };
const PSEUDO = new URLSearchParams(location.search).has("pseudo");
const KEPT = /(?:^|; )edged_language=(\w+)/; // a cookie: the form to log in, which the cell writes, is in it too
const YEAR_S = 365 * 24 * 3600;
const parts = new Set(["setup/"]); // what is spoken: around the pages, and of each page that was entered
const resources = new Map(); // of a file's path
const path = (part, tag) => `/static/${part}${part.endsWith("/") ? "" : "."}${tag}.ftl`;
export const language = signal("en");

const heard = signal(0); // counts files: a bundle made before is made again
const bundle = computed(() => {
  void heard.value;
  // no isolating marks: every text is one sentence in one language, and tests compare what is seen
  const made = new FluentBundle(language.value, { useIsolating: false, transform: PSEUDO ? stretched : (text) => text });
  for (const part of parts) if (resources.has(path(part, language.value))) made.addResource(resources.get(path(part, language.value)));
  return made;
});

// Longer by two fifths and with accents: what is not stretched is written into a page, what does not fit shows.
const ACCENTS = { a: "á", e: "é", i: "í", o: "ó", u: "ú", A: "Á", E: "É", I: "Í", O: "Ó", U: "Ú", n: "ñ", s: "š", c: "č" };
function stretched(text) {
  if (!text.trim()) return text;
  const accented = [...text].map((letter) => ACCENTS[letter] ?? letter).join("");
  return `⟦${accented}${"~".repeat(Math.round(text.trim().length * 0.4))}⟧`;
}

async function load(part, tag) {
  if (resources.has(path(part, tag))) return;
  const answer = await fetch(path(part, tag));
  if (answer.ok) resources.set(path(part, tag), new FluentResource(await answer.text()));
}

// The texts of a page, as "setup/pages/teach", before it is shown.
export async function learn(part) {
  parts.add(part);
  for (let tag = ""; tag !== language.value; await load(part, tag)) tag = language.value; // chosen meanwhile
  heard.value += 1;
}

export async function speak(tag) {
  for (let known = 0; known < parts.size; ) { // entered meanwhile
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

// What was chosen here, what the user's record says, what the browser would like.
export const preferred = (users) => [KEPT.exec(document.cookie)?.[1], users, ...navigator.languages.map((tag) => tag.split("-")[0])].find((tag) => tag in LANGUAGES) ?? "en";

export const has = (id) => bundle.value.hasMessage(id);
export function t(id, values) {
  const message = bundle.value.getMessage(id);
  if (!message?.value) return id;
  return bundle.value.formatPattern(message.value, values, []);
}

// A code of the cell as ids are spelt: LOW_QUALITY is low-quality.
export const dashed = (code) => String(code).toLowerCase().replaceAll(/[ _]/g, "-");
// A code in words of its family; one that has none there speaks for itself.
export function inWords(family, code) {
  const id = `${family}-${dashed(code)}`;
  return has(id) ? t(id) : String(code);
}

const formats = computed(() => ({ tag: language.value, by: new Map() }));
export function number(value, digits = 0) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  const { tag, by } = formats.value;
  if (!by.has(digits)) by.set(digits, new Intl.NumberFormat(tag, { minimumFractionDigits: digits, maximumFractionDigits: digits, useGrouping: false }));
  return by.get(digits).format(value); // ungrouped: 8.000 in a field would be read again as 8
}
export const sign = (value, digits) => `${value < 0 ? "−" : "+"}${number(Math.abs(value), digits)}`;

export const moment = (iso) => new Intl.DateTimeFormat(language.value, { dateStyle: "medium", timeStyle: "short" }).format(new Date(iso));

// As people type it: 0,5 and 0.5 are the same; NaN for everything else, also for 1.000,5.
export function parseNumber(text) {
  const plain = text.trim().replace("−", "-").replace(",", ".");
  return /^-?(\d+\.?\d*|\.\d+)$/.test(plain) ? Number(plain) : NaN;
}
