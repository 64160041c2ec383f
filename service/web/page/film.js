// Writes a video file from pictures, with the browser's encoder.

import { library } from "./sources/table.js";

const BITS_PER_PIXEL = 4; // a second
const LEAST_BITS = 1e6;
const KEY_FRAME_S = 2;

/** Whether the browser can encode. Pages of plain http cannot. */
export const canFilm = () => typeof VideoEncoder !== "undefined";

/** One file: MP4 with H.264 where the browser has it, else WebM. */
export class Film {
  #output;
  #source;

  constructor(output, source, suffix) {
    this.#output = output;
    this.#source = source;
    this.suffix = suffix;
  }

  /** Begin a file of what `canvas` shows; resolves to null where the browser has no encoder for its size. */
  static async open(canvas) {
    if (!canFilm()) return null;
    const { BufferTarget, CanvasSource, Mp4OutputFormat, Output, WebMOutputFormat, getFirstEncodableVideoCodec } = await library();
    const { width, height } = canvas;
    const bitrate = Math.max(LEAST_BITS, BITS_PER_PIXEL * width * height);
    const codec = await getFirstEncodableVideoCodec(["avc", "vp9", "vp8", "av1"], { width, height, bitrate });
    if (!codec) return null;
    const mp4 = codec === "avc";
    const format = mp4 ? new Mp4OutputFormat({ fastStart: "in-memory" }) : new WebMOutputFormat();
    const output = new Output({ format, target: new BufferTarget() });
    const source = new CanvasSource(canvas, { codec, bitrate, keyFrameInterval: KEY_FRAME_S });
    output.addVideoTrack(source);
    await output.start();
    return new Film(output, source, mp4 ? "mp4" : "webm");
  }

  /** Add what the canvas shows now, at `time` for `lasts` seconds. Resolves when the next picture may come. */
  add(time, lasts) {
    return this.#source.add(time, lasts);
  }

  /** Complete the file; resolves to its Blob. */
  async finish() {
    await this.#output.finalize();
    return new Blob([this.#output.target.buffer], { type: `video/${this.suffix}` });
  }

  async cancel() {
    await this.#output.cancel();
  }
}
