/** Takes frames when there is room, encodes and numbers them, and remembers them until they are answered. */

import { FrameCropper } from "./frame-cropper.js";
import { bytesOf, capture, isEncoded } from "./encoder.js";
import { SendGate } from "./send-gate.js";

// No event says that a socket's buffer has emptied.
const BUFFER_POLL_MS = 2;

export class SendQueue {
  /** The number of the next frame, unless it brings its own. */
  nextSeq = 0;
  /** Whether the next frame of pixels must not be cropped. */
  wholeNext = false;
  paused = false;
  #chosen;
  #told;
  #options;
  #socket;
  #controls;
  #stats;
  #hooks;
  #cropper;
  #gate;
  #unanswered = new Map(); // seq → what was sent, with its picture where it may have to be cropped again
  #polling = false;

  /**
   * `chosen` is what the stream's user may set: `regions`, `quality`, `maxSide`; `told` what the service said last.
   * `openWorker()` resolves with a worker that encodes, or null. `hooks` are called: `ready()` when a frame would be taken, `settled()` when one is through,
   * `failed(error)`, and `isFull()`, which returns whether too many results wait to be read.
   */
  constructor(chosen, told, options, { socket, controls, stats, openWorker, hooks }) {
    this.#chosen = chosen;
    this.#told = told;
    this.#options = options;
    this.#socket = socket;
    this.#controls = controls;
    this.#stats = stats;
    this.#hooks = hooks;
    this.#cropper = new FrameCropper(openWorker);
    this.#gate = new SendGate(
      () => this.#hasRoom(),
      () => hooks.ready(),
    );
  }

  get encoder() {
    return this.#cropper.encoder?.where ?? null;
  }

  get free() {
    return this.#gate.free;
  }

  get freed() {
    return this.#gate.freed;
  }

  get inFlight() {
    return this.#unanswered.size;
  }

  /** Whether frames are between being taken and being sent. */
  get busy() {
    return this.#gate.taking > 0 || this.#gate.waiting > 0;
  }

  /** Whether the last frame's answer is still to come. */
  get awaitsLast() {
    return this.#unanswered.has(this.nextSeq - 1);
  }

  /** Look whether a frame may be taken now. */
  update() {
    this.#gate.update();
  }

  /** Send a frame; without `waits`, one that finds no room is skipped. Resolves with its number, or null. */
  async send(source, options, waits) {
    const encoded = isEncoded(source);
    if (!waits && !this.#gate.free) {
      if (options.transfer) source.close?.();
      this.#stats.skipped += 1;
      return null;
    }
    let image = null;
    let inside = false;
    try {
      if (waits) {
        if (!encoded) image = await capture(source, options.transfer); // what it shows now
        await this.#gate.enter();
      } else {
        this.#gate.taking += 1;
      }
      inside = true;
      const takenAt = performance.now();
      if (!encoded) image ??= await capture(source, options.transfer);
      const made = encoded
        ? { bytes: await bytesOf(source), region: options.region ?? null, saved: 0, sourceSize: null }
        : await this.#encode(image, options.whole);
      return this.#handOver(await this.#socket.connected(), { ...made, takenAt, ts: options.ts }, options.seq);
    } catch (error) {
      image?.close();
      throw error;
    } finally {
      if (inside) this.#gate.leave();
      this.#hooks.settled();
    }
  }

  /** Forget an answered frame, in `latest` all before it too; returns what is known of it, or null. */
  answer(seq) {
    const sent = this.#unanswered.get(seq) ?? null;
    if (this.#options.mode === "latest") this.forgetUpTo(seq);
    else this.#forget(seq);
    return sent;
  }

  /** Forget a refused frame; returns whether nobody has to know, because a crop was too small and is made again. */
  refuse(seq, error) {
    const sent = this.#unanswered.get(seq);
    const tooSmall = Boolean(sent?.cropped) && error.code === "bad-region";
    if (tooSmall) this.wholeNext = true;
    if (tooSmall && sent.picture) {
      this.#unanswered.delete(seq);
      this.#cropAgain(sent);
    } else {
      this.#forget(seq);
      this.#stats.refused += 1;
    }
    return tooSmall;
  }

  hasUpTo(seq) {
    return [...this.#unanswered.keys()].some((each) => each <= seq);
  }

  forgetUpTo(seq) {
    for (const each of [...this.#unanswered.keys()]) if (each <= seq) this.#forget(each);
  }

  /** Send again on a new connection what was not tracked, in `latest` only the newest. */
  takeUp(connection) {
    this.nextSeq = Math.max(this.nextSeq, connection.ready.next_seq);
    const again = [...this.#unanswered].sort(([a], [b]) => a - b);
    this.#unanswered.clear();
    for (const [, sent] of this.#options.mode === "latest" ? again.slice(-1) : again) this.#handOver(connection, sent);
  }

  close(why) {
    this.#gate.fail(why);
    this.forgetUpTo(Infinity);
    this.#cropper.close();
  }

  async #encode(image, whole) {
    const { regions, quality, maxSide } = this.#chosen;
    const { info, size, region, targets } = this.#told;
    // A crop that turns out too small is made again where every frame counts.
    const keep = this.#options.mode === "lossless" && regions;
    const began = performance.now();
    const made = await this.#cropper.encode(image, {
      sessionSize: size,
      maxSide,
      needed: regions && !whole && !this.wholeNext ? region : null,
      targets,
      ahead: Math.max(0, this.#unanswered.size - info.region_lag),
      imageType: this.#options.imageType,
      quality,
      keep,
    });
    this.#stats.encodeMs = performance.now() - began;
    return { ...made, cropped: made.region !== null, picture: keep ? image : null };
  }

  /** Hand a frame to the connection; if that breaks, the frame is sent again. */
  #handOver(connection, sent, wanted) {
    const seq = wanted ?? this.nextSeq;
    this.nextSeq = seq + 1;
    if (!sent.cropped) {
      this.wholeNext = false;
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

  async #cropAgain(sent) {
    this.#gate.taking += 1;
    try {
      const made = await this.#encode(sent.picture, true);
      this.#handOver(await this.#socket.connected(), { ...sent, ...made });
    } catch (error) {
      this.#hooks.failed(error);
    } finally {
      this.#gate.leave();
      this.#hooks.settled();
    }
  }

  #forget(seq) {
    this.#unanswered.get(seq)?.picture?.close();
    this.#unanswered.delete(seq);
  }

  #hasRoom() {
    const { connection } = this.#socket;
    if (!connection || this.#socket.holding || this.paused || this.#hooks.isFull()) return false;
    const inFlight = this.#unanswered.size;
    if (this.#options.mode === "lossless") {
      // A crop surely covers what is needed only when the frame before it is answered.
      const cropping = [...this.#unanswered.values()].some(({ picture }) => picture);
      return inFlight < (cropping ? 1 : this.#told.info.credit);
    }
    return inFlight < this.#stats.window && !this.#isBuffering(connection);
  }

  #isBuffering(connection) {
    if (connection.buffered === 0) return false;
    if (!this.#polling) {
      this.#polling = true;
      setTimeout(() => {
        this.#polling = false;
        this.#gate.update();
      }, BUFFER_POLL_MS);
    }
    return true;
  }
}
