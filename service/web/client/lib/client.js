/** The client of a service: sessions over HTTP, and the streams that they have. */

import { apiKey, baseUrl, numbers } from "./arguments.js";
import { bytesOf, isEncoded } from "./encoder.js";
import { MFCMTError, aborted, connectionLost, ofResponse } from "./errors.js";
import { encodeFrame } from "./frame.js";
import { packed, withMapsAsBytes } from "./codec.js";
import { Stream } from "./stream.js";

const SNAPSHOT = "application/vnd.mfcmt.snapshot";
// How often a call that may be repeated is tried while the service cannot be reached.
const ATTEMPTS = 3;
const RETRY_DELAY_MS = 100;
// How long a creation is tried again while the service has no ready lane or no place.
const WAIT_MS = 30_000;

const path = (id) => `/v1/sessions/${encodeURIComponent(id)}`;

export class Client {
  #headers;
  #fetch;

  constructor({ url, key, fetch, WebSocket, timeoutMs = 30_000 } = {}) {
    this.url = baseUrl(url);
    this.timeoutMs = timeoutMs;
    Object.defineProperty(this, "key", { value: apiKey(key) }); // not enumerable, so that no log shows it
    this.#headers = this.key ? { Authorization: `Bearer ${this.key}` } : {};
    this.#fetch = fetch ?? globalThis.fetch.bind(globalThis);
    Object.defineProperty(this, "WebSocket", { value: WebSocket ?? globalThis.WebSocket });
  }

  async createSession({ frame, box, boxes, options, idempotencyKey, signal, waitMs, ...encoding }) {
    const form = new FormData();
    form.append("frame", await this.#image(frame, encoding), "frame");
    if (box) form.append("box", JSON.stringify(numbers(box)));
    if (boxes) form.append("boxes", JSON.stringify(Array.from(boxes, numbers)));
    if (options) form.append("options", JSON.stringify(options));
    return this.#create({ body: form, signal, waitMs }, idempotencyKey);
  }

  async restoreSession(snapshot, { signal, waitMs } = {}) {
    return this.#create({ body: await bytesOf(snapshot), headers: { "Content-Type": SNAPSHOT }, signal, waitMs });
  }

  async getSession(id) {
    return new Session(this, await this.json("GET", path(id)));
  }

  async deleteSession(id) {
    await this.call("DELETE", path(id));
  }

  async *sessions() {
    let after = null;
    do {
      const query = after === null ? "" : `?after=${encodeURIComponent(after)}`;
      const page = await this.json("GET", `/v1/sessions${query}`);
      yield* page.sessions;
      after = page.next;
    } while (after !== null);
  }

  ticket(id, ttlS, more = {}) {
    return this.json("POST", `${path(id)}/ticket`, { ...asJson(ttlS === undefined ? {} : { ttl_s: ttlS }), ...more });
  }

  /** Resolves with the results after a `seq`, for a stream whose connection broke. */
  async missed(id, after, more) {
    return (await this.json("GET", `${path(id)}/trajectory?after=${after}`, more)).results;
  }

  capabilities() {
    return this.json("GET", "/v1/capabilities");
  }

  stream(id, options = {}) {
    if (!this.WebSocket) throw new MFCMTError({ code: "no-websocket", detail: "give the Client a WebSocket class" });
    return new Stream(this, id, options);
  }

  /** Return the URL of a session's stream. */
  streamUrl(id, query) {
    return `ws${this.url.slice("http".length)}${path(id)}/stream?${query}`;
  }

  /** Make one HTTP call; resolves with the decoded answer. */
  async json(method, where, request) {
    return withMapsAsBytes(await this.call(method, where, request, (response) => response.json()));
  }

  /** Make one HTTP call, again while the service cannot be reached if the call may be repeated. */
  async call(method, where, { headers, body, signal, timeoutMs = this.timeoutMs } = {}, read = (response) => response.arrayBuffer()) {
    const attempts = method !== "POST" || headers?.["Idempotency-Key"] ? ATTEMPTS : 1;
    for (let attempt = 1; ; attempt += 1) {
      const limit = new AbortController();
      const timer = setTimeout(() => limit.abort(), timeoutMs);
      const abort = () => limit.abort();
      signal?.addEventListener("abort", abort);
      try {
        if (signal?.aborted) throw aborted(signal.reason);
        const request = { method, headers: { ...this.#headers, ...headers }, body, signal: limit.signal };
        const response = await this.#fetch(this.url + where, { cache: "no-store", ...request });
        if (!response.ok) throw await ofResponse(response);
        return await read(response);
      } catch (failed) {
        if (failed instanceof MFCMTError) throw failed;
        if (signal?.aborted) throw aborted(signal.reason);
        if (attempt === attempts) throw connectionLost(`${this.url} cannot be reached`, failed);
      } finally {
        clearTimeout(timer);
        signal?.removeEventListener("abort", abort);
      }
      await new Promise((resolve) => setTimeout(resolve, RETRY_DELAY_MS * 2 ** attempt));
    }
  }

  /** Resolves with a frame as a Blob. */
  async #image(frame, encoding) {
    if (!isEncoded(frame)) return (await encodeFrame(frame, encoding)).blob;
    return frame instanceof Blob ? frame : new Blob([await bytesOf(frame)]);
  }

  /** Create a session; again while the service says that it has no ready lane or no place. */
  async #create({ headers, waitMs = WAIT_MS, ...request }, idempotencyKey = madeUpKey()) {
    const call = { headers: { ...headers, "Idempotency-Key": idempotencyKey }, ...request };
    const giveUpAt = performance.now() + waitMs;
    for (;;) {
      try {
        return new Session(this, await this.json("POST", "/v1/sessions", call));
      } catch (refused) {
        const left = giveUpAt - performance.now();
        if (refused.status !== 503 || refused.retryAfter === null || left <= 0) throw refused;
        await pause(Math.min(refused.retryAfter * 1000, left), request.signal);
      }
    }
  }
}

export class Session {
  #client;
  #path;

