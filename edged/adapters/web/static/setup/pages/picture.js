// The live pictures: drawn on a canvas, whose pixels can be read, with shapes over them in raw image pixels.
import { effect, html, useEffect, useRef } from "../../vendor/ui.js";
import { cell, holds, liveState, liveViews, pictures, rawSize, SIDES } from "../live.js";
import { sentence } from "../api.js";
import { t } from "../texts.js";

const READ_PX = 480;
const CLIPPED = 252; // JPEG: what was 255 comes back as 252 and more
const DARK = 12; // as the cell counts it
const STRIPE_PX = 5;

// Stripes where nothing can be measured: clipped leaning right, too dark leaning left, so that no colour is needed.
function stripe(bitmap, canvas) {
  const width = Math.min(READ_PX, bitmap.width);
  const height = Math.round((bitmap.height * width) / bitmap.width);
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  const context = canvas.getContext("2d", { willReadFrequently: true });
  context.drawImage(bitmap, 0, 0, width, height);
  const image = context.getImageData(0, 0, width, height);
  const pixels = new Uint32Array(image.data.buffer);
  for (let y = 0, i = 0; y < height; y++)
    for (let x = 0; x < width; x++, i++) {
      const grey = pixels[i] & 255;
      if (grey >= CLIPPED) pixels[i] = (x + y) % (2 * STRIPE_PX) < STRIPE_PX ? 0xff1a1aff : 0xff000000;
      else if (grey <= DARK) pixels[i] = (x - y + 10 * READ_PX) % (2 * STRIPE_PX) < 2 ? 0xffff9a3c : 0;
      else pixels[i] = 0;
    }
  context.putImageData(image, 0, 0);
}

function View({ side, children, isStriped, label }) {
  const canvas = useRef(null);
  const stripes = useRef(null);
  useEffect(
    () =>
      effect(() => {
        const bitmap = pictures[side].value;
        const shown = canvas.current;
        if (!bitmap || !shown) return;
        if (shown.width !== bitmap.width || shown.height !== bitmap.height) Object.assign(shown, { width: bitmap.width, height: bitmap.height });
        shown.getContext("2d").drawImage(bitmap, 0, 0);
        if (stripes.current) stripe(bitmap, stripes.current);
      }),
    [side, isStriped],
  );
  const { width, height } = rawSize(side);
  const isThere = pictures[side].value !== null;
  return html`<div class="view" style=${{ aspectRatio: `${width} / ${height}` }}>
    <canvas ref=${canvas} role="img" aria-label=${label} hidden=${!isThere}></canvas>
    ${isStriped && html`<canvas ref=${stripes} class="stripes" aria-hidden="true" hidden=${!isThere}></canvas>`}
    <svg viewBox="0 0 ${width} ${height}" aria-hidden="true">${children}</svg>
    ${isThere && liveState.value.on && liveState.value.code && html`<p class="dark over"><span>${sentence(liveState.value)}</span></p>`}
    ${!isThere && html`<p class="dark">${t(holds.value ? "live-waiting" : cell.value?.setup?.name ? "live-watching" : "live-take")}</p>`}
  </div>`;
}

// Both pictures; over : draws over one side. Capturing runs while one of these is on a page of whoever has the cell.
export function Pair({ over, isStriped, below }) {
  useEffect(() => {
    liveViews.value += 1; // the next page's may come before the last one's have gone
    return () => {
      liveViews.value -= 1;
    };
  }, []);
  return html`<div class="pair">
    ${SIDES.map(
      (side) =>
        html`<figure key=${side}>
          <figcaption>${t(side)}</figcaption>
          <${View} side=${side} isStriped=${isStriped} label=${t(`live-${side}`)}>${over?.(side)}<//>
          ${below?.(side)}
        </figure>`,
    )}
  </div>`;
}

export const points = (polygon) => polygon.map(([x, y]) => `${x + 0.5},${y + 0.5}`).join(" ");
