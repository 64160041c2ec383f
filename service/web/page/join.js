// Joins what was tracked from both ends of a stretch, as `join` of mfcmt_core/interpolate.py does.

import { iou } from "./compare.js";

// As in mfcmt_core/interpolate.py, which says where they are from.
const AGREE = 0.3;
const [DISTANCE, CONFIDENCE, CHANGE] = [0.5, 2, 5];
const LEAST = 1e-3;

/**
 * Return the row of each frame between two boxes that were set. `ahead` and `back` are the rows that were tracked forward
 * and backward; `shares` tell where each frame lies between the two, 0 to 1. Where both agree the box is their mean,
 * weighted by confidence and nearness; elsewhere the more credible way is taken, and left where the two come closest.
 */
export function join(ahead, back, shares) {
  if (!ahead.length) return [];
  const both = ahead.map((row, i) => [row, back[i]]);
  const sure = both.map((pair) => pair.map(({ confidence }) => clipped(confidence ?? 1)));
  const near = shares.map((share) => [clipped(1 - share), clipped(share)]);
  const overlaps = both.map(([one, other]) => clipped(iou(one.box, other.box)));
  const costs = sure.map((pair, i) => pair.map((value, side) => -Math.log(value ** CONFIDENCE * near[i][side] ** DISTANCE)));
  const way = cheapest(costs, overlaps.map((overlap) => -CHANGE * Math.log(overlap)));
  return both.map((pair, i) => {
    if (overlaps[i] <= AGREE) return pair[way[i]];
    const [one, other] = [0, 1].map((side) => sure[i][side] * near[i][side]);
    const mean = (a, b) => (one * a + other * b) / (one + other);
    const box = pair[0].box.map((value, k) => mean(value, pair[1].box[k]));
    return { ...pair[other > one ? 1 : 0], box, confidence: mean(...sure[i]) };
  });
}

/** The cheapest way, 0 or 1 for each frame, that begins at 0 and ends at 1; `changes` is what going over costs. */
function cheapest(costs, changes) {
  let best = [costs[0][0], costs[0][1] + changes[0]];
  const came = [[0, 1]];
  for (let i = 1; i < costs.length; i++) {
    const over = [best[1] + changes[i], best[0] + changes[i]];
    came.push([0, 1].map((side) => (over[side] < best[side] ? 1 - side : side)));
    best = [0, 1].map((side) => Math.min(best[side], over[side]) + costs[i][side]);
  }
  const way = [];
  let side = best[1] <= best[0] ? 1 : 0;
  for (let i = costs.length - 1; i >= 0; i--) {
    way[i] = side;
    side = came[i][side];
  }
  return way;
}

const clipped = (value) => Math.min(Math.max(value, LEAST), 1);
