// What the tests do with the client in a browser: `await run(NAME, particulars)`.
import { Client, MFCMTError, encodeFrame, fittedSize, regionsByDefault } from "/static/client/mfcmt.js";

const violations = [];
document.addEventListener("securitypolicyviolation", (event) => violations.push(event.violatedDirective));

const asData = (error) => {
  if (!(error instanceof MFCMTError)) throw error;
  const { code, status, reason, seq } = error;
  return { code, status, reason, seq };
};
const refusal = (promise) => promise.then(() => ({ code: "not refused" }), asData);
async function loaded(given) {
  const blobs = await Promise.all(given.frames.map(async (url) => (await fetch(url)).blob()));
  const msgpack = given.stream?.codec === "msgpack" ? await import("/msgpack/index.mjs") : undefined;
  const client = new Client({ url: given.url, key: given.key, msgpack, ...given.client });
  return { blobs, client };
}

/** Frames in the form that a front end may have them in. */
async function source(kind, blob, canvas) {
  if (kind === "blob") return blob;
  if (kind === "bytes") return blob.arrayBuffer();
  const bitmap = await createImageBitmap(blob);
  if (kind === "bitmap") return bitmap;
  if (kind === "videoframe") return new VideoFrame(bitmap, { timestamp: 0 });
  if (kind === "offscreen") canvas = new OffscreenCanvas(bitmap.width, bitmap.height);
  canvas.width = bitmap.width;
  canvas.height = bitmap.height;
  const context = canvas.getContext("2d");
  context.drawImage(bitmap, 0, 0);
  return kind === "imagedata" ? context.getImageData(0, 0, canvas.width, canvas.height) : canvas;
}

