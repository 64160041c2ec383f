// Compares two runs of one source: how far the boxes of targets with the same number agree.

const HALF = 0.5;
/** The overlaps from which a box may count as a success, as in OTB's plots. */
export const THRESHOLDS = [...Array(21).keys()].map((i) => i / 20);

/**
 * `{count, iou, half, curve, auc}`: how many boxes both runs have, their mean overlap, the share above half, the share
 * above each of THRESHOLDS, and the mean of these shares, the area under the curve.
 */
export function agreement(run, other) {
  const overlaps = [];
  for (const { time, rows } of run.records) {
    const theirs = other.record(time)?.rows;
    if (!theirs) continue;
    for (const [id, { box }] of rows) if (theirs.has(id)) overlaps.push(iou(box, theirs.get(id).box));
  }
  const above = (least) => share(overlaps.filter((overlap) => overlap > least).length, overlaps.length);
  const curve = THRESHOLDS.map(above);
  return { count: overlaps.length, iou: share(sum(overlaps), overlaps.length), half: above(HALF), curve, auc: sum(curve) / curve.length };
}

const sum = (values) => values.reduce((total, value) => total + value, 0);
const share = (part, whole) => (whole ? part / whole : 0);

/** Intersection over union of two boxes. */
export function iou([ax, ay, aw, ah], [bx, by, bw, bh]) {
  const w = Math.min(ax + aw, bx + bw) - Math.max(ax, bx);
  const h = Math.min(ay + ah, by + bh) - Math.max(ay, by);
  const shared = Math.max(w, 0) * Math.max(h, 0);
  return shared / (aw * ah + bw * bh - shared);
}
