/** A stream of frames and results that outlives its connections. */

import { numbers } from "./arguments.js";
import { Controls } from "./controls.js";
import { Events, Inbox } from "./events.js";
import { MFCMTError, aborted, mayPass, streamEnded, unsupportedSource } from "./errors.js";
import { follow } from "./follow.js";
import { ReconnectingSocket } from "./reconnecting-socket.js";
import { SendQueue } from "./send-queue.js";
import { deferred, quiet } from "./send-gate.js";
import { Stats } from "./stats.js";
import { streamOptions } from "./stream-options.js";
import { Told } from "./told.js";

// How many results may wait unread before no more frames are taken.
const MAX_UNREAD = 64;
// In `latest` a superseded frame is counted by the next result only; where the last frame was refused there may be
// none, so the end waits this long for it.
const LINGER_MS = 2000;

export class Stream {
  #client;
  #id;
  #options;
  #told;
  #socket;
  #controls;
  #queue;
  #events = new Events();
  #inbox = new Inbox(
    () => this.#queue.update(),
    () => this.#leave(),
  );
  #stats = new Stats();
  #done = quiet(deferred());
  #error = null;
  #exhausted = false;
  #brokenAt = 0;
  #resumed = null;
  #lastSeq = 0;

  /** `sourceSize` is the size of the session's last frame before it was scaled; null where that is not known. */
  constructor(client, id, options, sourceSize = null) {
    this.#client = client;
    this.#id = id;
    this.#options = streamOptions(options);
    this.regions = this.#options.regions;
    this.quality = this.#options.quality;
    this.maxSide = this.#options.maxSide;
    this.#told = new Told(client, sourceSize);
    this.#socket = new ReconnectingSocket(client, id, this.#options, {
      receive: (message) => this.#receive(message),
      takeUp: (connection) => this.#takeUp(connection),
      up: () => this.#up(),
      down: (error) => this.#down(error),
      status: (change) => this.#events.emit("status", change),
      end: (error) => this.#end(error),
      expecting: () => this.#queue.inFlight > 0 || this.#controls.waiting,
    });
    this.#controls = new Controls(this.#socket, () => (this.#queue.wholeNext = true));
    this.#queue = new SendQueue(this, this.#told, this.#options, {
      socket: this.#socket,
      controls: this.#controls,
      stats: this.#stats,
      openWorker: async () => (this.#options.encoder === "main" ? null : client.openWorker()),
      hooks: {
        ready: () => this.#events.emit("ready"),
        settled: () => this.#endIfDone(),
        failed: (error) => this.#problem(error),
        isFull: () => this.#inbox.unread >= MAX_UNREAD,
      },
    });
    const { signal, frames } = this.#options;
    const abort = () => this.#end(aborted(signal.reason));
    signal?.addEventListener("abort", abort, { once: true });
    if (signal?.aborted) abort();
    else this.#socket.run();
    if (frames) this.#pump(frames);
  }

  get status() {
    return this.#socket.status;
  }

  get mode() {
    return this.#options.mode;
  }

  get codec() {
    return this.#options.codec;
  }

  get info() {
    return this.#told.info;
  }

  get size() {
    return this.#told.inSource("size");
  }

  get region() {
    return this.#told.inSource("region");
  }

  get targets() {
    return this.#told.inSource("targets");
  }

  get encoder() {
    return this.#queue.encoder;
  }

  get paused() {
    return this.#queue.paused;
  }

  get stats() {
    return this.#stats.copy(this.#queue.inFlight);
  }

  get canSend() {
    return this.#queue.free;
  }

  get ready() {
    return this.#ended ? Promise.reject(this.#ended) : this.#queue.freed;
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
      fail: (error) => this.#problem(error),
    });
  }

  async add(box, { onNext } = {}) {
    return this.#control({ type: "add" }, box, onNext);
  }

  async correct(target, box, { onNext } = {}) {
    return this.#control({ type: "correct", target }, box, onNext);
  }

  async remove(target) {
    return this.#told.scale.told(await this.#controls.send(() => ({ type: "remove", target })));
  }

  pause() {
    this.#queue.paused = true;
    this.#queue.update();
  }

  resume() {
    this.#queue.paused = false;
    this.#queue.update();
  }

  finish() {
    this.#exhausted = true;
    this.#endIfDone();
    return this.closed;
  }

  close() {
    this.#end(null);
  }

  /** Close, because the loop over the results was left; resolves when the session is free. */
  async #leave() {
    this.close();
    await this.#socket.released;
  }

  /** The error for calls after the end; null before. */
  get #ended() {
    return this.status === "closed" ? (this.#error ?? streamEnded()) : null;
  }

  async #control(control, box, onNext) {
    const given = numbers(box);
    const make = () => ({ ...control, box: this.#told.scale.toSent(given) });
    return this.#told.scale.told(await this.#controls.send(make, onNext));
  }

  async #send(source, options, waits) {
    if (this.#ended) throw this.#ended;
    try {
      return await this.#queue.send(source, options, waits);
    } catch (error) {
      throw this.#ended ?? error;
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

  // Connections

  /** Fetch the results that were missed, send again what was not tracked. */
  async #takeUp(connection) {
    const { ready } = connection;
    const { session } = ready;
    if (this.info === null) this.#lastSeq = session.seq;
    else if (this.#queue.hasUpTo(session.seq)) await this.#fetchMissed(session.seq);
    if (this.info) this.#resumed = { seq: session.seq, lostAfter: lostAfter(ready, this.#lastSeq) };
    this.#told.attached(ready);
    this.#queue.takeUp(connection);
  }

  async #fetchMissed(upTo) {
    // The browser's pool may have dead connections too, so do not wait long for them.
    const timeoutMs = this.#options.stallMs;
    try {
      for (const result of await this.#client.missed(this.#id, this.#lastSeq, { timeoutMs })) {
        this.#answer({ type: "result", dropped: 0, timing: null, ...result });
      }
    } catch (error) {
      if (mayPass(error, true)) throw error;
      this.#queue.forgetUpTo(upTo); // without a key they cannot be had
    }
  }

  #up() {
    if (this.#resumed) {
      this.#stats.reconnects += 1;
      this.#events.emit("resumed", { ...this.#resumed, downMs: performance.now() - this.#brokenAt });
    }
    this.#resumed = null;
    this.#brokenAt = 0;
    this.#queue.update();
    this.#endIfDone();
  }

  #down(error) {
    this.#brokenAt ||= performance.now();
    this.#controls.fail(error);
    this.#queue.update();
  }

  // Messages in

  #receive(message) {
    if (this.#ended) return;
    if (message.type === "result") this.#answer(message);
    else if (message.type === "targets") this.#retarget(message);
    else if (message.type === "error") this.#refuse(message);
    else if (message.type === "draining") this.#drain(message);
    this.#queue.update();
    this.#endIfDone();
  }

  #drain({ reconnect_in_s: pauseS, resumable, url }) {
    this.#client.places.learn(url);
    this.#socket.drain(pauseS * 1000, resumable);
  }

  #answer(result) {
    if (result.seq <= this.#lastSeq) return; // fetched already
    this.#lastSeq = result.seq;
    const sent = this.#queue.answer(result.seq);
    this.#told.take(result, sent?.sourceSize);
    this.#stats.answer(result.timing && sent ? sent.takenAt : null, result.dropped);
    const given = this.#told.scale.told(result);
    this.#inbox.put(given);
    this.#events.emit("result", given);
  }

  #retarget(message) {
    this.#told.take(message);
    this.#controls.answer(message);
    this.#events.emit("targets", this.#told.scale.told(message));
  }

  #refuse({ seq = null, ref = null, problem }) {
    const error = new MFCMTError(problem, { seq, ref });
    if (this.#controls.refuse(ref, error, this.regions)) return;
    if (!this.#queue.refuse(seq, error)) this.#problem(error);
  }

  #problem(error) {
    if (!this.#ended) this.#events.emit("problem", error);
  }

  // The end

  #endIfDone() {
    if (!this.#exhausted || this.#queue.busy) return;
    if (this.#queue.inFlight === 0) this.#end(null);
    else if (this.mode === "latest" && !this.#queue.awaitsLast) setTimeout(() => this.#end(null), LINGER_MS);
  }

  #end(error) {
    if (this.status === "closed") return;
    this.#error = error;
    this.#socket.close(error);
    const why = error ?? streamEnded();
    this.#queue.close(why);
    this.#controls.fail(why);
    this.#inbox.end(error);
    if (error) this.#done.reject(error);
    else this.#done.resolve();
  }
}

/** The last frame that the session still knows, if results of later ones have been given; else null. */
const lostAfter = ({ lost_after: known = null }, lastSeq) => (known !== null && known < lastSeq ? known : null);
