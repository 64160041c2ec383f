// Sources of pictures: a camera, a video file, the sample clip. Each is a <video> that is not shown itself.

const RATES = [10, 12, 15, 20, 23.976, 24, 25, 29.97, 30, 48, 50, 59.94, 60, 120];
const PRESENT_MS = 3000;
const HIDDEN_MS = 50; // a hidden page presents nothing

/** A source failed; `problems.js` explains `code`. */
export class SourceError extends Error {
  constructor(code, cause) {
    super(code, { cause });
    this.code = code;
  }
}

/** The frames of one <video>. `onframe` is called for each frame, `onend` after the last one. */
export class Source {
  onframe = () => {};
  onend = () => {};
  time = 0;

  constructor(video, { name, kind, fps = 30, loop = false, suggestion = null }) {
    Object.assign(this, { video, name, kind, fps, loop, suggestion, live: kind === "camera" });
    video.loop = loop;
    video.addEventListener("ended", () => this.onend());
    this.#watch();
  }

  get size() {
    return [this.video.videoWidth, this.video.videoHeight];
  }

  get duration() {
    return this.live ? Infinity : this.video.duration;
  }

  async play() {
    try {
      await this.video.play();
    } catch (error) {
      if (error.name !== "AbortError") throw error; // paused before it began
    }
  }

  /** Pause a file. A camera goes on; the player ignores its frames. */
  pause() {
    if (!this.live) this.video.pause();
  }

  /** Show the next frame. Resolves to false at the end. */
  async step() {
    if (this.live) {
      await this.#presented();
      return true;
    }
    const next = this.time + 1.5 / this.fps; // the middle of the next frame
    if (next < this.duration) await this.seek(next);
    else if (this.loop) await this.seek(0);
    else return false;
    return true;
  }

  async seek(time) {
    const seeked = new Promise((done) => this.video.addEventListener("seeked", done, { once: true }));
    const presented = this.#presented();
    this.video.currentTime = time;
    await seeked;
    if (!(await presented)) {
      this.time = this.video.currentTime;
      this.onframe();
    }
  }

  close() {
    this.onframe = this.onend = () => {};
    this.video.pause();
    for (const track of this.video.srcObject?.getTracks() ?? []) track.stop();
    if (this.video.src) URL.revokeObjectURL(this.video.src);
    this.video.removeAttribute("src");
    this.video.srcObject = null;
    this.closed = true;
  }

  #watch() {
    this.video.requestVideoFrameCallback((_, { mediaTime }) => {
      if (this.closed) return;
      this.time = mediaTime;
      this.onframe();
      this.#watch();
    });
  }

  /** Resolves to whether a frame is shown soon. */
  #presented() {
    return new Promise((done) => {
      this.video.requestVideoFrameCallback(() => done(true));
      setTimeout(() => done(false), document.hidden ? HIDDEN_MS : PRESENT_MS);
    });
  }
}

/** Open a camera by its id, or the one that faces the `facing` side. */
export async function openCamera({ deviceId, facing = "environment" } = {}) {
  if (!navigator.mediaDevices?.getUserMedia) throw new SourceError("camera-insecure");
  const which = deviceId ? { deviceId: { exact: deviceId } } : { facingMode: { ideal: facing } };
  let stream;
  try {
    const wanted = { width: { ideal: 1280 }, height: { ideal: 720 }, frameRate: { ideal: 30 }, ...which };
    stream = await navigator.mediaDevices.getUserMedia({ video: wanted });
  } catch (error) {
    throw new SourceError(CAMERA_ERRORS[error.name] ?? "camera-failed", error);
  }
  const video = plain();
  video.srcObject = stream;
  await loaded(video, "camera-failed");
  const [track] = stream.getVideoTracks();
  const source = new Source(video, { name: track.label || "Camera", kind: "camera" });
  track.addEventListener("ended", () => source.onend());
  await video.play();
  return source;
}

const CAMERA_ERRORS = {
  NotAllowedError: "camera-refused",
  SecurityError: "camera-refused",
  NotFoundError: "camera-missing",
  OverconstrainedError: "camera-missing",
  NotReadableError: "camera-busy",
  AbortError: "camera-busy",
};

/** List the cameras. Without permission they have no names. */
export async function cameras() {
  const devices = (await navigator.mediaDevices?.enumerateDevices?.()) ?? [];
  return devices.filter(({ kind, deviceId }) => kind === "videoinput" && deviceId);
}

export async function openFile(file) {
  const video = await fromBlob(file);
  const fps = await measuredRate(video);
  return ready(new Source(video, { name: file.name, kind: "file", fps }));
}

/** Open the sample clip, with the box of its balloon as a suggestion. */
export async function openSample() {
  const answers = await Promise.all([fetch("/static/page/sample.webm"), fetch("/static/page/sample.json")]);
  if (!answers.every((answer) => answer.ok)) throw new SourceError("sample-missing");
  const { fps, box, size } = await answers[1].json();
  const video = await fromBlob(await answers[0].blob());
  const suggestion = [box[0] / size[0], box[1] / size[1], box[2] / size[0], box[3] / size[1]];
  return ready(new Source(video, { name: "Sample clip", kind: "sample", fps, loop: true, suggestion }));
}

/** Resolves when the first frame can be drawn on. */
async function ready(source) {
  await source.seek(0);
  return source;
}

function plain() {
  const video = document.createElement("video");
  return Object.assign(video, { muted: true, playsInline: true, preload: "auto", disableRemotePlayback: true });
}

async function fromBlob(blob) {
  const video = plain();
  video.src = URL.createObjectURL(blob);
  await loaded(video, "video-unreadable");
  if (!video.videoWidth) throw new SourceError("video-unreadable");
  return video;
}

function loaded(video, code) {
  return new Promise((done, failed) => {
    video.addEventListener("loadeddata", () => done(), { once: true });
    video.addEventListener("error", () => failed(new SourceError(code, video.error)), { once: true });
  });
}

/** Estimate frames per second from the times of the first few frames. */
async function measuredRate(video) {
  const times = [];
  const enough = new Promise((done) => {
    const note = (_, { mediaTime }) => {
      times.push(mediaTime);
      if (times.length > 10) done();
      else video.requestVideoFrameCallback(note);
    };
    video.requestVideoFrameCallback(note);
    video.addEventListener("ended", () => done(), { once: true });
    setTimeout(done, 1000);
  });
  await video.play();
  await enough;
  video.pause();
  const gaps = times.slice(1).map((time, i) => time - times[i]).filter((gap) => gap > 1e-3);
  if (!gaps.length) return 30;
  const shortest = Math.min(...gaps); // a frame that was not shown makes a gap longer, never shorter
  return RATES.reduce((best, rate) => (Math.abs(rate * shortest - 1) < Math.abs(best * shortest - 1) ? rate : best));
}
