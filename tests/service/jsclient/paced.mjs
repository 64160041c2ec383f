// A lossless stream of our client at a steady pace, until the standard input ends:
// node paced.mjs '{"url": ..., "key": ..., "folder": ..., "count": ..., "box": [...], "fps": ..., "patience_s": ...}'
// Prints lines of JSON: {"sent": index}, {"index": ..., "targets": [[x, y, w, h, status], ...]}, {"lost_after": seq},
// {"refused": code}, at last {"error": text or null}.
import { readFile } from "node:fs/promises";
import { WebSocket } from "ws";
import { Client } from "../../../service/web/client/mfcmt.js";

const { url, key, folder, count, box, fps, patience_s } = JSON.parse(process.argv[2]);
const say = (line) => process.stdout.write(`${JSON.stringify(line)}\n`);
const images = await Promise.all([...Array(count).keys()].map((at) => readFile(`${folder}/${at}.jpg`)));
let over = false;
process.stdin.on("end", () => (over = true)).resume();

let error = null;
try {
  const client = new Client({ url, key, WebSocket });
  const session = await client.createSession({ frame: images[0], box });
  const stream = session.stream({ mode: "lossless", reconnectForMs: patience_s * 1000 });
  stream.on("resumed", ({ lostAfter }) => lostAfter === null || say({ lost_after: lostAfter }));
  stream.on("problem", ({ code }) => say({ refused: code }));
  stream.on("result", ({ ts, targets }) => {
    say({ index: ts, targets: targets.map((target) => [...target.box, target.status]) });
  });
  for (let index = 0; !over; index++) {
    const at = (index + 1) % (2 * count - 2);
    say({ sent: index });
    await stream.send(images[Math.min(at, 2 * count - 2 - at)], { ts: index });
    await new Promise((go) => setTimeout(go, 1000 / fps));
  }
  await stream.finish();
} catch (failed) {
  error = String(failed);
}
say({ error });
process.exit();
