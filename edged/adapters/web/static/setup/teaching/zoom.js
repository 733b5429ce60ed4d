// A zoomable picture: wheel, two fingers, keys, buttons; taps, strokes and a cross in raw px.
import { html, signal, useEffect, useRef, useState } from "../../vendor/ui.js";
import { t } from "../shared/texts.js";

// The shown box of the left picture, raw px; the right shows the same, moved by the parallax. null: all.
export const box = signal(null);
const CLOSEST_PX = 24;
const STEP = 1.4;
const TAP_PX = 6; // a finger never rests
const STEPS_PX = { plain: 10, shift: 50, alt: 1 };
const PIXELS_FROM = 4; // screen px per raw px from which pixels are drawn as squares

const clamp = (value, low, high) => Math.min(Math.max(value, low), Math.max(low, high));
export const middle = (one) => [one.x + one.w / 2, one.y + one.h / 2];
const whole = ({ width, height }) => ({ x: -0.5, y: -0.5, w: width, h: height });

// Zooms by a factor around a fixed point.
export function zoom(size, factor, at) {
  const all = whole(size);
  const now = box.value ?? all;
  const [x, y] = at ?? middle(now);
  const w = clamp(now.w / factor, CLOSEST_PX, all.w);
  const share = w / now.w;
  moveTo(size, { x: x - (x - now.x) * share, y: y - (y - now.y) * share, w, h: now.h * share });
}

function moveTo(size, wanted) {
  const all = whole(size);
  const isWhole = wanted.w >= all.w * 0.999;
  box.value = isWhole
    ? null
    : {
        ...wanted,
        x: clamp(wanted.x, all.x, all.x + all.w - wanted.w),
        y: clamp(wanted.y, all.y, all.y + all.h - wanted.h),
      };
}

const pan = (size, dx, dy) => {
  const now = box.value ?? whole(size);
  moveTo(size, { ...now, x: now.x + dx, y: now.y + dy });
};

// Centres a point, with some px around it.
/** @param {number[]} at */
export function lookAt(size, at, around = 160) {
  const all = whole(size);
  const w = clamp((around * all.w) / all.h, CLOSEST_PX, all.w);
  const h = (w * all.h) / all.w;
  moveTo(size, { x: at[0] - w / 2, y: at[1] - h / 2, w, h });
}

export const ZoomButtons = ({ size }) => html`<div class="zoom" role="group" aria-label=${t("zoom")}>
  <button aria-label=${t("zoom-in")} onClick=${() => zoom(size, STEP)}>+</button>
  <button aria-label=${t("zoom-out")} disabled=${!box.value} onClick=${() => zoom(size, 1 / STEP)}>−</button>
  <button disabled=${!box.value} onClick=${() => (box.value = null)}>${t("zoom-all")}</button>
</div>`;

// The place of an event, raw px.
function placeIn(svg, event) {
  const { x, y } = new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
  return [x, y];
}
const scaleOf = (svg) => (svg ? 1 / (svg.getScreenCTM()?.a || 1) : 1);

