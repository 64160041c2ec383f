// Thinned paths, as editors of video annotations want them: keyframes, and from where on the target is away.

import { seen } from "./rows.js";

/**
 * Yield `{frame, box, present}`: from its frame on the target is in the box, or away. Between two with it the box moves
 * on a line, and misses no edge of a row's box by more than `tolerance` pixels. `number(row)` is a row's frame.
 */
export function* points(rows, number, tolerance) {
  let stretch = [];
  for (const row of rows) {
    const box = seen(row);
    if (box) {
      stretch.push({ frame: number(row), box, present: true });
    } else if (stretch.length) {
      yield* thinned(stretch, tolerance);
      yield { frame: number(row), box: stretch.at(-1).box, present: false };
      stretch = [];
    }
  }
  yield* thinned(stretch, tolerance);
}

/** Keep the first and the last of `stretch`, and of the others the worst ones until lines between them fit. */
function thinned(stretch, tolerance) {
  const kept = new Set([0, stretch.length - 1]);
  const spans = [[0, stretch.length - 1]];
  const edges = stretch.map(({ box: [x, y, w, h] }) => [x, y, x + w, y + h]);
  while (spans.length) {
    const [first, last] = spans.pop();
    let [worst, far] = [-1, tolerance];
    for (let i = first + 1; i < last; i++) {
      const share = (stretch[i].frame - stretch[first].frame) / (stretch[last].frame - stretch[first].frame);
      const off = Math.max(...edges[i].map((edge, k) => Math.abs(edge - (edges[first][k] + share * (edges[last][k] - edges[first][k])))));
      if (off > far) [worst, far] = [i, off];
    }
    if (worst < 0) continue;
    kept.add(worst);
    spans.push([first, worst], [worst, last]);
  }
  return stretch.filter((_, i) => kept.has(i));
}