const scenarios = {
  /** Every frame in the form `kind`. */
  async frames(given) {
    const { blobs, client } = await loaded(given);
    const { kind = "canvas", create = {}, stream: options = {}, transfer = false } = given;
    const session = await client.createSession({ frame: blobs[0], box: given.box, ...create });
    const stream = session.stream({ mode: "lossless", ...options });
    const canvas = document.createElement("canvas");
    const problems = [];
    stream.on("problem", (error) => problems.push(asData(error)));
    const results = stream.results;
    const sending = (async () => {
      for (const blob of blobs.slice(1)) await stream.send(await source(kind, blob, canvas), { transfer });
      await stream.finish();
    })();
    const boxes = [];
    const regions = [];
    for await (const { targets, region } of results) {
      boxes.push(targets[0].box);
      regions.push(region);
    }
    await sending;
    await session.close();
    const { encoder, stats } = stream;
    return { boxes, regions, problems, encoder, stats, violations, size: session.info.size };
  },

  /** A session whose very first frame is pixels, sent smaller than they are. */
  async scaled(given) {
    const { blobs, client } = await loaded(given);
    const { size, maxSide } = given;
    const fitted = fittedSize(...size, maxSide);
    const scale = fitted[0] / size[0];
    const first = await createImageBitmap(blobs[0]);
    const encoded = await encodeFrame(first, { maxSide });
    const session = await client.createSession({ frame: first, maxSide, box: given.box.map((v) => v * scale) });
    const stream = session.stream({ mode: "lossless", regions: false });
    const boxes = [];
    const results = stream.results;
    for (const blob of blobs.slice(1)) {
      await stream.send(await createImageBitmap(blob), { transfer: true });
      boxes.push((await results.next()).value.targets[0].box);
    }
    // Whoever shows the picture larger meanwhile is scaled to the session's frame all the same.
    const larger = await createImageBitmap(blobs[1], { resizeWidth: size[0] * 2, resizeHeight: size[1] * 2 });
    await stream.send(larger);
    const after = (await results.next()).value.size;
    stream.close();
    await session.close();
    return { boxes, fitted, encoded: encoded.size, bytes: encoded.blob.size, scale, size: session.info.size, after };
  },

  /** Follow a camera for `count` results. */
  async follow(given) {
    const video = document.createElement("video");
    video.muted = true;
    video.srcObject = await navigator.mediaDevices.getUserMedia({ video: true });
    await video.play();
    const client = new Client({ url: given.url, msgpack: await import("/msgpack/index.mjs") });
    const session = await client.createSession({ frame: video, box: given.box });
    const stream = session.stream(given.stream);
    const stop = stream.follow(video, { fps: given.fps });
    const seqs = [];
    let boxes = 0;
    const results = stream.results;
    while (seqs.length < given.count) {
      const { seq, targets } = (await results.next()).value;
      seqs.push(seq);
      boxes += targets.length;
    }
    stop();
    const quiet = stream.stats.sent;
    stream.pause();
    const skipped = await stream.send(video);
    stream.resume();
    await stream.ready;
    const taken = await stream.send(video);
    const track = video.srcObject.getVideoTracks()[0];
    const processed = new MediaStreamTrackProcessor({ track }).readable.getReader();
    const { value: frame } = await processed.read();
    await stream.ready;
    const ofTrack = await stream.send(frame, { transfer: true });
    await processed.cancel();
    await stream.finish();
    const { stats, encoder } = stream;
    track.stop();
    await session.close();
    return { seqs, boxes, quiet, skipped, taken, ofTrack, stats, encoder, size: session.info.size, violations };
  },

  /** Regions are on, and a target is added where no cut shows it. */
  async elsewhere(given) {
    const { blobs, client } = await loaded(given);
    const session = await client.createSession({ frame: blobs[0], box: given.box });
    const stream = session.stream({ mode: given.mode, regions: true });
    const results = stream.results;
    const send = async (index) => {
      await stream.ready;
      await stream.send(await createImageBitmap(blobs[index]), { transfer: true });
      return (await results.next()).value;
    };
    const first = await send(1);
    await send(2);
    const added = stream.add(given.other);
    let ids = null;
    added.then(({ targets }) => (ids = targets.map(({ id }) => id)));
    let index = 3;
    while (ids === null && index < blobs.length) await send(index++);
    const both = await send(index);
    const saved = stream.stats.bytesSaved;
    stream.close();
    await session.close();
    return { region: first.region, ids, targets: both.targets.length, union: both.region, saved };
  },

  /** Refused handshakes, as only a browser sees them. */
  async refusals(given) {
    const { blobs, client } = await loaded(given);
    const session = await client.createSession({ frame: blobs[0], box: given.box });
    const standing = session.stream();
    await standing.ready;
    const elsewhere = await refusal(session.stream().closed);
    const taking = session.stream({ takeover: true });
    const taken = await refusal(standing.closed);
    await taking.ready;
    const nobody = await refusal(client.stream("no-such-session").closed);
    const ticket = await refusal(client.stream(session.id, { ticket: "spent" }).closed);
    const broken = document.createElement("canvas");
    broken.width = 0;
    const source = await refusal(taking.send(broken));
    await session.close();
    const closed = await refusal(taking.closed);
    const gone = await refusal(session.stream().closed);
    return { elsewhere, taken, nobody, ticket, source, closed, gone };
  },

  /** Frames of a loop until `count` results have come; the test cuts the cable meanwhile. */
  async resumed(given) {
    const { blobs, client } = await loaded(given);
    const session = await client.createSession({ frame: blobs[0], box: given.box });
    const stream = session.stream({ stallMs: 2000, ...given.stream });
    const statuses = [];
    stream.on("status", ({ status, retryInMs }) => {
      statuses.push(status);
      if (status === "resuming" && retryInMs === null) throw new Error("when?");
    });
    const boxes = [];
    stream.on("result", ({ seq, targets }) => {
      boxes.push([seq, targets[0].box]);
      window.results = boxes.length;
    });
    const canvas = document.createElement("canvas");
    const pixels = given.kind === "canvas";
    for (const blob of blobs.slice(1)) {
      if (stream.mode === "latest") await stream.ready;
      await stream.send(pixels ? await source("canvas", blob, canvas) : blob);
      await new Promise((resolve) => setTimeout(resolve, given.everyMs));
    }
    await stream.finish();
    const info = await session.refresh();
    await session.close();
    return { boxes, statuses, stats: stream.stats, seq: info.seq };
  },

  byDefault: async () => regionsByDefault(),
};

window.run = (name, given) => scenarios[name](given);
window.up = true;
