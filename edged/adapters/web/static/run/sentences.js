// Sentences for the codes and figures of the cell.

import { dashed, has, language, number, t } from "../setup/shared/texts.js";
import { data, detail, element } from "./dom.js";

export const statusOf = (status) => t(`run-status-${dashed(status)}`);
export const kindOf = (status) => (status === "OK" ? "good" : status === "CAPTURE_FAULT" ? "bad" : "warn");
const rejects = (codes) => codes.map((code) => t(`run-reject-${dashed(code)}`)).join(", ");

// A number that comes as text is shown with its digits.
export const figure = (text) =>
  /^[-+]?\d+(\.\d+)?$/.test(text)
    ? `${text.startsWith("+") ? "+" : ""}${number(Number(text), (text.split(".")[1] ?? "").length)}`
    : text;
const figures = (values) =>
  Object.fromEntries(
    Object.entries(values).map(([name, value]) => [name, typeof value === "string" ? figure(value) : value]),
  );

// The time of day in the browser's regional format, if that is of the page's language.
export function clock(ns) {
  if (!ns) return "–";
  const tag = navigator.languages.find((liked) => liked.split("-")[0] === language.value) ?? language.value;
  return new Date(ns / 1e6).toLocaleTimeString(tag);
}

export const fault = (code) => t(has(`fault-${code}`) ? `fault-${code}` : "fault-other");

const REMEDIED = ["FEW_EDGES", "RESIDUAL", "SIGMA_LIMIT", "LEFT_RIGHT_MISMATCH", "OUT_OF_VOLUME"];
function cause({ code, number: count, text, reject, ...values }) {
  if (code === "ERROR") return [fault(count), " ", detail(text)];
  if (code === "NOTHING") return [t("run-why-nothing")];
  if (code === "NEAREST") return [t("run-why-nearest", figures(values))];
  if (code !== "SEEN") return [rejects([code])];
  const remedies = reject.filter((bit) => REMEDIED.includes(bit)).map((bit) => t(`run-try-${dashed(bit)}`));
  return [
    t("run-why-seen", {
      ...figures(values),
      reasons: rejects(reject),
      remedies: remedies.join(" ") || t("run-try-look"),
    }),
  ];
}
export const causes = (why) => why.map((reason) => element("div", {}, ...cause(reason)));
export const notGood = (codes) => t("run-not-good", { reasons: rejects(codes) });

// A fact is a value, a sentence by its code, or a list of these.
export function told(fact) {
  if (Array.isArray(fact)) return fact.flatMap((part, i) => (i ? ["; ", ...told(part)] : told(part)));
  if (typeof fact === "number") return [number(fact)];
  if (typeof fact === "string") return [data(fact)];
  const { code, text, ...values } = fact;
  if (code === "figure") return [data(`${figure(values.value)} ${values.unit}`)];
  return code === "own-words" ? [detail(text)] : [t(`run-told-${code}`, figures(values))];
}
export const nameOf = (name) => t(`run-fact-${dashed(name.replaceAll(",", ""))}`);
