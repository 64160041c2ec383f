// Fits what a stream in Latest sends to the uplink: where it is narrow, first coarser pictures, then smaller ones.

const WANTED = 12; // results a second
const PLENTY = 20; // from there on better pictures are tried again
const LOOK_MS = 1500;
const SLOW_MS = 120; // what a frame spends on the line where the line is to blame
const PATIENCE_MS = 15_000; // before better pictures are tried; doubled whenever that was in vain
const MOST_PATIENCE_MS = 240_000;
const LEAST_SIDE = 240;
/** Shares of the quality and of the longer side. Another size starts the targets anew, so it changes last. */
const LEVELS = [[1, 1], [0.75, 1], [0.5, 1], [0.5, 0.7], [0.4, 0.5], [0.4, 0.35]];

export class Uplink {
  level = 0;
  #stream = null;
  #quality = 1;
  #side = 0;
  #since = 0;
  #changedAt = -Infinity;
  #raisedAt = -Infinity;
  #resized = false; // once it was, the size must always be said
  #patience = PATIENCE_MS;
  #waits = []; // on the line, of the results since the last look, in milliseconds
  #skipped = 0;

  /** `quality` and `side` are what is sent on a wide line; `side` is the longer one of the frames. */
  attach(stream, quality, side) {
    this.#stream = stream;
    this.#side = side;
    this.#begin();
    this.set(quality);
  }

  set(quality) {
    this.#quality = quality;
    this.#apply();
  }

  /** Note that a frame was left out, because the ones before are still on their way. */
  skip() {
    this.#skipped++;
  }

  /** Note a result of which the service says `timing`, and look whether the pictures should be others. */
  note(timing) {
    const { latencyMs, encodeMs } = this.#stream.stats;
    if (!timing || latencyMs === null) return;
    const served = timing.queue_ms + timing.decode_ms + timing.track_ms;
    this.#waits.push(latencyMs - served - (encodeMs ?? 0));
    const now = performance.now();
    const lasted = now - this.#since;
    if (lasted < LOOK_MS) return;
    const rate = (1000 * this.#waits.length) / lasted;
    const slow = middle(this.#waits) > SLOW_MS && this.#skipped > 0;
    if (slow && rate < WANTED) this.#go(this.level + (rate < WANTED / 2 ? 2 : 1), now);
    else if (!slow && rate > PLENTY && now - this.#changedAt > this.#patience) this.#go(this.level - 1, now);
    this.#begin();
  }

  #go(level, now) {
    const next = Math.min(Math.max(level, 0), LEVELS.length - 1);
    if (next === this.level) return;
    if (next < this.level) this.#raisedAt = now;
    else if (now - this.#raisedAt < this.#patience) this.#patience = Math.min(2 * this.#patience, MOST_PATIENCE_MS);
    this.level = next;
    this.#changedAt = now;
    this.#apply();
  }

  #apply() {
    const [quality, side] = LEVELS[this.level];
    const longer = Math.max(Math.round(this.#side * side), Math.min(this.#side, LEAST_SIDE));
    this.#resized ||= longer < this.#side;
    Object.assign(this.#stream, { quality: this.#quality * quality, maxSide: this.#resized ? longer : null });
  }

  #begin() {
    this.#since = performance.now();
    this.#waits = [];
    this.#skipped = 0;
  }
}

const middle = (values) => [...values].sort((a, b) => a - b)[values.length >> 1];
