// Draws boxes and trails over a picture, on the page and in a recording. Color and line style show the status.

const COLOURS = { tracking: "#3ddc97", uncertain: "#ffb547", lost: "#ff7a6e" };
const DASHES = { tracking: [], uncertain: [9, 5], lost: [3, 5] };
const WORDS = { tracking: "", uncertain: " uncertain", lost: " lost" };
const TRAIL = 90;

/**
 * Draw `scene` into `rect` (where the picture is, in units of the context); `unit` is the width of a hairline.
 * Scene: `targets` of the history, `chosen` (an id), `trail`, `draft` and `suggestion` (boxes or null).
 */
export function paint(context, rect, scene, unit = 1) {
  context.lineJoin = "round";
  context.lineCap = "round";
  for (const target of scene.targets) {
    const colour = COLOURS[target.status];
    if (scene.trail) drawTrail(context, rect, target.trail, colour, unit);
    drawBox(context, place(target.box, rect), colour, DASHES[target.status], target.id === scene.chosen ? 2.5 : 1.75, unit);
    drawLabel(context, place(target.box, rect), rect, `${target.id}${WORDS[target.status]}${percent(target.confidence)}`, colour, unit);
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

function drawLabel(context, [x, y, , h], rect, text, colour, unit) {
  context.font = `600 ${12 * unit}px ui-monospace, "DejaVu Sans Mono", monospace`;
  context.textBaseline = "middle";
  const [width, height] = [context.measureText(text).width + 10 * unit, 18 * unit];
  const above = y - height - 3 * unit;
  const top = above >= rect.y ? above : Math.min(y + h + 3 * unit, rect.y + rect.h - height);
  const left = Math.min(Math.max(x - unit, rect.x), rect.x + rect.w - width);
  context.fillStyle = colour;
  context.beginPath();
  context.roundRect(left, top, width, height, 3 * unit);
  context.fill();
  context.fillStyle = "#06150f";
  context.fillText(text, left + 5 * unit, top + height / 2 + 0.5 * unit);
}

function drawTrail(context, rect, points, colour, unit) {
  const shown = points.slice(-TRAIL);
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
