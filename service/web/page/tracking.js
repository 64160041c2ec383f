// One run of tracking: a session, its stream, and which of its targets is which of the page's.

import { Client } from "/static/client/mfcmt.js";

const KEY = "mfcmt.key";
const IDLE_S = 120; // a page that vanished does not keep its place for long

/** The key for this tab, if one was needed. */
export const key = {
  get: () => sessionStorage.getItem(KEY) ?? undefined,
  set: (value) => sessionStorage.setItem(KEY, value),
  forget: () => sessionStorage.removeItem(KEY),
};

/**
 * `onresult(result, ids, slot)`, `onstatus(change)`, `onproblem(error)`, `onend(error)`: what comes of it.
 * A slot is a frame that was grabbed, `{canvas, time}`; it is handed back with its result.
 */
export class Tracking {
  #ids = new Map();
  #slots = new Map();
  #free = [];
  #sent = 0;
  #ended = false;

  constructor(handlers) {
    Object.assign(this, handlers);
  }

  /** Start on `slot` with `boxes` (pixels of it), numbered `ids` on the page. */
  async start(slot, boxes, ids, { mode, quality, regions, maps, preset, label }) {
    this.client = new Client({ key: key.get() });
    const options = { preset, maps, label: label.slice(0, 200), idle_timeout_s: IDLE_S };
    this.session = await this.client.createSession({ frame: slot.canvas, boxes, options, quality });
    if (this.#ended) {
      this.session.close().catch(() => {});
      return;
    }
    const { seq, size, targets } = this.session.info;
    targets.forEach((target, i) => this.#ids.set(target.id, ids[i]));
    this.onresult({ seq, size, targets, timing: null }, ids, slot);
    this.attach({ mode, quality, regions });
  }

  /** Stream from now on in `mode`. */
  attach({ mode, quality, regions }) {
    this.stream?.close();
    this.#slots.clear();
    const stream = this.session.stream({ mode, quality, regions });
    this.stream = stream;
    stream.on("status", (change) => this.stream === stream && !this.#ended && this.onstatus(change));
    stream.on("problem", (error) => this.#refused(error));
    this.#listen(stream);
  }

  get mode() {
    return this.stream?.mode;
  }

  /** Whether a frame would go out now. */
  get open() {
    return Boolean(this.stream?.canSend);
  }

  /** A canvas of `size` that nobody needs any more, or a new one. */
  canvas([width, height]) {
    const canvas = this.#free.pop() ?? document.createElement("canvas");
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    return canvas;
  }

  /** Send a grabbed frame; resolves when the next may be sent. */
  async send(slot, options = {}) {
    const { stream } = this;
    const ts = ++this.#sent;
    this.#slots.set(ts, slot);
    try {
      const seq = await stream.send(slot.canvas, { ts, ...options });
      if (seq === null) this.#release(ts);
    } catch (error) {
      this.#release(ts);
      if (this.stream === stream && !this.#ended) this.onproblem(error);
    }
  }

  /** A box on the very frame of `slot`: a new target, or `target` (the page's number) put right. */
  async place(slot, box, target = null) {
    const { stream } = this;
    await stream.ready;
    const onNext = { onNext: true };
    const answer = target === null ? stream.add(box, onNext) : stream.correct(this.#server(target), box, onNext);
    answer.catch(() => {}); // until it is awaited below
    await this.send(slot, { whole: true });
    return answer;
  }

  remove(target) {
    return this.stream.remove(this.#server(target));
  }

  /** The page's numbers of these targets; `number()` gives one to a target that is new. */
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
        const slot = this.#slots.get(result.ts);
        this.onresult(result, this.numbered(result.targets), slot);
        for (const ts of this.#slots.keys()) if (ts <= result.ts) this.#release(ts);
      }
    } catch (error) {
      if (this.stream === stream && !this.#ended) this.onend(error);
    }
  }

  #refused(error) {
    if (!this.#ended) this.onproblem(error);
  }

  #server(target) {
    for (const [id, number] of this.#ids) if (number === target) return id;
    return -1;
  }

  #release(ts) {
    const slot = this.#slots.get(ts);
    this.#slots.delete(ts);
    if (slot?.pooled) this.#free.push(slot.canvas);
  }
}
