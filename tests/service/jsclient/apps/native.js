// The same in React Native: frames are encoded images. What an app imports; the test runs it with React Native's globals.
import { Client } from "@mfcmt/client";
import { letterbox } from "@mfcmt/client/view";

globalThis.track = async ({ service, key, frames, box }) => {
  const client = new Client({ url: service, key });
  const session = await client.createSession({ frame: frames[0], box, options: { label: "Grüße" } });
  const one = await session.track(frames[1], { ts: 17.5 });
  const stream = session.stream({ mode: "lossless", frames: frames.slice(2) });
  const boxes = [one.targets[0].box];
  for await (const { targets } of stream) boxes.push(targets[0].box);
  await session.close();
  return { boxes, ts: one.ts, label: session.info.label, area: letterbox([200, 100], [100, 100]).area };
};
