// Our own form: everything that the page knows of a run; it can be imported again.

import { micro } from "./lines.js";
import { digits, pixels } from "./rows.js";

export const FORM = "mfcmt-run";

export function json(run) {
  const { source, options, targets, marks, records } = run;
  const told = {
    form: FORM,
    version: 1,
    source: source.name,
    about: { kind: source.kind, fps: source.fps, frames: source.count ?? null, duration_s: Number.isFinite(source.duration) ? source.duration : null, size: source.size },
    options,
    tracked: { frames: records.length, of: source.count ?? null },
    targets: [...targets.values()].map(({ id, name, kind, until }) => ({ id, name, class: kind, removed_at_s: until === Infinity ? null : micro(until) })),
    keyframes: marks.map(({ time, target, box }) => ({ time_s: micro(time), target, box: rounded(pixels(box, source.size)) })),
    frames: records.map(({ frame, seq, time, size, rows }) => ({
      frame,
      seq,
      time_s: micro(time),
      size,
      targets: [...rows].map(([target, { box, ...rest }]) => ({ target, box: rounded(pixels(box, size)), ...rest })),
    })),
  };
  return `${JSON.stringify(told, null, 1)}\n`;
}

const rounded = (box) => box.map(digits);
