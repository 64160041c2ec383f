/** A stream of frames and results that outlives its connections. */

import { Controls } from "./controls.js";
import { Cutter } from "./cutter.js";
import { Events, Inbox } from "./delivery.js";
import { bytesOf, capture, isEncoded } from "./encoder.js";
import { MFCMTError, aborted, streamEnded, unsupportedSource } from "./errors.js";
import { follow } from "./follow.js";
import { IMAGE_TYPE, QUALITY, regionsByDefault } from "./frame.js";
import { Link } from "./link.js";
import { Room, deferred, quiet } from "./room.js";
import { Stats } from "./stats.js";

// Results that may wait unread before no more frames are taken.
const MAX_UNREAD = 64;
// In `latest` a superseded frame is told by the next result only; where the last frame was refused there may be
// none, so the end waits this long for it.
const LINGER_MS = 2000;
// No event tells that a socket's buffer has emptied.
const BUFFER_POLL_MS = 2;

const DEFAULTS = {
  mode: "latest",
  codec: "json",
  regions: "auto",
  quality: QUALITY,
  imageType: IMAGE_TYPE,
  maxSide: null,
  encoder: "auto",
  takeover: false,
  reconnectForMs: 60_000,
  stallMs: 10_000,
};

export class Stream {
  #client;
  #id;
  #options;
  #link;
  #controls;
  #cutter;
  #room = new Room(
    () => this.#hasRoom(),
    () => this.#events.emit("ready"),
  );
  #events = new Events();
  #inbox = new Inbox(() => this.#room.look());
  #stats = new Stats();
  #done = quiet(deferred());
  #error = null;
  #unanswered = new Map(); // seq → what was sent, with its picture where it may have to be cut anew
  #paused = false;
  #exhausted = false;
  #wholeNext = false;
  #polling = false;
  #nextSeq = 0;
  #lastSeq = 0;
  #size = null;

  constructor(client, id, options) {
    this.#client = client;
    this.#id = id;
    const given = Object.fromEntries(Object.entries(options).filter(([, value]) => value !== undefined));
    this.#options = { ...DEFAULTS, ...given };
    this.regions = this.#options.regions === "auto" ? regionsByDefault() : this.#options.regions;
    this.quality = this.#options.quality;
    this.maxSide = this.#options.maxSide;
    this.info = null;
    this.region = null;
    this.targets = [];
    this.#cutter = new Cutter(this.#options.encoder);
    this.#link = new Link(client, id, this.#options, {
      receive: (message) => this.#receive(message),
      takeUp: (connection) => this.#takeUp(connection),
      up: () => this.#up(),
      down: (error) => this.#down(error),
      status: (change) => this.#events.emit("status", change),
      end: (error) => this.#end(error),
      expecting: () => this.#unanswered.size > 0 || this.#controls.waiting,
    });
    this.#controls = new Controls(this.#link, () => (this.#wholeNext = true));
    const { signal, frames } = this.#options;
    const abort = () => this.#end(aborted(signal.reason));
    signal?.addEventListener("abort", abort, { once: true });
    if (signal?.aborted) abort();
    else this.#link.run();
    if (frames) this.#pump(frames);
  }

  get status() {
    return this.#link.status;
  }

  get mode() {
    return this.#options.mode;
  }

  get codec() {
    return this.#options.codec;
  }

  get encoder() {
    return this.#cutter.encoder?.where ?? null;
  }

  get paused() {
    return this.#paused;
  }

  get stats() {
    return this.#stats.copy(this.#unanswered.size);
  }

  get canSend() {
    return this.#room.free;
  }

  get ready() {
    return this.#ended ? Promise.reject(this.#ended) : this.#room.freed;
  }

  get closed() {
    return this.#done.promise;
  }

  get results() {
    return this.#inbox.read();
  }

  [Symbol.asyncIterator]() {
    return this.results;
  }

  on(event, listener) {
    return this.#events.on(event, listener);
  }

  send(source, options = {}) {
    return this.#send(source, options, this.mode === "lossless");
  }

  follow(video, options = {}) {
    return follow(this, video, options, {
      skip: () => (this.#stats.skipped += 1),
      fail: (error) => this.#ended || this.#events.emit("problem", error),
    });
  }

  add(box, { onNext } = {}) {
    return this.#controls.say({ type: "add", box: Array.from(box, Number) }, onNext);
  }

  correct(target, box, { onNext } = {}) {
    return this.#controls.say({ type: "correct", target, box: Array.from(box, Number) }, onNext);
  }

  remove(target) {
    return this.#controls.say({ type: "remove", target });
  }

  pause() {
    this.#paused = true;
    this.#room.look();
  }

  resume() {
    this.#paused = false;
    this.#room.look();
  }

  finish() {
    this.#exhausted = true;
    this.#endIfDone();
    return this.closed;
  }

  close() {
    this.#end(null);
  }

  /** What a caller is told who comes after the end. */
  get #ended() {
    return this.status === "closed" ? (this.#error ?? streamEnded()) : null;
  }

  // Frames out

  /** Unless it waits, a frame that finds no room is skipped. */
  async #send(source, options, waits) {
    if (this.#ended) throw this.#ended;
    const encoded = isEncoded(source);
    if (!waits && !this.#room.free) {
      if (options.transfer) source.close?.();
      this.#stats.skipped += 1;
      return null;
    }
    let image = null;
    let inside = false;
    try {
      if (waits) {
        if (!encoded) image = await capture(source, options.transfer); // what it shows now
        await this.#room.turn();
      } else {
        this.#room.taking += 1;
      }
      inside = true;
      const takenAt = performance.now();
      if (!encoded) image ??= await capture(source, options.transfer);
      const made = encoded
        ? { bytes: await bytesOf(source), region: options.region ?? null, saved: 0 }
        : await this.#encode(image, options.whole);
      return this.#handOver(await this.#link.connected(), { ...made, takenAt, ts: options.ts }, options.seq);
    } catch (error) {
      image?.close();
      throw this.#ended ?? error;
    } finally {
      if (inside) this.#room.leave();
      this.#endIfDone();
    }
  }

  async #encode(image, whole) {
    // A cut that turns out too small is made anew where every frame counts.
    const keep = this.mode === "lossless" && this.regions;
    const needed = this.regions && !whole && !this.#wholeNext ? this.region : null;
    const began = performance.now();
    const made = await this.#cutter.encode(image, {
      sessionSize: this.#size,
      maxSide: this.maxSide,
      needed,
      targets: this.targets,
      ahead: Math.max(0, this.#unanswered.size - this.info.region_lag),
      imageType: this.#options.imageType,
      quality: this.quality,
      keep,
    });
    this.#stats.encodeMs = performance.now() - began;
    return { ...made, cut: made.region !== null, picture: keep ? image : null };
  }

  /** Give a frame to the connection; if it breaks, the frame is sent again. */
  #handOver(connection, sent, wanted) {
    const seq = wanted ?? this.#nextSeq;
    this.#nextSeq = seq + 1;
    if (!sent.cut) {
      this.#wholeNext = false;
      for (const control of this.#controls.takeForNext()) connection.control(control);
    }
    if (this.#unanswered.size === 0) connection.heardAt = performance.now();
    this.#unanswered.set(seq, sent);
    const { ts, region } = sent;
    connection.frame(sent.bytes, { seq, ...(ts !== undefined && { ts }), ...(region && { region }) });
    this.#stats.sent += 1;
    this.#stats.bytesSent += sent.bytes.length;
    this.#stats.bytesSaved += sent.saved;
    return seq;
  }

  async #cutAnew(sent) {
    this.#room.taking += 1;
    try {
      const made = await this.#encode(sent.picture, true);
      this.#handOver(await this.#link.connected(), { ...sent, ...made });
    } catch (error) {
      if (!this.#ended) this.#events.emit("problem", error);
    } finally {
      this.#room.leave();
      this.#endIfDone();
    }
  }

  async #pump(frames) {
    try {
      for await (const frame of frames) {
        if (this.#ended) return;
        await this.#send(frame, { transfer: true }, true);
      }
      await this.finish();
    } catch (error) {
      this.#end(error instanceof MFCMTError ? error : unsupportedSource("the frames broke off", error));
    }
  }

  #hasRoom() {
    const { connection } = this.#link;
    if (!connection || this.#paused || this.#inbox.unread >= MAX_UNREAD) return false;
    const inFlight = this.#unanswered.size;
    if (this.mode === "lossless") {
      // A cut is sure to cover what is needed only when the frame before it is answered.
      const cutting = [...this.#unanswered.values()].some(({ picture }) => picture);
      return inFlight < (cutting ? 1 : this.info.credit);
    }
    return inFlight < this.#stats.window && !this.#isBuffering(connection);
  }

  #isBuffering(connection) {
    if (connection.buffered === 0) return false;
    if (!this.#polling) {
      this.#polling = true;
      setTimeout(() => {
        this.#polling = false;
        this.#room.look();
      }, BUFFER_POLL_MS);
    }
    return true;
  }

  // Connections

  /** Fetch the results that were missed, send again what was not tracked; whether the connection is still there. */
  async #takeUp(connection) {
    const { ready } = connection;
    const { session } = ready;
    if (this.info === null) {
      this.#lastSeq = session.seq;
    } else if ([...this.#unanswered.keys()].some((seq) => seq <= session.seq)) {
      try {
        await this.#fetchMissed();
      } catch (error) {
        if (error.code === "connection-lost") {
          connection.end(error);
          return false;
        }
        // Without a key they cannot be had.
        for (const seq of [...this.#unanswered.keys()]) if (seq <= session.seq) this.#forget(seq);
      }
    }
    if (this.info) this.#stats.reconnects += 1;
    this.info = ready;
    this.#size = session.size;
    this.region = session.region;
    this.targets = session.targets;
    this.#nextSeq = Math.max(this.#nextSeq, ready.next_seq);
    const again = [...this.#unanswered].sort(([a], [b]) => a - b);
    this.#unanswered.clear();
    for (const [, sent] of this.mode === "latest" ? again.slice(-1) : again) this.#handOver(connection, sent);
    return true;
  }

  async #fetchMissed() {
    const session = await this.#client.getSession(this.#id);
    for (const result of await session.trajectory({ after: this.#lastSeq })) {
      this.#answer({ type: "result", dropped: 0, timing: null, ...result });
    }
  }

  #up() {
    this.#room.look();
    this.#endIfDone();
  }

  #down(error) {
    this.#controls.fail(error);
    this.#room.look();
  }

  // Messages in

  #receive(message) {
    if (this.#ended) return;
    if (message.type === "result") this.#answer(message);
    else if (message.type === "targets") this.#retarget(message);
    else if (message.type === "error") this.#refuse(message);
    else if (message.type === "draining") this.#link.drain(message.reconnect_in_s * 1000);
    this.#room.look();
    this.#endIfDone();
  }

  #answer(result) {
    if (result.seq <= this.#lastSeq) return; // fetched already
    this.#lastSeq = result.seq;
    const sent = this.#unanswered.get(result.seq);
    const answered = this.mode === "latest" ? [...this.#unanswered.keys()] : [result.seq];
    for (const seq of answered) if (seq <= result.seq) this.#forget(seq);
    this.#size = result.size;
    this.region = result.region;
    this.targets = result.targets;
    this.#stats.answer(result.timing && sent ? sent.takenAt : null, result.dropped);
    this.#inbox.put(result);
    this.#events.emit("result", result);
  }

  #retarget(message) {
    this.region = message.region;
    this.targets = message.targets;
    this.#controls.answer(message);
    this.#events.emit("targets", message);
  }

  #refuse({ seq = null, ref = null, problem }) {
    const error = new MFCMTError(problem, { seq, ref });
    if (this.#controls.refuse(ref, error, this.regions)) return;
    const sent = this.#unanswered.get(seq);
    this.#unanswered.delete(seq);
    if (sent?.cut && error.code === "bad-region") {
      this.#wholeNext = true;
      if (sent.picture) return void this.#cutAnew(sent);
    } else {
      this.#events.emit("problem", error);
    }
    sent?.picture?.close();
    this.#stats.refused += 1;
  }

  #forget(seq) {
    this.#unanswered.get(seq)?.picture?.close();
    this.#unanswered.delete(seq);
  }

  // The end

  #endIfDone() {
    if (!this.#exhausted || this.#room.taking || this.#room.waiting) return;
    if (this.#unanswered.size === 0) this.#end(null);
    else if (this.mode === "latest" && !this.#unanswered.has(this.#nextSeq - 1)) {
      setTimeout(() => this.#end(null), LINGER_MS);
    }
  }

  #end(error) {
    if (this.status === "closed") return;
    this.#error = error;
    this.#link.close(error);
    const why = error ?? streamEnded();
    this.#room.fail(why);
    this.#controls.fail(why);
    for (const seq of [...this.#unanswered.keys()]) this.#forget(seq);
    this.#cutter.close();
    this.#inbox.end(error);
    if (error) this.#done.reject(error);
    else this.#done.resolve();
  }
}
