// Track a box through JPEG frames in Node: node track.mjs x,y,w,h FRAME... > boxes.jsonl
// SERVICE is the service's URL, KEY an API key. Node 20 needs a WebSocket (npm install ws), Node 22 has one.
import { readFile } from "node:fs/promises";

const fail = (text) => {
  console.error(text);
  process.exit(1);
};
const version = process.versions.node;
if (parseInt(version) < 20) fail(`Node 20 or newer is needed; this is ${version}`);
const [box, first, ...rest] = process.argv.slice(2);
if (!rest.length) fail("node track.mjs x,y,w,h FRAME FRAME...");

const SERVICE = process.env.SERVICE ?? "http://127.0.0.1:8000";
const load = (name, from = name) => import(name).catch((error) => fail(`${error.message}\nnpm install ${from}`));
const { Client, MFCMTError } = await load("@mfcmt/client", `${SERVICE}/static/mfcmt-client.tgz`);
const WebSocket = globalThis.WebSocket ?? (await load("ws")).WebSocket;

async function* images() {
  for (const path of rest) yield readFile(path);
}

const client = new Client({ url: SERVICE, key: process.env.KEY, WebSocket });
try {
  const session = await client.createSession({ frame: await readFile(first), box: box.split(",").map(Number) });
  const stream = session.stream({ frames: images(), mode: "lossless" });
  stream.on("status", ({ status, error }) => console.error(status, error?.message ?? ""));
  for await (const { seq, targets } of stream) {
    const [{ box, status, reliable }] = targets;
    console.log(JSON.stringify({ seq, box, status, reliable }));
  }
  await session.close();
} catch (error) {
  if (!(error instanceof MFCMTError) && error.code !== "ENOENT") throw error;
  fail(error.message);
}
