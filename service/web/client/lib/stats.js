/** Counts what a stream does, and says how many frames it may have in flight. */

const REMEMBERED = 120;
const RATE_OVER_MS = 2000;
const WINDOW_OVER = 16;
const WINDOW_GAIN = 1.25;
const MIN_WINDOW = 2;

export class Stats {
  sent = 0;
  answered = 0;
  dropped = 0;
  skipped = 0;
  refused = 0;
  bytesSent = 0;
  bytesSaved = 0;
  encodeMs = null;
  reconnects = 0;
  #answers = []; // {at, latencyMs}, the newest last

  /** Count a result for a frame that was taken at `takenAt`; null where a break makes the time meaningless. */
  answer(takenAt, dropped) {
    const at = performance.now();
    this.answered += 1;
    this.dropped += dropped;
    if (takenAt === null) return;
    this.#answers.push({ at, latencyMs: at - takenAt });
    if (this.#answers.length > REMEMBERED) this.#answers.shift();
  }

  /**
   * How many frames are worth having in flight: as many as are answered within the least latency seen lately (Little's
   * law), and one more. Further frames would only wait in buffers on the way, which a browser cannot see.
   */
  get window() {
    const recent = this.#answers.slice(-WINDOW_OVER);
    if (recent.length < 2) return MIN_WINDOW;
    const perMs = (recent.length - 1) / Math.max(1, recent.at(-1).at - recent[0].at);
    const least = Math.min(...this.#answers.map(({ latencyMs }) => latencyMs));
    return Math.max(MIN_WINDOW, Math.ceil(WINDOW_GAIN * perMs * least) + 1);
  }

  copy(inFlight) {
    const { sent, answered, dropped, skipped, refused, bytesSent, encodeMs, reconnects } = this;
    const sorted = this.#answers.map(({ latencyMs }) => latencyMs).sort((a, b) => a - b);
    const quantile = (share) => sorted[Math.round(share * (sorted.length - 1))] ?? null;
    const now = performance.now();
    const recent = this.#answers.filter(({ at }) => at > now - RATE_OVER_MS);
    return {
      sent,
      answered,
      dropped,
      skipped,
      refused,
      inFlight,
      bytesSent,
      bytesSaved: Math.round(this.bytesSaved),
      latencyMs: this.#answers.at(-1)?.latencyMs ?? null,
      latencyP50Ms: quantile(0.5),
      latencyP95Ms: quantile(0.95),
      rate: recent.length < 2 ? 0 : ((recent.length - 1) * 1000) / (now - recent[0].at),
      encodeMs,
      reconnects,
    };
  }
}
