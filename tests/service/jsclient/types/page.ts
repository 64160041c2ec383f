// Type-checked, never run: what people write in pages, and what the types must refuse.
import {
  Client,
  Session,
  Stream,
  VERSION,
  encodeFrame,
  fittedSize,
  regionsByDefault,
  type Box,
  type Result,
  type Size,
  type StreamStatus,
} from "@mfcmt/client";
import { drawBoxes, letterbox, letterboxOf, overlay, type Letterbox } from "@mfcmt/client/view";

export async function page(video: HTMLVideoElement, canvas: HTMLCanvasElement): Promise<void> {
  const client = new Client({ key: "k", timeoutMs: 5000, boxesIn: "source", fetch, WebSocket, workerUrl: new URL("/w.js", location.href) });
  const box: Box = [1, 2, 3, 4];
  const session: Session = await client.createSession({ frame: video, boxes: [box], maxSide: 640, options: { maps: true }, endWithPage: false, signal: new AbortController().signal });
  const stream = session.stream({ mode: "latest", codec: "msgpack", regions: "auto", encoder: "worker" });
  const off = stream.on("status", ({ status, retryInMs, error }) => {
    const now: StreamStatus = status;
    console.log(now, retryInMs?.toFixed(), error?.retryAfter);
  });
  stream.on("problem", (error) => console.log(error.code === "bad-region", error.seq));
  const stop = stream.follow(video, { fps: 30 });
  const seq: number | null = await stream.send(canvas, { ts: "now", whole: true });
  await stream.ready;
  for await (const result of stream) {
    const first: Result = result;
    const map = first.targets[0]?.maps?.["fused"];
    if (map) await createImageBitmap(new Blob([map], { type: "image/png" }));
    if (stream.stats.latencyMs ?? 0 > 100) stream.quality = 0.5;
  }
  const { targets } = await stream.correct(0, box, { onNext: true });
  await Promise.all([stream.add([1, 2, 3, 4]), stream.remove(targets[0]!.id), stream.finish()]);
  off();
  stop();
  console.log(seq, VERSION, regionsByDefault());
}

export async function refused(client: Client): Promise<void> {
  // @ts-expect-error: no such mode
  client.stream("id", { mode: "fastest" });
  // @ts-expect-error: no such event
  client.stream("id").on("results", () => {});
  // @ts-expect-error: a frame is needed
  await client.createSession({ box: [1, 2, 3, 4] });
  // @ts-expect-error: a box is four numbers
  const box: Box = [1, 2, 3];
  const size: Size = fittedSize(1280, 720, 640);
  const image: { blob: Blob; size: Size } = await encodeFrame(new OffscreenCanvas(1, 1), { maxSide: 4 });
  console.log(box, size, image);
}

export function view(video: HTMLVideoElement, stream: Stream): () => void {
  const layer = overlay(video, { label: ({ id, confidence }) => `${id} ${confidence?.toFixed(2)}` });
  stream.on("result", ({ targets, size }) => layer.draw(targets, size));
  const where: Letterbox = letterbox([1280, 720], [300, 300], { fit: "cover" });
  console.log(where.box([1, 2, 3, 4])[2], letterboxOf(video).pointBack([1, 2]), layer.svg.viewBox);
  return drawBoxes(video, (box) => void stream.add(box), { onDraft: layer.draft, signal: new AbortController().signal });
}
