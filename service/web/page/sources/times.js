// Looks up times in rising lists.

/** Return the index of the last of the rising `times` that is not after `time`; the first one's where there is none. */
export function at(times, time) {
  let [low, high] = [0, times.length - 1];
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (times[middle] <= time + 1e-6) low = middle;
    else high = middle - 1;
  }
  return low;
}

/** Return the index of the one of the rising `times` that is nearest to `time`. */
export function nearest(times, time) {
  const low = at(times, time);
  const next = Math.min(low + 1, times.length - 1);
  return Math.abs(times[next] - time) < Math.abs(times[low] - time) ? next : low;
}
