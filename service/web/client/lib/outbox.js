/** Frames on their way out: taken when there is room, encoded, numbered, kept until they are answered. */

import { Cutter } from "./cutter.js";
import { bytesOf, capture, isEncoded } from "./encoder.js";
import { Room } from "./room.js";

// No event tells that a socket's buffer has emptied.
const BUFFER_POLL_MS = 2;

export class Outbox {
  /** What the server counts on; frames that number themselves move it. */
  nextSeq = 0;
  /** Whether the next frame of pixels must not be cut. */
  wholeNext = false;
  paused = false;
  #stream;
  #options;
  #link;
  #controls;
  #stats;
  #tell;
  #cutter;
  #room;
  #unanswered = new Map(); // seq → what was sent, with its picture where it may have to be cut anew
  #polling = false;

  /**
   * `stream` has `info`, `size`, `region` and `targets` as last told, and what its user may set: `regions`, `quality`,
   * `maxSide`. `tell` hears `ready()`, `settled()` when a frame is through, `failed(error)`; and says whether it `rests()`.
   */
  constructor(stream, options, { link, controls, stats, tell }) {
    this.#stream = stream;
    this.#options = options;
    this.#link = link;
    this.#controls = controls;
    this.#stats = stats;
    this.#tell = tell;
    this.#cutter = new Cutter(options.encoder);
    this.#room = new Room(
      () => this.#hasRoom(),
      () => tell.ready(),
    );
  }

  get encoder() {
    return this.#cutter.encoder?.where ?? null;
  }

  get free() {
    return this.#room.free;
  }

  get freed() {
    return this.#room.freed;
  }

  get inFlight() {
    return this.#unanswered.size;
  }

  /** Whether frames are between being taken and being sent. */
  get busy() {
    return this.#room.taking > 0 || this.#room.waiting > 0;
  }

  /** Whether the last frame's answer is still to come. */
  get awaitsLast() {
    return this.#unanswered.has(this.nextSeq - 1);
  }

  look() {
    this.#room.look();
  }

  /** Unless it waits, a frame that finds no room is skipped. */
  async send(source, options, waits) {
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
      throw error;
    } finally {
      if (inside) this.#room.leave();
      this.#tell.settled();
    }
  }

  /** A result has come: when its frame was taken, or null. In `latest` it answers all frames before it too. */
  answer(seq) {
    const { takenAt = null } = this.#unanswered.get(seq) ?? {};
    if (this.#options.mode === "latest") this.forgetUpTo(seq);
    else this.#forget(seq);
    return takenAt;
  }

  /** A frame was refused; whether that is the outbox's own affair: a cut that was too small. */
  refuse(seq, error) {
    const sent = this.#unanswered.get(seq);
    const tooSmall = Boolean(sent?.cut) && error.code === "bad-region";
    if (tooSmall) this.wholeNext = true;
    if (tooSmall && sent.picture) {
      this.#unanswered.delete(seq);
      this.#cutAnew(sent);
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

  /** On a new connection: send again what was not tracked, in `latest` only the newest. */
  takeUp(connection) {
    this.nextSeq = Math.max(this.nextSeq, connection.ready.next_seq);
    const again = [...this.#unanswered].sort(([a], [b]) => a - b);
    this.#unanswered.clear();
    for (const [, sent] of this.#options.mode === "latest" ? again.slice(-1) : again) this.#handOver(connection, sent);
  }

  close(why) {
    this.#room.fail(why);
    this.forgetUpTo(Infinity);
    this.#cutter.close();
  }

  async #encode(image, whole) {
    const { info, size, region, targets, regions, quality, maxSide } = this.#stream;
    // A cut that turns out too small is made anew where every frame counts.
    const keep = this.#options.mode === "lossless" && regions;
    const began = performance.now();
    const made = await this.#cutter.encode(image, {
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
    return { ...made, cut: made.region !== null, picture: keep ? image : null };
  }

  /** Give a frame to the connection; if that breaks, the frame is sent again. */
  #handOver(connection, sent, wanted) {
    const seq = wanted ?? this.nextSeq;
    this.nextSeq = seq + 1;
    if (!sent.cut) {
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

  async #cutAnew(sent) {
    this.#room.taking += 1;
    try {
      const made = await this.#encode(sent.picture, true);
      this.#handOver(await this.#link.connected(), { ...sent, ...made });
    } catch (error) {
      this.#tell.failed(error);
    } finally {
      this.#room.leave();
      this.#tell.settled();
    }
  }

  #forget(seq) {
    this.#unanswered.get(seq)?.picture?.close();
    this.#unanswered.delete(seq);
  }

  #hasRoom() {
    const { connection } = this.#link;
    if (!connection || this.#link.holding || this.paused || this.#tell.rests()) return false;
    const inFlight = this.#unanswered.size;
    if (this.#options.mode === "lossless") {
      // A cut is sure to cover what is needed only when the frame before it is answered.
      const cutting = [...this.#unanswered.values()].some(({ picture }) => picture);
      return inFlight < (cutting ? 1 : this.#stream.info.credit);
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
}
