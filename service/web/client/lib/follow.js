/** Sends what a video shows. */

const TOLERANCE_MS = 4; // displays and cameras are not quite in step

/** Send each frame that `video` shows, at most `fps` a second; returns the function that stops it. */
export function follow(stream, video, { fps = Infinity }, { skip, fail }) {
  const presented = typeof video.requestVideoFrameCallback === "function";
  let lastAt = -Infinity;
  let lastTime = -1;
  let handle = 0;
  let stopped = false;

  const next = () => {
    if (stopped) return;
    handle = presented ? video.requestVideoFrameCallback(shown) : requestAnimationFrame(shown);
  };
  const stop = () => {
    stopped = true;
    if (presented) video.cancelVideoFrameCallback(handle);
    else cancelAnimationFrame(handle);
  };
  const shown = () => {
    if (stopped || stream.status === "closed") return;
    next();
    const now = performance.now();
    const fresh = presented || video.currentTime !== lastTime;
    if (!fresh || video.readyState < 2 || now - lastAt < 1000 / fps - TOLERANCE_MS) return;
    lastTime = video.currentTime;
    if (!stream.canSend) return void skip();
    lastAt = now;
    stream.send(video).catch((error) => {
      stop();
      fail(error);
    });
  };
  next();
  return stop;
}
