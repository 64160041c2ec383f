// Follows a box through the frames of a film with the client in Node, and prints the seconds that it took.
// usage: node cost.mjs CLIENT URL FILM FRAMES x,y,w,h

import { spawn } from "node:child_process";
import { createRequire } from "node:module";
import { pathToFileURL } from "node:url";

const [client, url, film, frames, box] = process.argv.slice(2);
const { WebSocket } = createRequire(new URL("../service/jsclient/", import.meta.url))("ws"); // older Nodes have none
const { Client } = await import(pathToFileURL(client).href);

/** The JPEG images that ffmpeg makes of the film. */
async function* images() {
  const ffmpeg = spawn("ffmpeg", ["-v", "error", "-i", film, "-f", "image2pipe", "-c:v", "mjpeg", "-q:v", "4", "-"], { stdio: ["ignore", "pipe", "inherit"] });
  let rest = Buffer.alloc(0);
  for await (const chunk of ffmpeg.stdout) {
    rest = Buffer.concat([rest, chunk]);
    for (let end; (end = rest.indexOf("\xff\xd9", 0, "latin1")) >= 0; rest = rest.subarray(end + 2)) yield rest.subarray(0, end + 2);
  }
}

const began = performance.now();
const pictures = images();
const { value: first } = await pictures.next();
const session = await new Client({ url, WebSocket }).createSession({ frame: first, box: box.split(",").map(Number) });
let count = 1;
for await (const _ of session.stream({ mode: "lossless", frames: pictures })) count++;
await session.close();
if (count !== Number(frames)) throw new Error(`${count} results instead of ${frames}`);
console.log((performance.now() - began) / 1000);
