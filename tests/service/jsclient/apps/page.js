// A small app as somebody builds it: tracks the frames that the address names and keeps what came of it.
import { Client } from "@mfcmt/client";
import { letterbox } from "@mfcmt/client/view";

async function main() {
  const given = JSON.parse(decodeURIComponent(location.hash.slice(1)));
  const workerUrl = typeof WORKER_URL === "string" ? WORKER_URL : undefined; // which the build defines, or does not
  const client = new Client({ url: given.service, boxesIn: "source", workerUrl });
  const pictures = await Promise.all(given.frames.map(async (url) => createImageBitmap(await (await fetch(url)).blob())));
  const session = await client.createSession({ frame: pictures[0], box: given.box });
  const stream = session.stream({ mode: "lossless" });
  const boxes = [];
  const sending = (async () => {
    for (const picture of pictures.slice(1)) await stream.send(picture);
    await stream.finish();
  })();
  for await (const { targets } of stream) boxes.push(targets[0].box);
  await sending;
  await session.close();
  const { area } = letterbox([200, 100], [100, 100]);
  return { boxes, encoder: stream.encoder, area };
}

main().then(
  (report) => (window.report = report),
  (error) => (window.report = { error: String(error) }),
);
