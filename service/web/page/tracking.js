// One run of tracking: a session, its stream, and which of its targets is which of the page's.

import { Client } from "/static/client/mfcmt.js";

const KEY = "mfcmt.key";
const IDLE_S = 120; // a page that vanished does not keep its place for long
const WAIT_MS = 5000; // for a lane or a place

/** The key for this tab, if one was needed. */
export const key = {
  get: () => sessionStorage.getItem(KEY) ?? undefined,
  set: (value) => sessionStorage.setItem(KEY, value),
  forget: () => sessionStorage.removeItem(KEY),
};

/**
 * What comes of it: `onresult(result, ids, frame)`, `onstatus(change)`, `onproblem(error)`, `onend(error)`, and
 * `onspare(frame)` for frames, `{canvas, time}`, that are done with. `number()` gives a target that is new to the
 * page its number.
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
    // a phone that is turned goes on, too
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

  /** Stream from now on in `mode`. */
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

  /** Whether a frame would go out now. */
  get open() {
    return Boolean(this.stream?.canSend);
  }

  /** Send a grabbed frame; resolves when the next may be sent. */
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

  /** A box on this very frame: a new target, or `target` (the page's number) put right. */
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

  /** The page's numbers of these targets. */
  numbered(targets) {
    return targets.map(({ id }) => {
      if (!this.#ids.has(id)) this.#ids.set(id, this.number());
      return this.#ids.get(id);
    });
  }

  /** End it, the session too. */
  stop() {
    if (this.#ended) return;
    this.#ended = true;
    this.stream?.close();
    this.session?.close().catch(() => {});
  }

  /** End the session while the page goes away. */
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
