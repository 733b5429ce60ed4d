// The cell in space, drawn as lines that people turn: cameras, depths, boards, the last part and its error.
// Plain SVG: it is sharp on every screen, needs no WebGL, and no library for a few hundred lines.
import { html, useEffect, useRef, useState } from "../../vendor/ui.js";
import { ask, glance } from "../shared/api.js";
import { fetched } from "../shared/fetched.js";
import { useFresh } from "../shared/live.js";
import { Shape } from "../shared/pieces.js";
import { number, t } from "../shared/texts.js";

const SIZE = 560; // of the square that the scene fills
const EDGE = 28; // of which names keep clear
const LATE = 0.65; // of the width: from there on names stand before what they name
const TURN = 0.008; // rad per px
const STEP = { turn: 0.12, zoom: 1.2 };
const EVERY_MS = 1000;
const REACH = 6; // times the farthest part: a robot's base beyond would make all else small
const ERROR_SHARE = 0.08; // of the size of the scene: how large the ellipsoid is drawn
const FRONT = { yaw: 0, pitch: 0 };
const VIEWS = {
  front: FRONT,
  above: { ...FRONT, pitch: -Math.PI / 2 },
  side: { ...FRONT, yaw: Math.PI / 2 },
};
const FIRST = { yaw: 0.7, pitch: -0.45 };

// --- vectors: [x, y, z] in mm, rig frame ---

const add = (a, b, times = 1) => a.map((value, i) => value + times * b[i]);
const apply = (rows, point) => rows.map((row) => row.reduce((sum, value, i) => sum + value * point[i], 0));
const along = (start, rays, depth) => rays.map((ray) => add(start, ray, depth / Math.max(ray[2], 0.1)));

// L with L Lᵗ = a covariance: it makes an ellipsoid of the unit sphere.
function rootOf(covariance) {
  const low = [0, 1, 2].map(() => [0, 0, 0]);
  for (let i = 0; i < 3; i++)
    for (let j = 0; j <= i; j++) {
      const rest =
        covariance[i][j] - low[i].reduce((sum, value, k) => sum + (k < j ? value * low[j][k] : 0), 0);
      low[i][j] = i === j ? Math.sqrt(Math.max(rest, 0)) : low[j][j] && rest / low[j][j];
    }
  return low;
}

// The longest half axis of an ellipsoid, by repeated multiplication.
function longestOf(covariance) {
  let axis = [1, 1, 1];
  let size = 0;
  for (let i = 0; i < 30; i++) {
    const next = apply(covariance, axis);
    size = Math.hypot(...next);
    axis = next.map((value) => value / (size || 1));
  }
  return Math.sqrt(size);
}

const ROUND = Array.from({ length: 49 }, (_, i) => (i * Math.PI) / 24);
function circle(centre, u, v) {
  return ROUND.map((angle) => add(add(centre, u, Math.cos(angle)), v, Math.sin(angle)));
}

// Two directions across a normal.
function across([x, y, z]) {
  const u = Math.abs(x) < 0.9 ? [0, -z, y] : [z, 0, -x];
  const size = Math.hypot(...u);
  const a = u.map((value) => value / size);
  return [a, [y * a[2] - z * a[1], z * a[0] - x * a[2], x * a[1] - y * a[0]]];
}

// --- what is drawn: {kind, points, isClosed, label} ---

function linesOf({ cameras, boards, depth_mm: depth, robot }, part) {
  const far = depth?.[1] ?? 300;
  const lines = [];
  const draw = (kind, points, isClosed = true, label = "") => lines.push({ kind, points, isClosed, label });
  for (const { side, centre, corners } of cameras) {
    const face = along(centre, corners, 0.12 * far);
    draw("camera body", face, true, t(side));
    for (const corner of face) draw("camera", [centre, corner], false);
  }
  if (depth) {
    const [near, end] = depth.map((mm) => along(cameras[0].centre, cameras[0].corners, mm));
    draw("volume", near);
    draw("volume", end);
    near.forEach((corner, i) => {
      draw("volume", [corner, end[i]], false);
    });
  }
  for (const { used, corners } of boards) draw(used ? "board" : "board unused", corners);
  const base = robot && [0, 1, 2].map((i) => robot[i][3]);
  if (base && Math.hypot(...base) < REACH * far) {
    const axis = (i) => add(base, robot.map((row) => row[i]).slice(0, 3), 0.25 * far);
    for (const i of [0, 1, 2]) draw("robot", [base, axis(i)], false, i ? "" : t("space-robot"));
  }
  if (part) {
    const { position_mm: at, circles, covariance_6x6: covariance, job } = part;
    for (const { centre_mm: centre, normal, radius_mm: radius } of circles) {
      const [u, v] = across(normal).map((side) => side.map((value) => radius * value));
      draw("part", circle(centre, u, v));
    }
    draw("part", [at, at], false, job);
    const root = rootOf(covariance.slice(0, 3).map((row) => row.slice(0, 3)));
    const column = (i) => root.map((row) => row[i] * timesOf(part, far));
    for (const [i, j] of [
      [0, 1],
      [0, 2],
      [1, 2],
    ])
      draw("error", circle(at, column(i), column(j)));
  }
  return lines;
}

