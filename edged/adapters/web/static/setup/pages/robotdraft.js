// The registration that somebody is at: the newest state of its draft, and what is said of its things.
import { signal } from "../../vendor/ui.js";
import { ask, attempt, Problem } from "../api.js";
import { newest, told } from "../live.js";
import { t } from "../texts.js";

export const BRANDS = {
  ur: "Universal Robots", kuka: "KUKA", fanuc: "FANUC", yaskawa: "Yaskawa", abb: "ABB", staubli: "Stäubli",
  kawasaki: "Kawasaki", doosan: "Doosan", mitsubishi: "Mitsubishi", epson: "Epson", denso: "Denso", techman: "Techman",
};
// job: whose part is touched, null for the board of the draft.
export const current = { draft: signal(null), brands: signal([]), job: signal(null) };

export const heard = told("registration");

// This one, or the newest that is not in use yet: what somebody began goes on, here or on another screen.
export async function find(id) {
  const { registrations, brands } = await ask("GET", "registrations");
  current.brands.value = brands;
  const begun = registrations.find((one) => (id ? one.id === id : !one.active && !one.trouble));
  current.draft.value = begun ? await newest(heard, ask("GET", `registrations/${begun.id}`)) : null;
}

export function hear() {
  const [now, newer] = [current.draft.peek(), heard.value];
  if (now ? newer?.id === now.id && newer.revision >= now.revision : newer?.by_program) current.draft.value = newer;
}

// Of the draft as it is seen here: what somebody else has changed meanwhile is looked at first.
export const change = (method, path, body = {}) =>
  attempt(async () => {
    const { id, revision } = current.draft.value;
    try {
      const needsToken = "token" in body && !path.startsWith("/samples");
      current.draft.value = await newest(heard, ask(method, `registrations/${id}${path}`, needsToken ? body : { ...body, revision }));
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

// A mark by its place among those that are offered: 1 to 3 from either side.
export function placeName({ key, kind, name }) {
  const [row, column] = kind === "mark" ? key.split("-").slice(1) : ["", ""];
  return t(`robot-place-${kind}`, { name, row, column });
}
