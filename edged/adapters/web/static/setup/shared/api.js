// Requests to the cell and their errors.
import { batch, signal } from "../../vendor/ui.js";
import { dashed, has, t } from "./texts.js";

export class Problem extends Error {
  /** @param {{ status?: number, code?: string, detail?: string, params?: any }} answer */
  constructor({ status = 0, code = "", detail = "", params = {} }) {
    super(detail);
    this.status = status;
    this.code = code;
    this.detail = detail;
    this.params = params;
  }
}

// The last error, until it is dismissed, and what had been pressed; null for what the page did by itself.
export const trouble = signal(null);
export const troubled = signal(null);

// The control that was used last: an error stands beside it.
const CONTROLS = "button, a, input, select, textarea, summary";
let used = null;
/** @param {any} event */
const use = ({ target, submitter }) => {
  used = submitter ?? target.closest?.(CONTROLS) ?? used;
};
for (const name of ["click", "input", "change", "focusout", "keydown", "submit"])
  addEventListener(name, use, { capture: true, passive: true });

const AGAIN_MS = 700;
const wait = (ms) => new Promise((done) => setTimeout(done, ms));

// Sent once more without an answer, with the same key, so that nothing is done twice.
async function send(path, request, isAgain) {
  try {
    return await fetch(`/api/v1/${path}`, request);
  } catch {
    if (isAgain) throw new Problem({ code: "unreachable" });
    await wait(AGAIN_MS);
    return send(path, request, true);
  }
}

// A request that waits for the password to be said again; answer(isSaid) lets it go on or fail.
export const confirming = signal(null);
const confirmed = () =>
  new Promise((answer) => {
    confirming.value?.answer(false);
    confirming.value = {
      answer: (isSaid) => {
        confirming.value = null;
        answer(isSaid);
      },
    };
  });

// The log-in form keeps the fragment and leads back to this step.
export const logIn = () => location.assign(`/login?to=setup${location.hash}`);

export async function ask(method, path, body) {
  const request = { method };
  if (method !== "GET") {
    const key = [...crypto.getRandomValues(new Uint32Array(4))].map((word) => word.toString(36)).join("");
    const isFile = body instanceof Blob;
    const type = isFile ? "application/octet-stream" : "application/json";
    request.headers = { "Content-Type": type, "Idempotency-Key": key };
    request.body = isFile ? body : JSON.stringify(body ?? {});
  }
  const answer = await send(path, request);
  const [, name] = answer.headers.get("Content-Disposition")?.split('"') ?? [];
  const cutOff = () => {
    throw new Problem({ code: "unreachable" }); // or the page is being left
  };
  if (name) return new File([await answer.blob().catch(cutOff)], name);
  const isJson = /json/.test(answer.headers.get("Content-Type") ?? "");
  const document = isJson ? await answer.json().catch(cutOff) : {};
  if (answer.ok) return document;
  if (answer.status === 401) logIn();
  if (document.code === "confirm" && (await confirmed())) return ask(method, path, body);
  throw new Problem({ status: answer.status, code: `status_${answer.status}`, ...document });
}

// A sentence with cause and remedy, or the server's own. A camera's fault has the words of the Run page.
const SIDE_NAMES = new Set(["left", "right"]);
const FAULT = /^camera_(\d+)$/;
export function sentence(problem) {
  const [, fault] = FAULT.exec(problem.code ?? "") ?? [];
  const id = fault ? `fault-${fault}` : `problem-${dashed(problem.code ?? "")}`;
  const side = problem.params?.camera ?? "";
  if (fault && has(id)) return SIDE_NAMES.has(side) ? `${t(side)}: ${t(id)}` : t(id);
  if (has(id)) return t(id, { ...problem.params, detail: problem.detail || "" });
  return t("problem-other", { detail: problem.detail || problem.message || problem.code });
}

// An error that came meanwhile stays.
async function tried(work, isOver, control) {
  const before = trouble.peek();
  try {
    const answer = await work();
    if (trouble.peek() === before && isOver(before)) trouble.value = null;
    return answer;
  } catch (problem) {
    if (!(problem instanceof Problem)) throw problem;
    batch(() => {
      trouble.value = problem;
      troubled.value = control;
    });
    return undefined;
  }
}

// Runs work and shows its error; returns its answer, or undefined.
export const attempt = (work) => tried(work, () => true, used);

// As `attempt`, for what the page does by itself: success clears only "unreachable".
export const glance = (work) => tried(work, (problem) => problem?.status === 0, null);
