// Live pictures on a canvas, with shapes over them in raw image pixels.
import { effect, html, useEffect, useRef } from "../../vendor/ui.js";
import { sentence } from "./api.js";
import { cell, holds, liveState, liveViews, pictures, rawSize, SIDES } from "./live.js";
import { t } from "./texts.js";

function View({ side, children, stripe, label }) {
  const canvas = useRef(null);
  const stripes = useRef(null);
  useEffect(
    () =>
      effect(() => {
        const bitmap = pictures[side].value;
        const shown = canvas.current;
        if (!bitmap || !shown) return;
        if (shown.width !== bitmap.width || shown.height !== bitmap.height)
          Object.assign(shown, { width: bitmap.width, height: bitmap.height });
        shown.getContext("2d").drawImage(bitmap, 0, 0);
        if (stripes.current) stripe(bitmap, stripes.current);
      }),
    [side, stripe],
  );
  const { width, height } = rawSize(side);
  const isThere = pictures[side].value !== null;
  return html`<div
    class="view ${isThere || holds.value ? "" : "bare"}"
    style=${isThere || holds.value ? { aspectRatio: `${width} / ${height}` } : {}}
  >
    <canvas ref=${canvas} role="img" aria-label=${label} hidden=${!isThere}></canvas>
    ${stripe && html`<canvas ref=${stripes} class="stripes" aria-hidden="true" hidden=${!isThere}></canvas>`}
    <svg viewBox="0 0 ${width} ${height}" aria-hidden="true">${children}</svg>
    ${
      isThere &&
      liveState.value.on &&
      liveState.value.code &&
      html`<p class="dark over"><span>${sentence(liveState.value)}</span></p>`
    }
    ${
      !isThere &&
      html`<p class="dark">
        ${t(holds.value ? "live-waiting" : cell.value?.setup?.name ? "live-watching" : "live-take")}
      </p>`
    }
  </div>`;
}

// Both pictures. over(side): shapes over one; stripe(bitmap, canvas): marks pixels. Cameras run while one is
// shown and the lease is held.
export function Pair({ over, stripe, below }) {
  useEffect(() => {
    liveViews.value += 1; // the next page's may mount before the last one's unmount
    return () => {
      liveViews.value -= 1;
    };
  }, []);
  return html`<div class="pair">
    ${SIDES.map(
      (side) =>
        html`<figure key=${side}>
          <figcaption>${t(side)}</figcaption>
          <${View} side=${side} stripe=${stripe} label=${t(`live-${side}`)}>${over?.(side)}<//>
          ${below?.(side)}
        </figure>`,
    )}
  </div>`;
}

export const points = (polygon) => polygon.map(([x, y]) => `${x + 0.5},${y + 0.5}`).join(" ");
