// One session with its stream, and the map from its targets to the run's numbers.

import { Client } from "../client/mfcmt.js";
import { Uplink } from "./uplink.js";

const KEY = "mfcmt.key";
const IDLE_S = 120; // a page that vanished does not keep its place for long
const WAIT_MS = 5000; // for a lane or a place

/** The address of the service: the page's own, also behind a proxy that has it under a path. */
export const HOME = new URL("../../", import.meta.url).href.replace(/\/$/, "");

/** The API key of this tab, if there is one. */
export const key = {
  get: () => sessionStorage.getItem(KEY) ?? undefined,
  set: (value) => sessionStorage.setItem(KEY, value),
  forget: () => sessionStorage.removeItem(KEY),
};

/**
 * Calls `onresult(result, ids, frame)`, `onstatus(change)`, `onproblem(error)`, `onend(error)`, and `onspare(frame)` for
 * frames, `{canvas, time, index}`, that may be reused.
 */
export class Tracking {
  /** The numbers of the targets that are followed. */
  ids = new Set();
  #ids = new Map(); // the session's number → the run's
  #coming = []; // the run's numbers of targets that are being added, in order
  #frames = new Map();
  #sent = 0;
  #newest = null; // the seq and size of the newest frame that was answered
  #heardAt = 0;
  #ended = false;
  #uplink = new Uplink();

  constructor(handlers) {
    Object.assign(this, handlers);
  }

  /** Start on `frame` with `placed`: `{target, box}`, boxes in fractions of it. */
  async start(frame, placed, { mode, quality, regions, maps, preset, label }) {
    this.ids = new Set(placed.map(({ target }) => target));
    this.client = new Client({ url: HOME, key: key.get() });
    // so that a phone may be rotated
    const options = { preset, maps, on_resize: "rescale", label: label.slice(0, 200), idle_timeout_s: IDLE_S };
    const boxes = placed.map(({ box }) => pixels(box, sizeOf(frame)));
    this.session = await this.client.createSession({ frame: frame.canvas, boxes, options, quality, waitMs: WAIT_MS });
    if (this.#ended) {
      this.session.close().catch(() => {});
      return;
    }
    const { seq, size, targets } = this.session.info;
    this.#newest = [seq, size];
    targets.forEach((target, i) => this.#ids.set(target.id, placed[i].target));
    this.onresult({ seq, size, targets, timing: null }, this.#numbered(targets), frame);
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
    if (mode === "latest") this.#uplink.attach(stream, quality, Math.max(...this.#newest[1]));
    stream.on("status", (change) => this.stream === stream && !this.#ended && this.onstatus(change));
    stream.on("problem", (error) => this.stream === stream && !this.#ended && this.onproblem(error));
    this.#listen(stream);
  }

  /** Change what the stream sends from now on. */
  set({ quality, regions }) {
    this.stream.regions = regions;
    if (this.mode === "latest") this.#uplink.set(quality);
    else this.stream.quality = quality;
  }

  /** Note that a frame was left out, because there was no room for it. */
  skip() {
    this.#uplink.skip();
  }

  get mode() {
    return this.stream?.mode;
  }

  /** Whether a frame could be sent now. */
  get open() {
    return Boolean(this.stream?.canSend);
  }

  /** For how long an answer has been due, in milliseconds. */
  get silentMs() {
    const [oldest] = this.#frames.values();
    return oldest ? performance.now() - Math.max(this.#heardAt, oldest.sentAt) : 0;
  }

  /** Send a frame. Resolves when the next one may be sent. */
  async send(frame, options = {}) {
    const { stream } = this;
    const ts = ++this.#sent;
    this.#frames.set(ts, { ...frame, sentAt: performance.now() });
    try {
      const seq = await stream.send(frame.canvas, { ts, ...options });
      if (seq === null) this.#release(ts);
    } catch (error) {
      this.#release(ts);
      if (this.stream === stream && !this.#ended) this.onproblem(error);
    }
  }

  /** Set boxes on this frame and send it: `placed` are `{target, box}`; targets that are not followed yet are added. */
  async place(frame, placed) {
    await this.stream.ready;
    const all = Promise.all(placed.map((one) => this.#set(one, sizeOf(frame), true)));
    all.catch(() => {}); // until it is awaited below
    await this.send(frame, { whole: true });
    await all;
  }

  /**
   * Set a target's box on the newest frame, which was answered: sent again, the other targets would move on in it twice.
   * The service may only have a region of it, and then it must be sent again.
   */
  async amend(frame, placed) {
    if (this.stream.regions) return this.place(frame, [placed]);
    const [seq, size] = this.#newest;
    const { targets } = await this.#set(placed, size, false);
    const ids = this.#numbered(targets);
    const i = ids.indexOf(placed.target);
    this.onresult({ seq, size, targets: [targets[i]], timing: null }, [ids[i]], frame);
    this.onspare(frame);
  }

  async remove(target) {
    await this.stream.remove(this.#server(target));
    this.ids.delete(target);
  }

  /** End the session. */
  stop() {
    if (this.#ended) return;
    this.#ended = true;
    this.stream?.close();
    this.session?.close().catch(() => {});
  }

  async #listen(stream) {
    try {
      for await (const result of stream) {
        if (this.stream !== stream || this.#ended) return;
        this.#newest = [result.seq, result.size];
        this.#heardAt = performance.now();
        if (stream.mode === "latest") this.#uplink.note(result.timing);
        this.onresult(result, this.#numbered(result.targets), this.#frames.get(result.ts));
        for (const ts of this.#frames.keys()) if (ts <= result.ts) this.#release(ts);
      }
    } catch (error) {
      if (this.stream === stream && !this.#ended) this.onend(error);
    }
  }

  async #set({ target, box }, size, onNext) {
    if (this.ids.has(target)) return this.stream.correct(this.#server(target), pixels(box, size), { onNext });
    this.#coming.push(target);
    try {
      const answer = await this.stream.add(pixels(box, size), { onNext });
      this.ids.add(target);
      return answer;
    } catch (error) {
      this.#coming = this.#coming.filter((one) => one !== target);
      throw error;
    }
  }

  /** The run's numbers for these targets. */
  #numbered(targets) {
    return targets.map(({ id }) => {
      if (!this.#ids.has(id)) this.#ids.set(id, this.#coming.shift());
      return this.#ids.get(id);
    });
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

/** A target of a result as a row of a run: its box in fractions of the frame, without maps. */
export function rowOf({ box: [x, y, w, h], maps: _, id: __, ...told }, [width, height]) {
  return { ...told, box: [x / width, y / height, w / width, h / height] };
}

const sizeOf = ({ canvas: { width, height } }) => [width, height];
const pixels = ([x, y, w, h], [width, height]) => [x * width, y * height, w * width, h * height];
