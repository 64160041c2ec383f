// What the tests do with the client in Node: `node scenarios.mjs NAME`, particulars as JSON on stdin, JSON lines out.
import { readFile } from "node:fs/promises";
import * as msgpack from "@msgpack/msgpack";
import { WebSocket as NodeWebSocket } from "ws";
import { Client, MFCMTError } from "../../../service/web/client/mfcmt.js";

const given = JSON.parse(await new Response(process.stdin).text());
const tell = (told) => process.stdout.write(JSON.stringify(told) + "\n");
const frames = await Promise.all((given.frames ?? []).map((path) => readFile(path)));
const client = new Client({
  url: given.url,
  key: given.key,
  timeoutMs: given.timeoutMs ?? 20_000,
  WebSocket: globalThis.WebSocket ?? NodeWebSocket,
  msgpack,
});
const create = (more = {}) => client.createSession({ frame: frames[0], box: given.box, ...more });
const sleep = (ms) => new Promise((resolve) => setTimeout(resolve, ms));
const asData = (error) => {
  if (!(error instanceof MFCMTError)) throw error;
  const { code, status, type, title, retryAfter, reason, region, seq, detail } = error;
  return { code, status, type, title, retryAfter, reason, region, seq, detail };
};
const refusal = async (promise) => {
  try {
    await promise;
  } catch (error) {
    return asData(error);
  }
  throw new Error("was not refused");
};
async function* paced(list, fps) {
  for (const frame of list) {
    yield frame;
    await sleep(1000 / fps);
  }
}

