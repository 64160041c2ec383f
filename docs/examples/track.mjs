// Track a box through JPEG frames in Node: node track.mjs x,y,w,h FRAME... > boxes.jsonl
// SERVICE is the service's URL, KEY an API key. Node 20 needs a WebSocket (npm install ws), Node 22 has one.
import { readFile } from "node:fs/promises";
import { Client, MFCMTError } from "mfcmt-client";

const WebSocket = globalThis.WebSocket ?? (await import("ws")).WebSocket;
const [box, first, ...rest] = process.argv.slice(2);

async function* images() {
  for (const path of rest) yield readFile(path);
}

const client = new Client({ url: process.env.SERVICE, key: process.env.KEY, WebSocket });
try {
  const session = await client.createSession({ frame: await readFile(first), box: box.split(",") });
  const stream = session.stream({ frames: images(), mode: "lossless", codec: "msgpack" });
  stream.on("status", ({ status, error }) => console.error(status, error?.message ?? ""));
  for await (const { seq, targets } of stream) {
    const [{ box, status, reliable }] = targets;
    console.log(JSON.stringify({ seq, box, status, reliable }));
  }
  await session.close();
} catch (error) {
  if (!(error instanceof MFCMTError)) throw error;
  console.error(error.message);
  process.exitCode = 1;
}
