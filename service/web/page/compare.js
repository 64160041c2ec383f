// Compares two runs of one source: how far the boxes of targets with the same number agree.

const HALF = 0.5;

/** `{frames, iou, success}`: on how many frames both have a target, the mean overlap, and the share above half. */
export function agreement(run, other) {
  let [count, sum, good] = [0, 0, 0];
  for (const { time, rows } of run.records) {
    const theirs = other.record(time)?.rows;
    if (!theirs) continue;
    for (const [id, { box }] of rows) {
      if (!theirs.has(id)) continue;
      const overlap = iou(box, theirs.get(id).box);
      count++;
      sum += overlap;
      good += overlap > HALF ? 1 : 0;
    }
  }
  return { frames: count, iou: count ? sum / count : 0, success: count ? good / count : 0 };
}

/** Intersection over union of two boxes. */
export function iou([ax, ay, aw, ah], [bx, by, bw, bh]) {
  const w = Math.min(ax + aw, bx + bw) - Math.max(ax, bx);
  const h = Math.min(ay + ah, by + bh) - Math.max(ay, by);
  const shared = Math.max(w, 0) * Math.max(h, 0);
  return shared / (aw * ah + bw * bh - shared);
}
