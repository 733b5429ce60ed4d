// What an address of this cell holds, or null: refused, out of reach, or broken off by leaving the page.
/** @param {string} path @param {"json" | "text"} kind @returns {Promise<any>} */
export async function fetched(path, kind = "json") {
  try {
    const answer = await fetch(path);
    return answer.ok ? await answer[kind]() : null;
  } catch {
    return null;
  }
}
