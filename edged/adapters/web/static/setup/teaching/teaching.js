// The draft of the job being taught; every change goes through the cell.
import { effect, signal } from "../../vendor/ui.js";
import { ask, attempt, glance, Problem } from "../shared/api.js";
import { opening } from "../shared/drafts.js";
import { newest, told } from "../shared/live.js";

const KEPT = "edged.teaching";
export const teaching = signal(null);
export const drafts = signal(null);
export const jobs = signal(null);
export const lit = signal(null); // the feature under mouse or focus

export const pushed = told("teaching");
effect(() => {
  if (!pushed.value || pushed.value.id !== teaching.peek()?.id) return;
  if (pushed.value.gone) open(null);
  else see(pushed.value);
});

// Shows a document unless it is older: answers and messages come in any order.
export function see(document) {
  if (document && document.id === teaching.peek()?.id && document.revision >= teaching.peek().revision)
    teaching.value = document;
}

export function open(document) {
  teaching.value = document;
  lit.value = null;
  if (document) localStorage.setItem(KEPT, document.id);
  else localStorage.removeItem(KEPT);
}

// Lists drafts and jobs, and opens the draft that was open here unless it is in use.
export async function find() {
  [{ teachings: drafts.value }, { jobs: jobs.value }] = await Promise.all([
    ask("GET", "teachings"),
    ask("GET", "jobs"),
  ]);
  const last = drafts.value.find(({ id, active }) => id === localStorage.getItem(KEPT) && !active);
  if (last) open(await newest(pushed, ask("GET", `teachings/${last.id}`)));
}

// Reloads the draft, which may have been discarded.
export const lookAgain = () =>
  glance(async () => {
    if (opening.peek()) open(opening.peek());
    opening.value = null;
    const { id, active } = teaching.value ?? {};
    if (!id || active) return find();
    try {
      return see(await newest(pushed, ask("GET", `teachings/${id}`)));
    } catch (problem) {
      if (problem.status !== 404) throw problem;
      open(null);
      return find();
    }
  });

// Changes are sent one after the other: quick taps must not conflict with each other.
let queue = Promise.resolve();
export function change(method, path, body = {}) {
  const done = queue.then(() => attempt(() => send(method, path, body)));
  queue = done.catch(() => {});
  return done;
}

async function send(method, path, body, isAgain = false) {
  const { id, revision } = teaching.value;
  try {
    see(await newest(pushed, ask(method, `teachings/${id}${path}`, { ...body, revision })));
    return true;
  } catch (problem) {
    if (problem.status !== 412) throw problem;
    see(problem.params?.document ?? (await newest(pushed, ask("GET", `teachings/${id}`))));
    // a place in the picture stays the same one, whatever the cell has found meanwhile
    if (path === "/tap" && !isAgain) return send(method, path, body, true);
    throw new Problem({ status: 412, code: "stale", detail: problem.detail });
  }
}