const covarianceOf = ({ covariance_6x6: whole }) => whole.slice(0, 3).map((row) => row.slice(0, 3));
// A power of ten, or two or five of them.
function timesOf(part, far) {
  const wanted = (ERROR_SHARE * far) / Math.max(longestOf(covarianceOf(part)), 1e-9);
  const power = 10 ** Math.floor(Math.log10(wanted));
  return power * ([5, 2].find((one) => one * power <= wanted) ?? 1);
}

// --- how it is looked at ---

// Seen from afar: the middle of all but the robot stays in the middle, whatever the turn.
function lens({ yaw, pitch, zoom }, lines) {
  const points = lines.filter(({ kind }) => kind !== "robot").flatMap((line) => line.points);
  const [low, high] = [Math.min, Math.max].map((most) =>
    [0, 1, 2].map((i) => most(...points.map((one) => one[i]))),
  );
  const middle = low.map((value, i) => (value + high[i]) / 2);
  const size = Math.max(Math.hypot(...high.map((value, i) => value - low[i])), 1);
  const [cy, sy, cp, sp] = [Math.cos(yaw), Math.sin(yaw), Math.cos(pitch), Math.sin(pitch)];
  const rows = [
    [cy, 0, -sy],
    [-sp * sy, cp, -sp * cy],
    [cp * sy, sp, cp * cy],
  ];
  const scale = (zoom * SIZE * 2) / size;
  return (point) => {
    const [x, y, z] = apply(rows, add(point, middle, -1));
    const depth = 2 * size + z; // a little perspective shows what is near
    return [x, y].map((value) => SIZE / 2 + (size * value * scale) / depth);
  };
}

// Turned so, and as near as all of it can be seen; the picture grows with the zoom, whatever the turn.
const FILLED = 0.92;
function fitted(turned, lines) {
  const seen = lens({ ...turned, zoom: 1 }, lines);
  const off = lines.flatMap(({ kind, points }) => (kind === "robot" ? [] : points.flatMap(seen)));
  const most = Math.max(...off.map((value) => Math.abs(value - SIZE / 2)), 1);
  return { ...turned, zoom: (FILLED * SIZE) / (2 * most) };
}

