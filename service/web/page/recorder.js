// Records the picture with its boxes as a video file, with the browser's encoder.

import { paint } from "./overlay.js";

// VP8 first, because it takes the least processor time.
const KINDS = ["video/webm;codecs=vp8", "video/webm", "video/mp4"];
const LEAST_WIDTH = 640;
const BITS_PER_S = 4e6;

export class Recorder {
  #canvas = document.createElement("canvas");
  #chunks = [];
  #recorder = null;

  /** Whether the browser can record. */
  static get possible() {
    return Boolean(globalThis.MediaRecorder && HTMLCanvasElement.prototype.captureStream);
  }

  get seconds() {
    return this.#recorder ? (performance.now() - this.since) / 1e3 : 0;
  }

  get running() {
    return this.#recorder !== null;
  }

  start(picture) {
    const scale = Math.max(1, Math.ceil(LEAST_WIDTH / picture.width));
    Object.assign(this.#canvas, { width: (picture.width * scale) & ~1, height: (picture.height * scale) & ~1 });
    const mimeType = KINDS.find((kind) => MediaRecorder.isTypeSupported(kind));
    this.#chunks = [];
    this.#recorder = new MediaRecorder(this.#canvas.captureStream(30), { mimeType, videoBitsPerSecond: BITS_PER_S });
    this.#recorder.addEventListener("dataavailable", ({ data }) => data.size && this.#chunks.push(data));
    this.since = performance.now();
    this.#recorder.start(1000);
  }

  /** Add the present picture. */
  take(picture, scene) {
    if (!this.#recorder) return;
    const { width, height } = this.#canvas;
    const context = this.#canvas.getContext("2d");
    context.drawImage(picture, 0, 0, width, height);
    paint(context, { x: 0, y: 0, w: width, h: height }, { ...scene, draft: null, suggestion: null }, width / LEAST_WIDTH);
  }

  /** Finish, and resolve to the recording: `{blob, suffix}`. */
  async stop() {
    const recorder = this.#recorder;
    this.#recorder = null;
    const stopped = new Promise((done) => recorder.addEventListener("stop", done, { once: true }));
    recorder.stop();
    await stopped;
    return { blob: new Blob(this.#chunks, { type: recorder.mimeType }), suffix: recorder.mimeType.includes("mp4") ? "mp4" : "webm" };
  }
}
