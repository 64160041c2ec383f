// A run as rows, one for each target and frame, in pixels of the source: 0-based, from the top-left corner.

/** Yield `{frame, time, seq, size, target, box, ...row}` by rising time; `frame` is null where the source has no numbers. */
export function* rowsOf(run) {
  for (const { frame, time, seq, size, rows } of run.records) {
    for (const [id, row] of [...rows].sort(([a], [b]) => a - b)) {
      yield { ...row, frame, time, seq, size, target: run.targets.get(id) ?? { id, name: String(id), kind: "object" }, box: pixels(row.box, size).map(digits) };
    }
  }
}

/** Return the rows of each target, in the order in which the targets began, as `[target, rows]`. */
export function byTarget(run) {
  const tracks = new Map();
  for (const row of rowsOf(run)) {
    if (!tracks.has(row.target.id)) tracks.set(row.target.id, []);
    tracks.get(row.target.id).push(row);
  }
  return [...tracks.values()].map((rows) => [rows[0].target, rows]);
}

/** A number with ten digits: more are noise of the fractions that the page keeps. */
export const digits = (value) => Number(value.toPrecision(10));

export const pixels = ([x, y, w, h], [width, height]) => [x * width, y * height, w * width, h * height];

/** Return the visible part of a row's box, null while the target is lost or out of the picture. */
export function seen({ status, box: [x, y, w, h], size: [width, height] }) {
  const [left, top, right, bottom] = [Math.max(x, 0), Math.max(y, 0), Math.min(x + w, width), Math.min(y + h, height)];
  return status !== "lost" && right > left && bottom > top ? [left, top, right - left, bottom - top] : null;
}

/** Return the number of a row's frame: of the source, else of the record. */
export function numbers(run) {
  const places = new Map(run.records.map(({ time }, i) => [time, i]));
  return ({ frame, time }) => frame ?? places.get(time);
}

/** The file name of a frame: of an image, or of one cut from the video. */
export function imageName({ name, names }, frame) {
  return names?.[frame] ?? `${stem(name)}_${String(frame).padStart(6, "0")}.jpg`;
}

export const stem = (name) => name.replace(/\.[^.]*$/, "") || name;
