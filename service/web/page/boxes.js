// Boxes as fractions of the frame: how a drag or a key changes one.

const MOVE = 0.02; // of the frame, for a press of an arrow
const LEAST = 0.01;
const fit = (value, least, most) => Math.min(Math.max(value, least), most);

/** The handles of a box: where each is on it, and the pointer over it. */
export const HANDLES = [
  { x: 0, y: 0, cursor: "nwse-resize" },
  { x: 1, y: 1, cursor: "nwse-resize" },
  { x: 1, y: 0, cursor: "nesw-resize" },
  { x: 0, y: 1, cursor: "nesw-resize" },
  { x: 0.5, y: 0, cursor: "ns-resize" },
  { x: 0.5, y: 1, cursor: "ns-resize" },
  { x: 0, y: 0.5, cursor: "ew-resize" },
  { x: 1, y: 0.5, cursor: "ew-resize" },
];

/** Return `box` as it is seen in a mirror. */
export const mirrored = ([x, y, w, h]) => [1 - x - w, y, w, h];

export const between = ([ax, ay], [bx, by]) => [Math.min(ax, bx), Math.min(ay, by), Math.abs(ax - bx), Math.abs(ay - by)];

/** Return `box` moved by `[dx, dy]`, inside the frame. */
export const moved = ([x, y, w, h], [dx, dy]) => [fit(x + dx, 0, Math.max(0, 1 - w)), fit(y + dy, 0, Math.max(0, 1 - h)), w, h];

/** Return `box` with its `handle` moved by `[dx, dy]`. */
export function resized([x, y, w, h], handle, [dx, dy]) {
  const left = handle.x === 0 ? x + dx : x;
  const right = handle.x === 1 ? x + w + dx : x + w;
  const top = handle.y === 0 ? y + dy : y;
  const bottom = handle.y === 1 ? y + h + dy : y + h;
  return between([fit(left, 0, 1), fit(top, 0, 1)], [fit(right, 0, 1), fit(bottom, 0, 1)]);
}

/** Return `box` changed by an arrow key: moved, with Shift resized; with Alt by `fine`, a pixel. */
export function nudged(box, { key, shiftKey, altKey }, fine) {
  const by = altKey ? fine : MOVE;
  const across = key === "ArrowRight" ? by : key === "ArrowLeft" ? -by : 0;
  const down = key === "ArrowDown" ? by : key === "ArrowUp" ? -by : 0;
  if (!shiftKey) return moved(box, [across, down]);
  const [x, y, w, h] = box;
  return [x, y, fit(w + across, LEAST, 1 - x), fit(h + down, LEAST, 1 - y)];
}
