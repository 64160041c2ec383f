// Records the picture with its boxes, as it is shown, as a video file.

import { Film } from "./film.js";
import { paint } from "./overlay.js";

// For browsers that encode no single frames. VP8 first, because it takes the least processor time.
const KINDS = ["video/webm;codecs=vp8", "video/webm", "video/mp4"];
const LEAST_WIDTH = 640;
const BITS_PER_S = 4e6;
const MOST_WAITING = 3; // pictures; more are left out

export class Recorder {
  #canvas = document.createElement("canvas");
  #film = null;
  #chunks = [];
  #recorder = null;
  #waiting = 0;
  #last = -1;

  /** Whether the browser can record. */
  static get possible() {
    return Boolean(globalThis.VideoEncoder || (globalThis.MediaRecorder && HTMLCanvasElement.prototype.captureStream));
  }

  get seconds() {
    return this.running ? (performance.now() - this.since) / 1e3 : 0;
  }

  get running() {
    return this.#film !== null || this.#recorder !== null;
  }

  async start(picture) {
    const scale = Math.max(1, Math.ceil(LEAST_WIDTH / picture.width));
    Object.assign(this.#canvas, { width: (picture.width * scale) & ~1, height: (picture.height * scale) & ~1 });
    this.#canvas.getContext("2d");
    this.#last = -1;
    this.#film = await Film.open(this.#canvas);
    if (!this.#film) this.#capture();
    this.since = performance.now();
  }

  /** Add the present picture. */
  take(picture, scene) {
    if (!this.running || this.#waiting >= MOST_WAITING) return;
    const { width, height } = this.#canvas;
    const context = this.#canvas.getContext("2d");
    context.drawImage(picture, 0, 0, width, height);
    paint(context, { x: 0, y: 0, w: width, h: height }, { ...scene, draft: null, suggestion: null, handles: false }, width / LEAST_WIDTH);
    const time = this.seconds;
    if (!this.#film || time <= this.#last + 1e-3) return;
    this.#last = time;
    this.#waiting++;
    this.#film.add(time, 1 / 30).finally(() => this.#waiting--);
  }

  /** Finish, and resolve to the recording: `{blob, suffix}`. */
  async stop() {
    const [film, recorder] = [this.#film, this.#recorder];
    this.#film = this.#recorder = null;
    if (film) return { blob: await film.finish(), suffix: film.suffix };
    const stopped = new Promise((done) => recorder.addEventListener("stop", done, { once: true }));
    recorder.stop();
    await stopped;
    return { blob: new Blob(this.#chunks, { type: recorder.mimeType }), suffix: recorder.mimeType.includes("mp4") ? "mp4" : "webm" };
  }

  #capture() {
    const mimeType = KINDS.find((kind) => MediaRecorder.isTypeSupported(kind));
    this.#chunks = [];
    this.#recorder = new MediaRecorder(this.#canvas.captureStream(30), { mimeType, videoBitsPerSecond: BITS_PER_S });
    this.#recorder.addEventListener("dataavailable", ({ data }) => data.size && this.#chunks.push(data));
    this.#recorder.start(1000);
  }
}
