// Reads a run back: our own JSON, or the boxes of a MOT or OTB file, such as a ground truth.

import { FORM } from "./exports/json.js";
import { SourceError } from "./sources/source.js";

/** Fill `run` with the results of a file for the source that is open. Throws a SourceError if it does not fit. */
export async function read(file, run, source) {
  const text = await file.text();
  try {
    if (/^\s*\{/.test(text)) ownForm(JSON.parse(text), run, source);
    else lines(text, run, source);
  } catch (error) {
    throw error instanceof SourceError ? error : new SourceError("import-unreadable", error);
  }
  if (!run.records.length) throw new SourceError("import-unreadable");
  run.saved = true;
  run.title = file.name;
}

function ownForm({ form, targets, keyframes, frames }, run, source) {
  if (form !== FORM) throw new SourceError("import-unreadable");
  for (const { id, name, class: kind, removed_at_s: until } of targets) {
    run.add({ id, name, kind });
    if (until !== null) run.change(id, { until });
  }
  for (const { frame, seq, time_s: time, size, targets: rows } of frames) {
    const told = rows.map(({ target, box, ...rest }) => [target, { ...rest, box: shares(box, size) }]);
    run.put({ frame, seq, size, time: exact(source, frame, time), rows: new Map(told) });
  }
  const known = new Map(frames.map(({ frame, time_s: time }) => [time, exact(source, frame, time)]));
  for (const { time_s: time, target, box } of keyframes) run.mark(known.get(time) ?? time, target, shares(box, source.size));
}

/**
 * Lines `frame,id,x,y,w,h,conf,…` of MOT, or `x,y,w,h` of OTB, one for each frame; both count from 1. OTB has `NaN` or a
 * box without a size where the target is not in the picture.
 */
function lines(text, run, source) {
  const { size, count, fps } = source;
  const all = text.split(/\r?\n/).map((line) => line.trim()).filter(Boolean).map((line) => line.split(/[,\s]+/).map(Number));
  const otb = all.every(({ length }) => length === 4);
  const known = otb ? all.map((box, i) => [i + 1, 1, ...box]).filter(([, , ...box]) => !box.some(Number.isNaN) && box[2] > 0 && box[3] > 0) : all;
  for (const [frame, id, x, y, w, h, confidence] of known) {
    if (![frame, id, x, y, w, h].every(Number.isFinite) || frame < 1 || id < 0 || (count !== null && frame > count)) throw new SourceError("import-unreadable");
    if (!run.targets.has(id)) run.add({ id });
    const time = exact(source, frame - 1, (frame - 1) / fps);
    const row = { status: "tracking", reliable: null, flags: null, scores: null, psr: null, updated: false, scale: 1, confidence: Number.isFinite(confidence) && confidence >= 0 ? confidence : 1 };
    if (run.end(id) === -Infinity) run.mark(time, id, shares([x - 1, y - 1, w, h], size));
    run.put({ time, frame: frame - 1, seq: frame - 1, size, rows: new Map([[id, { ...row, box: shares([x - 1, y - 1, w, h], size) }]]) });
  }
}

/** The source's own time of a frame, which files round. */
const exact = (source, frame, time) => source.times?.[frame] ?? time;
const shares = ([x, y, w, h], [width, height]) => [x / width, y / height, w / width, h / height];
