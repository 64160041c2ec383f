// Type-checked, never run: what people write with the client, and what the types must refuse.
import {
  Client,
  MFCMTError,
  Session,
  VERSION,
  encodeFrame,
  fittedSize,
  regionsByDefault,
  type Box,
  type Result,
  type Size,
  type StreamStatus,
} from "mfcmt-client";

export async function page(video: HTMLVideoElement, canvas: HTMLCanvasElement): Promise<void> {
  const client = new Client({ key: "k", timeoutMs: 5000 });
  const box: Box = [1, 2, 3, 4];
  const session: Session = await client.createSession({ frame: video, boxes: [box], maxSide: 640, options: { maps: true } });
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

export async function node(frames: AsyncIterable<Uint8Array>, WebSocket: typeof globalThis.WebSocket): Promise<string> {
  const client = new Client({ url: "http://127.0.0.1:8000", WebSocket });
  try {
    const session = await client.getSession("id");
    const past = await session.trajectory({ after: 3 });
    console.log(past[0]?.targets[0]?.scores?.fused);
    for await (const { timing } of session.stream({ frames, mode: "lossless" })) console.log(timing?.track_ms);
    const restored = await client.restoreSession(await session.snapshot());
    await client.deleteSession(restored.id);
    return await session.trajectory({ format: "csv" });
  } catch (error) {
    if (error instanceof MFCMTError && error.code === "at-capacity") return `again in ${error.retryAfter} s`;
    throw error;
  }
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
