// Draws boxes and trails over a picture, on the page and in a recording. Color and line style show the status.

import { HANDLES } from "./boxes.js";

const COLOURS = { tracking: "#3ddc97", uncertain: "#ffb547", lost: "#ff7a6e" };
const DASHES = { tracking: [], uncertain: [9, 5], lost: [3, 5] };
const WORDS = { tracking: "", uncertain: " uncertain", lost: " lost" };
const IDENTITIES = ["#4cc9f0", "#f72585", "#ffd166", "#b388ff", "#80ed99", "#ff9f6e", "#5390d9", "#e0aaff"];
const OTHER = "#c9b6ff"; // boxes of the run that is compared with

/** The colour that tells a target from others, whatever its status. */
export const identity = (id) => IDENTITIES[(id - 1) % IDENTITIES.length];

/**
 * Draw `scene` into `rect` (where the picture is, in units of the context); `unit` is the width of a hairline.
 * Scene: `targets` (rows with `id`, `name` and `trail`), `chosen` (an id), `other` (rows of another run), `handles` (whether
 * the chosen box has them), `draft` and `suggestion` (boxes or null).
 */
export function paint(context, rect, scene, unit = 1) {
  context.lineJoin = "round";
  context.lineCap = "round";
  for (const { box, name } of scene.other) {
    drawBox(context, place(box, rect), OTHER, [2, 4], 1.5, unit);
    drawLabel(context, place(box, rect), rect, { text: `${name} other run`, colour: OTHER, below: true }, unit);
  }
  for (const target of scene.targets) {
    const colour = COLOURS[target.status];
    drawTrail(context, rect, target.trail, colour, unit);
    drawBox(context, place(target.box, rect), colour, DASHES[target.status], target.id === scene.chosen ? 2.5 : 1.75, unit);
    if (scene.handles && target.id === scene.chosen) drawHandles(context, place(target.box, rect), colour, unit);
    const text = `${target.name}${WORDS[target.status]}${percent(target.confidence)}`;
    drawLabel(context, place(target.box, rect), rect, { text, colour, tag: identity(target.id) }, unit);
  }
  if (scene.suggestion) drawBox(context, place(scene.suggestion, rect), "#ffffff", [5, 5], 1.75, unit);
  if (scene.draft) drawDraft(context, place(scene.draft, rect), rect, unit);
}

const percent = (confidence) => (confidence == null ? "" : ` ${Math.round(100 * confidence)}%`);

export const place = ([x, y, w, h], rect) => [rect.x + x * rect.w, rect.y + y * rect.h, w * rect.w, h * rect.h];

function drawBox(context, [x, y, w, h], colour, dash, width, unit) {
  context.setLineDash([]);
  context.strokeStyle = "rgb(0 0 0 / 45%)"; // a dark seam, so that the line is seen on any picture
  context.lineWidth = (width + 2) * unit;
  context.strokeRect(x, y, w, h);
  context.setLineDash(dash.map((length) => length * unit));
  context.strokeStyle = colour;
  context.lineWidth = width * unit;
  context.strokeRect(x, y, w, h);
  context.setLineDash([]);
}

function drawHandles(context, [x, y, w, h], colour, unit) {
  context.fillStyle = colour;
  context.strokeStyle = "#06150f";
  context.lineWidth = unit;
  for (const handle of Math.min(w, h) < 28 * unit ? HANDLES.slice(0, 4) : HANDLES) {
    const [left, top] = [x + handle.x * w - 3 * unit, y + handle.y * h - 3 * unit];
    context.fillRect(left, top, 6 * unit, 6 * unit);
    context.strokeRect(left, top, 6 * unit, 6 * unit);
  }
}

/** Draw a label above a box, or below where there is no room; `tag` is a colour that tells targets apart. */
function drawLabel(context, [x, y, , h], rect, { text, colour, tag = null, below = false }, unit) {
  context.font = `600 ${12 * unit}px ui-monospace, "DejaVu Sans Mono", monospace`;
  context.textBaseline = "middle";
  const room = tag ? 10 * unit : 0;
  const [width, height] = [context.measureText(text).width + 10 * unit + room, 18 * unit];
  const above = y - height - 5 * unit;
  const top = above >= rect.y && !below ? above : Math.min(y + h + 5 * unit, rect.y + rect.h - height);
  const left = Math.min(Math.max(x - unit, rect.x), rect.x + rect.w - width);
  context.fillStyle = colour;
  context.beginPath();
  context.roundRect(left, top, width, height, 3 * unit);
  context.fill();
  context.fillStyle = "#06150f";
  context.fillText(text, left + 5 * unit + room, top + height / 2 + 0.5 * unit);
  if (!tag) return;
  context.fillRect(left + 4 * unit, top + 5 * unit, 8 * unit, 8 * unit);
  context.fillStyle = tag;
  context.fillRect(left + 5 * unit, top + 6 * unit, 6 * unit, 6 * unit);
}

function drawTrail(context, rect, shown, colour, unit) {
  context.strokeStyle = colour;
  context.lineWidth = 2 * unit;
  for (let i = 1; i < shown.length; i++) {
    context.globalAlpha = (0.85 * i) / shown.length;
    context.beginPath();
    context.moveTo(rect.x + shown[i - 1][0] * rect.w, rect.y + shown[i - 1][1] * rect.h);
    context.lineTo(rect.x + shown[i][0] * rect.w, rect.y + shown[i][1] * rect.h);
    context.stroke();
  }
  context.globalAlpha = 1;
}

function drawDraft(context, [x, y, w, h], rect, unit) {
  context.fillStyle = "rgb(0 0 0 / 38%)";
  context.beginPath();
  context.rect(rect.x, rect.y, rect.w, rect.h);
  context.rect(x, y, w, h);
  context.fill("evenodd");
  drawBox(context, [x, y, w, h], "#ffffff", [], 1.75, unit);
}
