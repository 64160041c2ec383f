// A React app: a video of the given frames, a box that is drawn on it, targets over it. StrictMode mounts everything twice.
import { Client } from "@mfcmt/client";
import { Overlay, useTracker } from "@mfcmt/client/react";
import { StrictMode, useEffect, useRef } from "react";
import { createRoot } from "react-dom/client";

const given = JSON.parse(decodeURIComponent(location.hash.slice(1)));
const client = new Client({ url: given.service, boxesIn: "source" });

function Camera() {
  const video = useRef(null);
  const tracker = useTracker(client, { session: { maxSide: 240 }, fps: 20 });
  window.tracker = tracker;
  useEffect(() => play(video.current), []);
  return (
    <div style={{ position: "relative" }}>
      <video ref={video} muted autoPlay style={{ width: 600, height: 300, objectFit: "contain" }} />
      <Overlay of={video} targets={tracker.targets} size={tracker.size} onBox={(box) => tracker.start(video.current, box)} />
    </div>
  );
}

function play(video) {
  const canvas = document.createElement("canvas");
  let stopped = false;
  (async () => {
    const pictures = await Promise.all(given.frames.map(async (url) => createImageBitmap(await (await fetch(url)).blob())));
    Object.assign(canvas, { width: pictures[0].width, height: pictures[0].height });
    video.srcObject = canvas.captureStream(20);
    for (let index = 0; !stopped; index = (index + 1) % 20) {
      canvas.getContext("2d").drawImage(pictures[index < 10 ? index : 19 - index], 0, 0);
      await new Promise((resolve) => setTimeout(resolve, 50));
    }
  })();
  return () => (stopped = true);
}

const root = createRoot(document.body.appendChild(document.createElement("main")));
root.render(<StrictMode><Camera /></StrictMode>);
window.unmount = () => root.unmount();