// onTap([x, y], scale); onHover likewise, or null; onStroke(points, isDone, scale): dragging draws, and two
// fingers move the picture. draw(scale): shapes over it. scale: raw px per screen px.
export function Zoomed({ side, size, src, label, shift = [0, 0], onTap, onStroke, onHover, tool, draw }) {
  const svg = useRef(null);
  const fingers = useRef(new Map());
  const held = useRef(null); // where the finger went down
  const [cross, setCross] = useState(null);
  const [scale, setScale] = useState(1);
  const isLeft = side === "left";
  const all = whole(size);
  const left = box.value ?? all;
  const shown = isLeft || !box.value ? left : { ...left, x: left.x + shift[0], y: left.y + shift[1] };

  useEffect(() => {
    const measure = () => setScale(scaleOf(svg.current));
    const watcher = new ResizeObserver(measure);
    watcher.observe(svg.current);
    measure();
    return () => watcher.disconnect();
  }, [box.value, size.width]);
  useEffect(() => {
    const wheel = (event) => {
      if (!box.value && event.deltaY > 0) return; // nothing to zoom out of: the page scrolls
      event.preventDefault();
      const [x, y] = placeIn(svg.current, event);
      zoom(size, 1.002 ** -event.deltaY, isLeft ? [x, y] : [x - shift[0], y - shift[1]]);
    };
    const element = svg.current;
    element.addEventListener("wheel", wheel, { passive: false });
    return () => element.removeEventListener("wheel", wheel);
  }, [size.width, size.height, shift[0], shift[1]]);

  const down = (event) => {
    if (event.button > 0 && event.pointerType === "mouse") return;
    fingers.current.set(event.pointerId, event);
    if (fingers.current.size > 1) {
      if (held.current?.points) onStroke?.([], true, scale); // it was the first of two fingers
      held.current = null;
      return;
    }
    const at = placeIn(svg.current, event);
    held.current = { x: event.clientX, y: event.clientY, at, moved: false, points: onStroke ? [at] : null };
    if (onStroke) svg.current.setPointerCapture(event.pointerId);
  };
  const move = (event) => {
    const before = fingers.current.get(event.pointerId);
    if (!before) return onHover?.(placeIn(svg.current, event), scale);
    if (fingers.current.size === 2) pinch(before, event);
    else if (held.current) drag(before, event);
    fingers.current.set(event.pointerId, event);
  };
  const pinch = (before, event) => {
    const other = [...fingers.current.entries()].find(([id]) => id !== event.pointerId)[1];
    const apart = (one) => Math.hypot(one.clientX - other.clientX, one.clientY - other.clientY);
    const at = placeIn(svg.current, {
      clientX: (event.clientX + other.clientX) / 2,
      clientY: (event.clientY + other.clientY) / 2,
    });
    const factor = apart(event) / Math.max(apart(before), 1);
    zoom(size, factor, isLeft ? at : [at[0] - shift[0], at[1] - shift[1]]);
    const raw = scaleOf(svg.current);
    pan(size, ((before.clientX - event.clientX) * raw) / 2, ((before.clientY - event.clientY) * raw) / 2);
  };
  const drag = (before, event) => {
    const from = held.current;
    from.moved ||= Math.hypot(event.clientX - from.x, event.clientY - from.y) > TAP_PX;
    if (!from.moved) return;
    if (from.points) {
      from.points.push(placeIn(svg.current, event));
      onStroke(from.points, false, scale);
    } else {
      const raw = scaleOf(svg.current);
      pan(size, (before.clientX - event.clientX) * raw, (before.clientY - event.clientY) * raw);
    }
  };
  const up = (event) => {
    const was = held.current;
    fingers.current.delete(event.pointerId);
    if (!fingers.current.size) held.current = null;
    if (!was || event.type === "pointercancel") {
      if (was?.points) onStroke([], true, scale);
      return;
    }
    if (was.points && was.moved) onStroke(was.points, true, scale);
    else if (!was.moved) {
      if (was.points) onStroke([], true, scale);
      setCross(null);
      onTap?.(was.at, scale);
    }
  };

  const key = (event) => {
    if (event.target !== svg.current || event.ctrlKey || event.metaKey) return;
    const arrow = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
    const step =
      (event.shiftKey ? STEPS_PX.shift : event.altKey ? STEPS_PX.alt : STEPS_PX.plain) *
      Math.max(scale, 1 / 50);
    if (arrow && !onTap) pan(size, arrow[0] * step * 4, arrow[1] * step * 4);
    else if (arrow) {
      const [x, y] = cross ?? middle(shown);
      const next = [
        clamp(x + arrow[0] * step, all.x, all.x + all.w),
        clamp(y + arrow[1] * step, all.y, all.y + all.h),
      ];
      setCross(next);
      if (
        next[0] < shown.x ||
        next[0] > shown.x + shown.w ||
        next[1] < shown.y ||
        next[1] > shown.y + shown.h
      )
        pan(size, next[0] - x, next[1] - y);
    } else if (event.key === "+" || event.key === "=") zoom(size, STEP, cross ?? undefined);
    else if (event.key === "-") zoom(size, 1 / STEP, cross ?? undefined);
    else if (event.key === "0") box.value = null;
    else if ((event.key === "Enter" || event.key === " ") && onTap) onTap(cross ?? middle(shown), scale);
    else return;
    event.preventDefault();
  };
  const arm = 14 * scale;
  return html`<svg
    ref=${svg} class="zoomed ${tool ?? ""} ${box.value ? "close" : ""}" data-side=${side}
    viewBox="${shown.x} ${shown.y} ${shown.w} ${shown.h}"
    style=${{ "--px": scale, aspectRatio: `${size.width} / ${size.height}` }}
    role=${onTap ? "application" : "img"} aria-label=${label} tabindex=${onTap ? 0 : undefined}
    onPointerDown=${down} onPointerMove=${move} onPointerUp=${up} onPointerCancel=${up}
    onPointerLeave=${() => onHover?.(null)} onKeyDown=${key} onBlur=${() => setCross(null)}
  >
    <image
      href=${src} x="-0.5" y="-0.5" width=${size.width} height=${size.height}
      style=${{ imageRendering: scale < 1 / PIXELS_FROM ? "pixelated" : "auto" }}
    />
    ${draw?.(scale)}
    ${
      cross &&
      html`<path
        class="cross"
        d="M${cross[0] - arm} ${cross[1]}h${2 * arm}M${cross[0]} ${cross[1] - arm}v${2 * arm}"
      />`
    }
  </svg>`;
}

// A point that fingers, mouse and arrow keys move: 48 screen px wide, and told where it is.
const FINE = { plain: 1, shift: 10, alt: 0.1 };
export function Handle({ at, scale, label, onMove, onEnd, onDelete }) {
  const held = useRef(null);
  const timer = useRef(0);
  useEffect(() => () => clearTimeout(timer.current), []);
  const down = (event) => {
    event.stopPropagation();
    event.currentTarget.setPointerCapture(event.pointerId);
    const [x, y] = placeIn(event.currentTarget.ownerSVGElement, event);
    held.current = [at[0] - x, at[1] - y];
  };
  const move = (event) => {
    if (!held.current) return;
    event.stopPropagation();
    const [x, y] = placeIn(event.currentTarget.ownerSVGElement, event);
    onMove([x + held.current[0], y + held.current[1]]);
  };
  const up = (event) => {
    if (!held.current) return;
    event.stopPropagation();
    held.current = null;
    onEnd();
  };
  const key = (event) => {
    const arrow = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
    if ((event.key === "Delete" || event.key === "Backspace") && onDelete) onDelete();
    else if (arrow) {
      const step = event.shiftKey ? FINE.shift : event.altKey ? FINE.alt : FINE.plain;
      onMove([at[0] + arrow[0] * step, at[1] + arrow[1] * step]);
      clearTimeout(timer.current); // told when the keys rest
      timer.current = setTimeout(onEnd, 400);
    } else return;
    event.preventDefault();
    event.stopPropagation();
  };
  return html`<g
    class="handle" tabindex="0" role="button" aria-label=${label} onPointerDown=${down}
    onPointerMove=${move} onPointerUp=${up} onPointerCancel=${up} onKeyDown=${key}
  >
    <circle class="reach" cx=${at[0]} cy=${at[1]} r=${24 * scale} />
    <circle class="dot" cx=${at[0]} cy=${at[1]} r=${7 * scale} />
  </g>`;
}
