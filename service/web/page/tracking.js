// One run: a session, its stream, and the map from its targets to the page's numbers.

import { Client } from "/static/client/mfcmt.js";

const KEY = "mfcmt.key";
const IDLE_S = 120; // a page that vanished does not keep its place for long
const WAIT_MS = 5000; // for a lane or a place

/** The API key of this tab, if there is one. */
export const key = {
  get: () => sessionStorage.getItem(KEY) ?? undefined,
  set: (value) => sessionStorage.setItem(KEY, value),
  forget: () => sessionStorage.removeItem(KEY),
};

/**
 * Calls `onresult(result, ids, frame)`, `onstatus(change)`, `onproblem(error)`, `onend(error)`, and `onspare(frame)` for
 * frames, `{canvas, time}`, that may be reused. `number()` returns a number for a new target.
 */
export class Tracking {
  #ids = new Map();
  #frames = new Map();
  #sent = 0;
  #ended = false;

  constructor(handlers) {
    Object.assign(this, handlers);
  }

  /** Start on `frame` with `boxes` (pixels of it), numbered `ids` on the page. */
  async start(frame, boxes, ids, { mode, quality, regions, maps, preset, label }) {
    this.client = new Client({ key: key.get() });
    // so that a phone may be rotated
    const options = { preset, maps, on_resize: "rescale", label: label.slice(0, 200), idle_timeout_s: IDLE_S };
    this.session = await this.client.createSession({ frame: frame.canvas, boxes, options, quality, waitMs: WAIT_MS });
    if (this.#ended) {
      this.session.close().catch(() => {});
      return;
    }
    const { seq, size, targets } = this.session.info;
    targets.forEach((target, i) => this.#ids.set(target.id, ids[i]));
    this.onresult({ seq, size, targets, timing: null }, ids, frame);
    this.onspare(frame);
    this.attach({ mode, quality, regions });
  }

  /** Stream in `mode` from now on. */
  attach({ mode, quality, regions }) {
    this.stream?.close();
    this.#frames.clear();
    const takeover = Boolean(this.stream); // of the attachment that was just closed
    const stream = this.session.stream({ mode, quality, regions, takeover });
    this.stream = stream;
    stream.on("status", (change) => this.stream === stream && !this.#ended && this.onstatus(change));
    stream.on("problem", (error) => this.stream === stream && !this.#ended && this.onproblem(error));
    this.#listen(stream);
  }

  get mode() {
    return this.stream?.mode;
  }

  /** Whether a frame could be sent now. */
  get open() {
    return Boolean(this.stream?.canSend);
  }

  /** Send a frame. Resolves when the next one may be sent. */
  async send(frame, options = {}) {
    const { stream } = this;
    const ts = ++this.#sent;
    this.#frames.set(ts, frame);
    try {
      const seq = await stream.send(frame.canvas, { ts, ...options });
      if (seq === null) this.#release(ts);
    } catch (error) {
      this.#release(ts);
      if (this.stream === stream && !this.#ended) this.onproblem(error);
    }
  }

  /** Add a target on this frame, or correct `target` (the page's number). */
  async place(frame, box, target = null) {
    const { stream } = this;
    await stream.ready;
    const onNext = { onNext: true };
    const answer = target === null ? stream.add(box, onNext) : stream.correct(this.#server(target), box, onNext);
    answer.catch(() => {}); // until it is awaited below
    await this.send(frame, { whole: true });
    return answer;
  }

  remove(target) {
    return this.stream.remove(this.#server(target));
  }

  /** The page's numbers for these targets. */
  numbered(targets) {
    return targets.map(({ id }) => {
      if (!this.#ids.has(id)) this.#ids.set(id, this.number());
      return this.#ids.get(id);
    });
  }

  /** End the run and its session. */
  stop() {
    if (this.#ended) return;
    this.#ended = true;
    this.stream?.close();
    this.session?.close().catch(() => {});
  }

  /** End the session while the page is being closed. */
  abandon() {
    if (!this.session || this.#ended) return;
    const last = new Client({ key: key.get(), fetch: (url, options) => fetch(url, { ...options, keepalive: true }) });
    last.deleteSession(this.session.id).catch(() => {});
  }

  async #listen(stream) {
    try {
      for await (const result of stream) {
        if (this.stream !== stream || this.#ended) return;
        this.onresult(result, this.numbered(result.targets), this.#frames.get(result.ts));
        for (const ts of this.#frames.keys()) if (ts <= result.ts) this.#release(ts);
      }
    } catch (error) {
      if (this.stream === stream && !this.#ended) this.onend(error);
    }
  }

  #server(target) {
    for (const [id, number] of this.#ids) if (number === target) return id;
    return -1;
  }

  #release(ts) {
    const frame = this.#frames.get(ts);
    if (this.#frames.delete(ts)) this.onspare(frame);
  }
}
