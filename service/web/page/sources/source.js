// What every source of pictures has, and the two kinds: a <video> that is not shown itself, and frames with numbers.

import { at } from "./times.js";

const BEHIND_MS = 500; // a machine that is this far behind plays slower

/** A source failed; `problems.js` explains `code`. */
export class SourceError extends Error {
  constructor(code, cause) {
    super(code, { cause });
    this.code = code;
  }
}

/**
 * `onframe` is called for each frame that is shown, `onend` after the last one. `time` is the shown frame's in seconds,
 * `index` its number in the source, from 0; null where that is unknown, as is `count`, the number of frames.
 */
export class Source {
  onframe = () => {};
  onend = () => {};
  time = 0;
  index = null;
  count = null;
  live = false;

  constructor({ name, kind, fps = 30, suggestion = null }) {
    Object.assign(this, { name, kind, fps, suggestion });
  }

  close() {
    this.onframe = this.onend = () => {};
    this.closed = true;
  }
}

/** Frames with known numbers and times. A kind of it has `load(index)`, which makes a frame ready for `draw`. */
export class FrameSource extends Source {
  #playing = 0;
  #showing = Promise.resolve();

  /** `times` are those of the frames in seconds, rising; `names` are their file names, where each has one. */
  constructor(about, { times, duration, size, names = null }) {
    super(about);
    Object.assign(this, { times, duration, size, names, count: times.length });
  }

  /** Show a frame by its number. Resolves when it is shown. */
  show(index) {
    const wanted = Math.min(Math.max(index, 0), this.count - 1);
    const one = async () => {
      if (this.closed) return;
      this.index = await this.load(wanted);
      this.time = this.times[this.index];
      this.onframe();
    };
    return (this.#showing = this.#showing.then(one, one));
  }

  seek(time) {
    return this.show(at(this.times, time));
  }

  /** Show the next frame. Resolves to false at the end. */
  async step() {
    if (this.index + 1 >= this.count) return false;
    await this.show(this.index + 1);
    return true;
  }

  /** Play in real time; frames that come too late are left out. */
  async play() {
    const playing = ++this.#playing;
    let began = performance.now() - 1000 * this.time;
    const here = () => playing === this.#playing && !this.closed;
    while (here()) {
      await new Promise(requestAnimationFrame);
      const due = (performance.now() - began) / 1000;
      const index = at(this.times, due);
      if (here() && index > this.index) await this.show(index);
      const behind = performance.now() - began - 1000 * this.time;
      if (behind > BEHIND_MS + 1000 * this.lasts(this.index)) began += behind;
      if (here() && this.index === this.count - 1 && due >= this.duration) this.onend();
    }
  }

  pause() {
    this.#playing++;
  }

  /** How long a frame is shown, in seconds. */
  lasts(index) {
    return (this.times[index + 1] ?? this.duration) - this.times[index];
  }

  close() {
    super.close();
    this.pause();
  }
}

/** A <video>; `this.time` is the presented frame's. */
export class ElementSource extends Source {
  constructor(video, about) {
    super(about);
    this.video = video;
    video.addEventListener("ended", () => this.onend());
    this.#watch();
  }

  get size() {
    return [this.video.videoWidth, this.video.videoHeight];
  }

  draw(context, width, height) {
    context.drawImage(this.video, 0, 0, width, height);
  }

  async play() {
    try {
      await this.video.play();
    } catch (error) {
      if (error.name !== "AbortError") throw error; // paused before it began
    }
  }

  /** Called with the media time of each frame that the browser presents. */
  presented(time) {
    this.time = time;
    this.onframe();
  }

  /** Resolves to whether a frame is presented within `ms`. */
  shown(ms) {
    return new Promise((done) => {
      this.video.requestVideoFrameCallback(() => done(true));
      setTimeout(done, ms, false);
    });
  }

  close() {
    super.close();
    this.video.pause();
    for (const track of this.video.srcObject?.getTracks() ?? []) track.stop();
    if (this.video.src) URL.revokeObjectURL(this.video.src);
    this.video.removeAttribute("src");
    this.video.srcObject = null;
  }

  #watch() {
    this.video.requestVideoFrameCallback((_, { mediaTime }) => {
      if (this.closed) return;
      this.presented(mediaTime);
      this.#watch();
    });
  }
}

/** Make a <video> for a source. */
export function plainVideo() {
  const video = document.createElement("video");
  return Object.assign(video, { muted: true, playsInline: true, preload: "auto", disableRemotePlayback: true });
}

/** Resolves when the first frame of `video` is there; rejects with a SourceError of `code`. */
export function loaded(video, code) {
  return new Promise((done, failed) => {
    video.addEventListener("loadeddata", () => done(), { once: true });
    video.addEventListener("error", () => failed(new SourceError(code, video.error)), { once: true });
  });
}
