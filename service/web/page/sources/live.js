// Sources that go on by themselves: a camera, and the screen.

import { ElementSource, SourceError, loaded, plainVideo } from "./source.js";

const PRESENT_MS = 3000;

class LiveSource extends ElementSource {
  live = true;
  /** Whether it shows the one who holds it, who expects a mirror. */
  mirrored = false;
  duration = Infinity;

  /** The next frame is the next one that comes. */
  async step() {
    await this.shown(PRESENT_MS);
    return true;
  }

  /** It goes on; the player ignores its frames. */
  pause() {}

  async seek() {}
}

/** Open a camera by its id, or the one that faces the `facing` side. */
export async function openCamera({ deviceId, facing = "environment" } = {}) {
  if (!navigator.mediaDevices?.getUserMedia) throw new SourceError("camera-insecure");
  const which = deviceId ? { deviceId: { exact: deviceId } } : { facingMode: { ideal: facing } };
  const wanted = { width: { ideal: 1280 }, height: { ideal: 720 }, frameRate: { ideal: 30 }, ...which };
  const stream = await asked(() => navigator.mediaDevices.getUserMedia({ video: wanted }), CAMERA_ERRORS, "camera-failed");
  return opened(stream, "camera", "Camera");
}

/** Open the screen, a window or a tab, which the browser asks for. */
export async function openScreen() {
  if (!navigator.mediaDevices?.getDisplayMedia) throw new SourceError("screen-missing");
  const ask = () => navigator.mediaDevices.getDisplayMedia({ video: { frameRate: { ideal: 30 } }, audio: false });
  return opened(await asked(ask, {}, "screen-refused"), "screen", "Screen");
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

async function asked(ask, codes, usual) {
  try {
    return await ask();
  } catch (error) {
    throw new SourceError(codes[error.name] ?? usual, error);
  }
}

async function opened(stream, kind, name) {
  const video = plainVideo();
  video.srcObject = stream;
  await loaded(video, kind === "screen" ? "screen-refused" : "camera-failed");
  const [track] = stream.getVideoTracks();
  const source = new LiveSource(video, { name: track.label || name, kind });
  source.mirrored = track.getSettings().facingMode === "user";
  track.addEventListener("ended", () => source.onend());
  await video.play();
  return source;
}