const scenarios = {
  /** All results of a stream over the frames. */
  async stream() {
    const session = await create({ options: given.options });
    const { fps, ...options } = given.stream;
    const source = frames.slice(1);
    const stream = session.stream({ ...options, frames: fps ? paced(source, fps) : source });
    const statuses = [];
    stream.on("status", ({ status, error }) => {
      statuses.push(status);
      tell({ status, error: error?.code });
    });
    const resumed = [];
    stream.on("resumed", (told) => resumed.push(told));
    const results = [];
    for await (const result of stream) {
      results.push(result);
      if (results.length % 10 === 0) tell({ results: results.length });
      for (const target of result.targets) {
        for (const [name, png] of Object.entries(target.maps ?? {})) {
          if (!(png instanceof Uint8Array)) throw new Error(`${name} is not bytes`);
          target.maps[name] = Buffer.from(png).toString("base64");
        }
      }
    }
    await stream.closed;
    const info = await session.refresh();
    await session.close();
    return { results, statuses, resumed, stats: stream.stats, seq: info.seq, size: session.info.size };
  },

  /** Frames of a session that exists, which another node may have. */
  async attached() {
    const { fps, ...options } = given.stream;
    const stream = client.stream(given.session, { ...options, frames: paced(frames.slice(1), fps) });
    const resumed = [];
    stream.on("resumed", (told) => resumed.push(told));
    const seqs = [];
    for await (const { seq } of stream) {
      seqs.push(seq);
      tell({ seq });
    }
    await stream.closed;
    const session = await client.getSession(given.session);
    return { seqs, resumed, url: session.info.stream.url };
  },

  /** Frames as fast as they can be handed over, without waiting for anything. */
  async flood() {
    const session = await create();
    const stream = session.stream(given.stream);
    const seqs = [];
    stream.on("result", ({ seq }) => seqs.push(seq));
    await stream.ready;
    const sent = await Promise.all(frames.slice(1).map((frame) => stream.send(frame)));
    const most = Math.max(...sent.filter((seq) => seq !== null));
    await stream.finish();
    await session.close();
    return { sent, seqs, most, stats: stream.stats };
  },

  /** The reader rests: the sender has to as well. */
  async unread() {
    const session = await create();
    const stream = session.stream({ mode: "lossless" });
    const results = stream.results;
    let handed = 0;
    const sending = (async () => {
      for (let i = 0; i < given.count; i += 1) {
        await stream.send(frames[1 + (i % (frames.length - 1))]);
        handed += 1;
      }
      await stream.finish();
    })();
    // Everything that is under way arrives, and then nothing moves any more.
    for (let before = -1; before !== handed || stream.stats.inFlight; await sleep(300)) before = handed;
    const resting = { handed, canSend: stream.canSend };
    const seqs = [];
    for await (const { seq } of results) seqs.push(seq);
    await sending;
    await session.close();
    return { resting, seqs };
  },

  async controls() {
    const session = await create();
    const stream = session.stream({ mode: "lossless", codec: given.codec });
    const told = [];
    stream.on("targets", ({ targets }) => told.push(targets.map(({ id }) => id)));
    const added = await stream.add(given.box);
    const refused = await refusal(stream.correct(9, given.box));
    const results = stream.results;
    let early = true;
    const corrected = stream.correct(0, given.box, { onNext: true }).then((answer) => ((early = false), answer));
    await sleep(100);
    const waited = early;
    await stream.send(frames[1], { ts: "mark" });
    const { value: result } = await results.next();
    const answer = await corrected;
    const removed = await stream.remove(0);
    await session.addTarget(given.box);
    const problems = [];
    stream.on("problem", (error) => problems.push(asData(error)));
    await stream.send(Buffer.from("no image"));
    await stream.send(frames[2].subarray(0, frames[2].length - 200));
    await stream.send(frames[2]);
    const { value: after } = await results.next();
    stream.close();
    const ended = await refusal(stream.send(frames[3]));
    const last = await results.next();
    await session.close();
    const ids = (message) => message.targets.map(({ id }) => id);
    return {
      added: ids(added),
      refused,
      waited,
      result,
      corrected: answer.targets[0].box,
      removed: ids(removed),
      told,
      problems,
      after: after.seq,
      ended,
      done: last.done,
      status: stream.status,
    };
  },

  /** Every call over HTTP. */
  async calls() {
    const session = await create({ options: { label: "from node", preset: "default" } });
    const result = await session.track(frames[1], { ts: 17.5 });
    const added = await session.addTarget(given.box);
    const corrected = await session.correctTarget(0, given.box);
    await session.removeTarget(added.target.id);
    const again = await client.getSession(session.id);
    const listed = [];
    for await (const { id } of client.sessions()) listed.push(id);
    const trajectory = await session.trajectory();
    const later = await session.trajectory({ after: 0 });
    const texts = {};
    for (const format of ["csv", "otb", "mot"]) texts[format] = await session.trajectory({ format, target: 0 });
    const snapshot = await session.snapshot();
    const restored = await client.restoreSession(snapshot);
    const [one, other] = [await session.track(frames[2]), await restored.track(frames[2])];
    const ticket = await session.ticket(20);
    const capabilities = await client.capabilities();
    await restored.close();
    await client.deleteSession(session.id);
    await client.deleteSession(session.id);
    const gone = await refusal(session.track(frames[3]));
    const goneStream = await refusal(session.stream({ mode: "lossless" }).closed);
    return {
      id: session.id,
      info: session.info,
      result,
      added,
      corrected,
      again: again.info,
      listed,
      trajectory,
      later,
      texts,
      restored: restored.info,
      one: one.targets,
      other: other.targets,
      ticket,
      capabilities,
      gone,
      goneStream,
    };
  },

  async problems() {
    const key = "same-key-0123456789";
    const first = await create({ idempotencyKey: key });
    const second = await create({ idempotencyKey: key });
    const took = first.stream({ mode: "lossless" });
    await took.ready;
    const told = {
      same: first.id === second.id,
      box: await refusal(create({ box: [5000, 5000, 10, 10] })),
      option: await refusal(create({ options: { nonsense: 1 } })),
      image: await refusal(create({ frame: Buffer.from("no image") })),
      session: await refusal(client.getSession("no-such-session")),
      stream: await refusal(client.stream("no-such-session").closed),
      target: await refusal(first.correctTarget(7, given.box)),
      snapshot: await refusal(client.restoreSession(new Uint8Array(100))),
      elsewhere: await refusal(second.stream({ reconnectForMs: 3000 }).closed),
      source: await refusal(took.send("text")),
      away: await refusal(new Client({ url: "http://127.0.0.1:9", timeoutMs: 2000 }).getSession("x")),
    };
    const abort = new AbortController();
    const patient = second.stream({ signal: abort.signal, takeover: true });
    told.takenOver = await refusal(took.closed);
    await patient.ready;
    abort.abort();
    told.aborted = await refusal(patient.closed);
    await first.close();
    return told;
  },

  async full() {
    const session = await create();
    const refused = await refusal(create({ waitMs: 0 }));
    const abort = new AbortController();
    const aborting = refusal(create({ signal: abort.signal }));
    setTimeout(() => abort.abort(), 200);
    const aborted = await aborting;
    let waited = true;
    const waiting = create().then((made) => ((waited = false), made));
    await sleep(300);
    const still = waited;
    await session.close();
    const second = await waiting;
    await second.close();
    return { refused, aborted, waited: still, got: second.info.seq };
  },

  /** Loops that are left: by break, by an exception. */
  async left() {
    const session = await create();
    const statuses = [];
    for (let round = 0; round < 3; round += 1) {
      const stream = session.stream({ frames: paced(frames.slice(1), 200), mode: round ? "latest" : "lossless" });
      try {
        for await (const { seq } of stream) {
          if (round === 1) throw new RangeError("left");
          if (seq > 0) break;
        }
      } catch (error) {
        if (!(error instanceof RangeError)) throw error;
      }
      statuses.push(stream.status);
      const { targets } = await session.track(frames[20]);
      statuses.push(targets[0].status);
    }
    const seqs = [];
    for await (const { seq } of session.stream({ frames: frames.slice(20, 23), mode: "lossless" })) seqs.push(seq);
    let tries = 100; // the service learns of the end by another connection than the one of this question
    while ((await session.refresh()).stream.attached && tries > 0) {
      tries -= 1;
      await sleep(20);
    }
    await session.close();
    return { statuses, count: seqs.length, attached: tries === 0 };
  },

  /** What is given wrongly, told before anything is sent. */
  async arguments() {
    const wrong = async (make) => refusal((async () => make())());
    const told = {};
    for (const url of given.urls) told[url] = await wrong(() => new Client({ url }));
    const right = given.right.map((url) => new Client({ url }).url);
    const session = await create();
    const stream = session.stream();
    await stream.ready;
    const boxes = [
      create({ box: "129,80,64,78" }),
      create({ box: [1, 2, 3] }),
      create({ boxes: [1, 2, 3, 4] }),
      session.addTarget("1,2,3,4"),
      session.correctTarget(0, ["a", 2, 3, 4]),
      stream.add("1,2,3,4"),
      stream.correct(0, null),
    ];
    const refusals = [];
    for (const box of boxes) refusals.push(await refusal(box));
    stream.close();
    await session.close();
    const key = await wrong(() => new Client({ key: "from-a-file\n" }));
    const boxesIn = await wrong(() => new Client({ boxesIn: "screen" }));
    const codec = await wrong(() => new Client({ url: given.url, WebSocket: NodeWebSocket }).stream("x", { codec: "msgpack" }));
    return { urls: told, right, key, boxesIn, codec, boxes: refusals };
  },

  /** The key is the back-end's; the stream gets along with tickets. */
  async tickets() {
    const session = await create();
    const page = new Client({ url: given.url, WebSocket: globalThis.WebSocket ?? NodeWebSocket });
    const stranger = await refusal(page.getSession(session.id));
    let handed = 0;
    const ticket = async () => ((handed += 1), (await session.ticket()).ticket);
    const stream = page.stream(session.id, { ticket, mode: "lossless", reconnectForMs: 20_000 });
    stream.on("status", ({ status }) => tell({ status }));
    const results = stream.results;
    await stream.send(frames[1]);
    const { value: before } = await results.next();
    tell({ cut: true });
    await new Promise((resolve) => stream.on("status", ({ status }) => status === "open" && resolve()));
    await stream.send(frames[2]);
    const { value: after } = await results.next();
    stream.close();
    const own = session.stream({ mode: "lossless" });
    await own.send(frames[3]);
    const { value: keyed } = await own.results.next().catch(refusal);
    own.close();
    let spoilt = 0;
    class Forgotten extends NodeWebSocket {
      constructor(url, protocols, ...more) {
        super(url, spoilt++ ? protocols : protocols.map((name) => name.replace(/^mfcmt\.ticket\..*/, "mfcmt.ticket.unknown")), ...more);
      }
    }
    const keyHolder = new Client({ url: given.url, key: given.key, WebSocket: Forgotten });
    const renewed = keyHolder.stream(session.id, { mode: "lossless" });
    await renewed.send(frames[1]);
    const { value: unknown } = await renewed.results.next().catch(refusal);
    renewed.close();
    const spent = await session.ticket();
    const one = page.stream(session.id, { ticket: spent.ticket });
    await one.ready;
    one.close();
    const twice = await refusal(page.stream(session.id, { ticket: spent.ticket }).closed);
    await session.close();
    return { stranger, handed, seqs: [before.seq, after.seq], keyed: keyed?.seq ?? null, renewed: [spoilt, unknown?.seq ?? null], twice };
  },
};

const done = await scenarios[process.argv[2]]();
tell({ done });
