// A video file in a <video>, moved by seeking: for browsers that decode no single frames, and files that they cannot.

import { ElementSource, SourceError, loaded, plainVideo } from "./source.js";
import { at, nearest } from "./times.js";

const PRESENT_MS = 1500;
const HIDDEN_MS = 50; // a hidden page presents nothing
const PLACES = [0.5, 0.2, 0.8, 0.02]; // within a frame, to seek to: browsers round times in ways of their own
const SLOW = 0.25;
const LEAST_S = 1 / 120;
const SHORT_S = 0.25;
const LONGEST_S = 60;

/**
 * With the frames' `table` (see table.js), numbers and times are those of the file, and a frame is found by seeking to
 * its middle. Without it, nothing is known but the time that the browser tells of a presented frame.
 */
export class SeekingSource extends ElementSource {
  #table;
  #shift = 0; // of the browser's times from the table's
  #searching = false;
  #last = -1; // the media time that was presented last

  constructor(video, about, table) {
    super(video, about);
    this.#table = table;
    this.count = table?.times.length ?? null;
    this.times = table?.times ?? null;
  }

  get duration() {
    return this.#table?.duration ?? this.video.duration;
  }

  pause() {
    this.video.pause();
  }

  /** Show the first frame, and learn from it how the browser's times differ from the file's. */
  async begin() {
    await this.#seek(0);
    this.#shift = this.#table ? Math.max(0, this.#last) - this.#table.times[0] : 0;
    this.presented(Math.max(0, this.#last));
  }

  presented(time) {
    this.#last = time;
    if (this.#table) {
      this.index = nearest(this.#table.times, time - this.#shift);
      this.time = this.#table.times[this.index];
    } else {
      this.time = time;
    }
    if (!this.#searching) this.onframe();
  }

  seek(time) {
    if (this.#table) return this.show(at(this.#table.times, time));
    return this.#found(() => this.#seek(time));
  }

  show(index) {
    const wanted = Math.min(Math.max(index, 0), this.count - 1);
    return this.#found(async () => {
      for (const part of PLACES) {
        await this.#seekInto(wanted, part);
        if (this.index === wanted) return;
      }
      if (this.index > wanted) await this.#playTo(wanted);
    });
  }

  /** Show the next frame. Resolves to false at the end. */
  async step() {
    if (!this.#table) return this.#found(() => this.#forward());
    const before = this.index;
    for (let next = before + 1; next < this.count; next++) {
      await this.show(next);
      if (this.index > before) return true;
    }
    return false;
  }

  /** Search for a frame, and show none but the one that was found. */
  async #found(search) {
    this.#searching = true;
    try {
      return await search();
    } finally {
      this.#searching = false;
      if (!this.closed) this.onframe();
    }
  }

  #seekInto(index, part) {
    const { times, duration } = this.#table;
    const end = times[index + 1] ?? Math.max(duration, times[index] + 1 / this.fps);
    return this.#seek(times[index] + (end - times[index]) * part + this.#shift);
  }

  /** Play from the frame before: where frames are reordered, Chromium cannot seek to the last one before a key frame. */
  async #playTo(wanted) {
    for (let from = wanted - 1; from >= 0; from--) {
      await this.#seekInto(from, 0.5);
      if (this.index < wanted) break;
    }
    this.video.playbackRate = SLOW;
    await this.play();
    while (this.index < wanted && (await this.shown(PRESENT_MS)));
    this.video.pause();
    this.video.playbackRate = 1;
  }

  /** Go on until another frame is presented, in steps that are shorter than a frame: how long one lasts is not known. */
  async #forward() {
    const before = this.#last;
    const end = Number.isFinite(this.video.duration) ? this.video.duration : Infinity;
    for (let far = LEAST_S; far < LONGEST_S; far += far < SHORT_S ? LEAST_S : far / 4) {
      await this.#seek(Math.min(before + far, end));
      if (this.#last > before + 1e-4) return true;
      if (before + far >= end || this.video.ended) return false;
    }
    return false;
  }

  async #seek(time) {
    const { video } = this;
    const seeked = new Promise((done) => video.addEventListener("seeked", done, { once: true }));
    const presented = this.shown(document.hidden ? HIDDEN_MS : PRESENT_MS);
    video.currentTime = time;
    await Promise.all([seeked, presented]); // nothing is presented where it is the same frame as before
  }
}

/** Open a blob as such a source. */
export async function openSeeking(blob, about, table) {
  const video = plainVideo();
  video.src = URL.createObjectURL(blob);
  await loaded(video, "video-unreadable");
  if (!video.videoWidth) throw new SourceError("video-unreadable");
  const source = new SeekingSource(video, { ...about, ...(table && { fps: table.fps }) }, table);
  await source.begin();
  return source;
}