function View({ lines }) {
  const svg = useRef(null);
  const fingers = useRef(new Map());
  const [eye, setEye] = useState(() => fitted(FIRST, lines));
  const turn = (yaw, pitch) =>
    setEye((now) => ({
      ...now,
      yaw: now.yaw + yaw,
      pitch: Math.max(-Math.PI / 2, Math.min(Math.PI / 2, now.pitch + pitch)),
    }));
  const zoom = (times) => setEye((now) => ({ ...now, zoom: Math.max(0.2, Math.min(40, now.zoom * times)) }));
  useEffect(() => {
    const element = svg.current;
    const wheel = (event) => {
      event.preventDefault();
      zoom(Math.exp(-event.deltaY / 400));
    };
    element.addEventListener("wheel", wheel, { passive: false });
    return () => element.removeEventListener("wheel", wheel);
  }, []);
  const down = (event) => {
    svg.current.setPointerCapture(event.pointerId);
    fingers.current.set(event.pointerId, event);
  };
  const move = (event) => {
    const before = fingers.current.get(event.pointerId);
    if (!before) return;
    const other = [...fingers.current.entries()].find(([id]) => id !== event.pointerId)?.[1];
    const apart = (one) => Math.hypot(one.clientX - other.clientX, one.clientY - other.clientY);
    if (other) zoom(apart(event) / Math.max(apart(before), 1));
    else turn(-TURN * (event.clientX - before.clientX), TURN * (event.clientY - before.clientY));
    fingers.current.set(event.pointerId, event);
  };
  const up = (event) => fingers.current.delete(event.pointerId);
  const KEYS = {
    ArrowLeft: () => turn(STEP.turn, 0),
    ArrowRight: () => turn(-STEP.turn, 0),
    ArrowUp: () => turn(0, -STEP.turn),
    ArrowDown: () => turn(0, STEP.turn),
    "+": () => zoom(STEP.zoom),
    "=": () => zoom(STEP.zoom),
    "-": () => zoom(1 / STEP.zoom),
    0: () => setEye(fitted(FIRST, lines)),
  };
  const onKey = (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || !KEYS[event.key]) return;
    event.preventDefault();
    KEYS[event.key]();
  };
  const seen = lens(eye, lines);
  return html`<div class="space-tools">
      ${Object.entries(VIEWS).map(
        ([name, view]) => html`<button key=${name} onClick=${() => setEye(fitted(view, lines))}>
          ${t(`space-from-${name}`)}
        </button>`,
      )}
    </div>
    <svg
      class="space" ref=${svg} viewBox="0 0 ${SIZE} ${SIZE}" tabindex="0" role="application"
      aria-label=${t("space-picture")} onPointerDown=${down} onPointerMove=${move} onPointerUp=${up}
      onPointerCancel=${up} onKeyDown=${onKey}
    >
      ${lines.map(({ kind, points, isClosed }, i) => {
        const path = points
          .map((point) =>
            seen(point)
              .map((value) => value.toFixed(1))
              .join(" "),
          )
          .join("L");
        return html`<path key=${i} class=${kind} d="M${path}${isClosed ? "Z" : ""}" />`;
      })}
      ${lines
        .filter(({ label }) => label)
        .map(({ label, points }) => {
          // at the border where what it names is beyond it, and never across it
          const [x, y] = seen(points.at(-1)).map((value) => Math.max(EDGE, Math.min(SIZE - EDGE, value)));
          const isLate = x > LATE * SIZE;
          return html`<text
            key=${label} x=${isLate ? x - 6 : x + 6} y=${y - 6} text-anchor=${isLate ? "end" : "start"}
            translate=${false}
          >
            ${label}
          </text>`;
        })}
    </svg>
    <p class="hint">${t("space-how")}</p>`;
}

export default function Space() {
  const [scene, setScene] = useState(null);
  const [part, setPart] = useState(null);
  useFresh(() => glance(async () => setScene(await ask("GET", "scene"))));
  useEffect(() => {
    const look = async () => {
      if (document.visibilityState !== "visible") return;
      const [target] = (await fetched("/status.json"))?.result?.targets ?? [];
      if (target) setPart(target);
    };
    look();
    const timer = setInterval(look, EVERY_MS);
    return () => clearInterval(timer);
  }, []);
  const head = html`<h1>${t("space-title")}</h1><p class="lead">${t("space-what")}</p>`;
  if (!scene) return head;
  if (!scene.cameras.length) return html`${head}<p><${Shape} is="gap" /> ${t("space-no-rig")}</p>`;
  const { baseline_mm: baseline, boards, depth_mm: depth } = scene;
  const [x, y, z] = (part?.position_mm ?? []).map((value) => number(value, 2));
  return html`${head}
    <${View} lines=${linesOf(scene, part)} />
    ${
      part &&
      html`<p class="hint">
        ${t("space-ellipsoid", { times: number(timesOf(part, depth?.[1] ?? 300)) })}
      </p>`
    }
    <dl class="facts">
      <dt>${t("space-baseline")}</dt><dd translate=${false}>${number(baseline, 1)} mm</dd>
      ${
        depth &&
        html`<dt>${t("space-depth")}</dt>
          <dd>${t("space-depth-mm", { near: number(depth[0]), far: number(depth[1]) })}</dd>`
      }
      <dt>${t("space-boards")}</dt><dd>${number(boards.length)}</dd>
      <dt>${t("space-part")}</dt><dd>${part ? t("space-part-at", { x, y, z }) : t("space-part-none")}</dd>
      ${
        part &&
        html`<dt>${t("space-error")}</dt>
          <dd>
            ${t("space-error-um", { sigma: number(1e3 * longestOf(covarianceOf(part)), 1) })}
          </dd>`
      }
    </dl>`;
}
