// Export boxes as a file, in pixels of the source: 0-based, from the top-left corner.

const COLUMNS = ["frame", "time_s", "target", "x", "y", "w", "h", "status", "reliable", "fused", "template", "statistical", "psr", "scale", "confidence"];

/** CSV of the history's `frames`. */
export function toCsv(frames) {
  const lines = frames.flatMap(({ seq, time, size, rows }) =>
    rows.map(({ target, box, status, reliable, scores, psr, scale, confidence }) => {
      const { fused, template, statistical } = scores ?? {};
      const cells = [seq, seconds(time), target, ...pixels(box, size), status, reliable, fused, template, statistical, psr, scale, confidence];
      return cells.map(cell).join(",");
    }),
  );
  return [COLUMNS.join(","), ...lines, ""].join("\n");
}

/** JSON of the history's `frames`; `source` is the name of the source. */
export function toJson(frames, source) {
  const told = frames.map(({ seq, time, size, rows }) => ({
    frame: seq,
    time_s: seconds(time),
    size,
    targets: rows.map(({ target, box, ...rest }) => ({ target, box: pixels(box, size), ...rest })),
  }));
  return `${JSON.stringify({ source, frames: told }, null, 1)}\n`;
}

const seconds = (time) => Math.round(time * 1e4) / 1e4;
const pixels = ([x, y, w, h], [width, height]) => [x * width, y * height, w * width, h * height].map((v) => Math.round(v * 100) / 100);
const cell = (value) => (typeof value === "number" && !Number.isInteger(value) ? Number(value.toFixed(4)) : (value ?? ""));
