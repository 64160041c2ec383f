// Type-checked, never run: what people write in React.
import { Client } from "@mfcmt/client";
import { Overlay, useTracker } from "@mfcmt/client/react";
import * as msgpack from "@msgpack/msgpack";
import { useRef, type ReactElement } from "react";

const client = new Client({ boxesIn: "source", msgpack });

export function Camera(): ReactElement {
  const video = useRef<HTMLVideoElement>(null);
  const tracker = useTracker(client, { session: { maxSide: 640 }, stream: { mode: "latest" }, fps: 30 });
  const start = (box: [number, number, number, number]) => void tracker.start(video.current!, box);
  // @ts-expect-error: a frame comes first
  void tracker.start([1, 2, 3, 4]);
  return (
    <div style={{ position: "relative" }}>
      <video ref={video} muted autoPlay playsInline />
      <Overlay of={video} targets={tracker.targets} size={tracker.size} onBox={start} label={({ id }) => `${id}`} className="boxes" />
      <p>{tracker.error?.message ?? tracker.status}</p>
    </div>
  );
}
