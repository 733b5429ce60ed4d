// The draft of the registration, and the names of its samples.
import { signal } from "../../vendor/ui.js";
import { ask, attempt, glance, Problem } from "../shared/api.js";
import { discard, forget, isAside, putAside, unfinished } from "../shared/drafts.js";
import { newest, told } from "../shared/live.js";
import { t } from "../shared/texts.js";

// job: the job whose part is touched, null for the board of the draft.
// map: of the robot's error, by which the cell runs; null without.
export const current = {
  draft: signal(null),
  drafts: signal([]),
  brands: signal([]),
  job: signal(null),
  map: signal(null),
};

export const heard = told("registration");

const KIND = "registrations";
async function list() {
  ({
    registrations: current.drafts.value,
    brands: current.brands.value,
    robot_map: current.map.value,
  } = await ask("GET", KIND));
}
export async function goOn(id) {
  current.draft.value = await newest(heard, ask("GET", `${KIND}/${id}`));
}

// Opens this draft, else the unfinished one, unless another one was opened while it was looked for.
export async function find(id) {
  const before = current.draft.peek();
  await list();
  const begun = current.drafts.value.find((one) => one.id === id) ?? unfinished(KIND, current.drafts.value);
  const found = begun && (await newest(heard, ask("GET", `${KIND}/${begun.id}`)));
  if (current.draft.peek() === before) current.draft.value = found;
}

export async function another() {
  await list();
  putAside(KIND, current.drafts.value);
  current.draft.value = null;
}
export async function throwAway(id) {
  await glance(list);
  putAside(KIND, current.drafts.value);
  if (!(await discard(KIND, id))) return;
  if (current.draft.value?.id === id) current.draft.value = null;
  await glance(list);
}

export function hear() {
  const [now, newer] = [current.draft.peek(), heard.value];
  if (!newer) return;
  const isShown = newer.id === now?.id;
  if (newer.gone) {
    forget(KIND, newer.id);
    if (isShown) current.draft.value = null;
  } else if (isShown ? newer.revision >= now.revision : !now && newer.by_program && !isAside(KIND, newer.id))
    current.draft.value = newer;
}

// Changes the revision shown here; after somebody else's change the draft is reloaded first.
export const change = (method, path, body = {}) =>
  attempt(async () => {
    const { id, revision } = current.draft.value;
    try {
      const needsToken = "token" in body && !path.startsWith("/samples");
      current.draft.value = await newest(
        heard,
        ask(method, `registrations/${id}${path}`, needsToken ? body : { ...body, revision }),
      );
    } catch (problem) {
      if (problem instanceof Problem && problem.status === 412) await find(id);
      throw problem;
    }
    return current.draft.value;
  });

// "point_003": point 3.
export function sampleName(name) {
  const [kind, count] = name.split("_");
  return t(`robot-name-${kind}`, { number: Number(count) });
}

// A mark is named by row and column among those offered.
export function placeName({ key, kind, name }) {
  const [row, column] = kind === "mark" ? key.split("-").slice(1) : ["", ""];
  return t(`robot-place-${kind}`, { name, row, column });
}