  constructor(client, info) {
    this.#client = client;
    this.#path = path(info.id);
    this.info = info;
  }

  get id() {
    return this.info.id;
  }

  async refresh() {
    this.info = await this.#client.json("GET", this.#path);
    return this.info;
  }

  close() {
    return this.#client.deleteSession(this.id);
  }

  async track(frame, { ts, region, seq, ...encoding } = {}) {
    const image = isEncoded(frame) ? frame : (await encodeFrame(frame, { region, ...encoding })).blob;
    const fields = { frame: await bytesOf(image), ts, region, seq };
    const body = await packed(Object.fromEntries(Object.entries(fields).filter(([, value]) => value !== undefined)));
    const headers = { "Content-Type": "application/msgpack" };
    return this.#client.json("POST", `${this.#path}/frames`, { headers, body });
  }

  async addTarget(box) {
    return this.#client.json("POST", `${this.#path}/targets`, asJson({ box: numbers(box) }));
  }

  async correctTarget(target, box) {
    return this.#client.json("PUT", `${this.#path}/targets/${target}`, asJson({ box: numbers(box) }));
  }

  async removeTarget(target) {
    await this.#client.call("DELETE", `${this.#path}/targets/${target}`);
  }

  async trajectory({ format = "json", after, target } = {}) {
    const query = new URLSearchParams({ format });
    if (after !== undefined) query.set("after", after);
    if (target !== undefined) query.set("target", target);
    const where = `${this.#path}/trajectory?${query}`;
    if (format === "json") return (await this.#client.json("GET", where)).results;
    return this.#client.call("GET", where, {}, (response) => response.text());
  }

  async snapshot() {
    return new Uint8Array(await this.#client.call("GET", `${this.#path}/snapshot`));
  }

  ticket(ttlS) {
    return this.#client.ticket(this.id, ttlS);
  }

  stream(options = {}) {
    return this.#client.stream(this.id, options);
  }
}

const asJson = (body) => ({ headers: { "Content-Type": "application/json" }, body: JSON.stringify(body) });

/** Resolves after `ms`, or when the signal is aborted. */
function pause(ms, signal) {
  return new Promise((resolve) => {
    const timer = setTimeout(done, ms);
    function done() {
      clearTimeout(timer);
      signal?.removeEventListener("abort", done);
      resolve();
    }
    signal?.addEventListener("abort", done);
    if (signal?.aborted) done();
  });
}

/** Return a random key; `crypto.randomUUID` exists on secure origins only, and a phone may test over plain HTTP. */
function madeUpKey() {
  return Array.from(crypto.getRandomValues(new Uint8Array(16)), (byte) => byte.toString(16).padStart(2, "0")).join("");
}
