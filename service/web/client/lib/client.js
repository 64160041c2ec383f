/** The client of a service: makes and finds sessions, and makes the calls of all of them. */

import { apiKey, baseUrl, numbers, oneOf, pageOrigin, query } from "./arguments.js";
import { withMapsAsBytes } from "./codec.js";
import { bytesOf, isEncoded } from "./encoder.js";
import { MFCMTError, aborted, connectionLost, ofResponse, originRefused } from "./errors.js";
import { encodeFrame } from "./frame.js";
import { PageSessions } from "./page-sessions.js";
import { Places } from "./places.js";
import { Scale, UNSCALED } from "./scale.js";
import { Session, asJson, asMessagePack, path } from "./session.js";
import { Stream } from "./stream.js";

const SNAPSHOT = "application/vnd.mfcmt.snapshot";
// How often a call that may be repeated is tried while the service cannot be reached.
const ATTEMPTS = 3;
const RETRY_DELAY_MS = 100;
// How long a creation is tried again while the service has no ready lane or no place, and how often at least: a place that
// its client gives up is free long before the service could foresee it.
const WAIT_MS = 30_000;
const ASK_AGAIN_MS = 1000;

export class Client {
  #headers;
  #fetch;
  #answered = false;
  #pageSessions = new PageSessions((id) => this.call("DELETE", path(id), { keepalive: true }).catch(() => {}));

  constructor({ url, key, fetch, WebSocket, timeoutMs = 30_000, msgpack, workerUrl, boxesIn = "sent" } = {}) {
    this.url = baseUrl(url);
    Object.defineProperty(this, "places", { value: new Places(this.url) });
    this.timeoutMs = timeoutMs;
    this.boxesIn = oneOf("boxesIn", ["sent", "source"], boxesIn);
    Object.defineProperty(this, "key", { value: apiKey(key) }); // not enumerable, so that no log shows it
    this.#headers = this.key ? { Authorization: `Bearer ${this.key}` } : {};
    this.#fetch = fetch ?? globalThis.fetch.bind(globalThis);
    Object.defineProperty(this, "WebSocket", { value: WebSocket ?? globalThis.WebSocket });
    Object.defineProperty(this, "msgpack", { value: msgpack });
    Object.defineProperty(this, "workerUrl", { value: workerUrl });
  }

  async createSession({ frame, box, boxes, options, idempotencyKey, signal, waitMs, endWithPage, ...encoding }) {
    const { bytes, size, sourceSize } = await this.image(frame, encoding);
    const scale = this.scale(sourceSize, size);
    const sent = (each) => scale.toSent(numbers(each));
    const body = { frame: bytes, box: box && sent(box), boxes: boxes && Array.from(boxes, sent), options };
    return this.#create({ ...asMessagePack(body), signal, waitMs }, { idempotencyKey, endWithPage, sourceSize });
  }

  async restoreSession(snapshot, { signal, waitMs, endWithPage } = {}) {
    const call = { body: await bytesOf(snapshot), headers: { "Content-Type": SNAPSHOT }, signal, waitMs };
    return this.#create(call, { endWithPage });
  }

  async getSession(id) {
    return new Session(this, await this.json("GET", path(id)));
  }

  async deleteSession(id) {
    await this.call("DELETE", path(id));
    this.#pageSessions.delete(id);
  }

  async *sessions() {
    let after = null;
    do {
      const page = await this.json("GET", `/v1/sessions${query({ after })}`);
      yield* page.sessions;
      after = page.next;
    } while (after !== null);
  }

  ticket(id, ttlS, more = {}) {
    return this.json("POST", `${path(id)}/ticket`, { ...asJson(ttlS === undefined ? {} : { ttl_s: ttlS }), ...more });
  }

  /** Resolves with the results after a `seq`, for a stream whose connection broke. */
  async missed(id, after, more) {
    return (await this.json("GET", `${path(id)}/trajectory${query({ after })}`, more)).results;
  }

  capabilities() {
    return this.json("GET", "/v1/capabilities");
  }

  stream(id, options = {}, sourceSize = null) {
    if (!this.WebSocket) throw new MFCMTError({ code: "no-websocket", detail: "give the Client a WebSocket class" });
    return new Stream(this, id, options, sourceSize);
  }

  /** Return the URL of a session's stream. */
  streamUrl(id, members) {
    return `ws${this.places.url(`${path(id)}/stream${query(members)}`).slice("http".length)}`;
  }

  /** Find out which node has a session, of a service that redirects; resolves with whether that is known now. */
  async findPlace(id) {
    try {
      const { redirected, url } = await this.#fetch(this.places.url(`${path(id)}/stream`), { headers: this.#headers });
      return redirected && this.places.learn(url);
    } catch {
      return false;
    }
  }

  /** Resolves with a worker that encodes pixels; null where there is none. */
  async openWorker() {
    return null;
  }

  /** Return how boxes of a frame relate to its source, of which the size may not be known. */
  scale(sourceSize, sentSize) {
    const same = !sourceSize || (sourceSize[0] === sentSize[0] && sourceSize[1] === sentSize[1]);
    return same || this.boxesIn === "sent" ? UNSCALED : new Scale(sourceSize, sentSize);
  }

  /** Resolves with a frame as it is sent: `{bytes, size, sourceSize}`, without sizes where it is encoded already. */
  async image(frame, encoding) {
    if (isEncoded(frame)) return { bytes: await bytesOf(frame), size: null, sourceSize: null };
    const { blob, ...sizes } = await encodeFrame(frame, encoding);
    return { bytes: await bytesOf(blob), ...sizes };
  }

  /** Make one HTTP call; resolves with the decoded answer. */
  async json(method, where, request) {
    return withMapsAsBytes(await this.call(method, where, request, (response) => response.json()));
  }

  /** Make one HTTP call, again while the service cannot be reached if the call may be repeated. */
  async call(method, where, { headers, body, signal, keepalive, timeoutMs = this.timeoutMs } = {}, read = () => undefined) {
    const attempts = method !== "POST" || headers?.["Idempotency-Key"] ? ATTEMPTS : 1;
    for (let attempt = 1; ; attempt += 1) {
      const limit = new AbortController();
      const timer = setTimeout(() => limit.abort(), timeoutMs);
      const abort = () => limit.abort();
      signal?.addEventListener("abort", abort);
      try {
        if (signal?.aborted) throw aborted(signal.reason);
        const request = { method, headers: { ...this.#headers, ...headers }, body, keepalive, signal: limit.signal };
        const response = await this.#fetchThere(this.places.url(where), { cache: "no-store", ...request });
        this.#answered = true;
        if (!response.ok) throw await ofResponse(response);
        this.places.learn(response.headers.get("Location"));
        return await read(response);
      } catch (failed) {
        if (failed instanceof MFCMTError) throw failed;
        if (signal?.aborted) throw aborted(signal.reason);
        if (this.places.forget(where)) attempt -= 1;
        else if (await this.#refusesThisPage()) throw originRefused(this.url, pageOrigin(), failed);
        else if (attempt === attempts) throw connectionLost(this.#unreachable(), failed);
      } finally {
        clearTimeout(timer);
        signal?.removeEventListener("abort", abort);
      }
      await pause(RETRY_DELAY_MS * 2 ** attempt);
    }
  }

  /** Fetch, also from the node to which another one sends; `fetch` follows, but leaves the key out at other hosts. */
  async #fetchThere(url, request) {
    const response = await this.#fetch(url, request);
    if (!response.redirected || !this.places.learn(response.url)) return response;
    return response.status === 401 ? this.#fetch(response.url, request) : response;
  }

  /**
   * Whether the service answers but hides its answers from the page that this runs in. Only until the first answer that
   * could be read: later it is a proxy that answers in the service's place.
   */
  async #refusesThisPage() {
    if (this.#answered || !this.#isForeign()) return false;
    try {
      await this.#fetch(`${this.url}/livez`, { mode: "no-cors", cache: "no-store" });
      return true;
    } catch {
      return false;
    }
  }

  #unreachable() {
    const origin = pageOrigin();
    if (!this.#isForeign()) return `${this.url} cannot be reached`;
    return `${this.url} cannot be reached from this page. If it runs, see whether the page's Content-Security-Policy ` +
      `(connect-src) allows its address, and MFCMT_ALLOWED_ORIGINS of the service this page's origin, ${origin}`;
  }

  #isForeign() {
    const origin = pageOrigin();
    return origin !== null && !`${this.url}/`.startsWith(`${origin}/`);
  }

  /** Create a session; again while the service says that it has no ready lane or no place. */
  async #create({ headers, waitMs = WAIT_MS, ...request }, { idempotencyKey = madeUpKey(), endWithPage, sourceSize }) {
    const call = { headers: { ...headers, "Idempotency-Key": idempotencyKey }, ...request };
    const giveUpAt = performance.now() + waitMs;
    for (;;) {
      try {
        const session = new Session(this, await this.json("POST", "/v1/sessions", call), sourceSize);
        if (endWithPage ?? typeof document !== "undefined") this.#pageSessions.add(session.id);
        return session;
      } catch (refused) {
        const left = giveUpAt - performance.now();
        if (refused.status !== 503 || refused.retryAfter === null || left <= 0) throw refused;
        await pause(Math.min(refused.retryAfter * 1000, ASK_AGAIN_MS, left), request.signal);
      }
    }
  }
}

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

/**
 * Return a key that nobody has used before; it need not be secret. `crypto.randomUUID` exists on secure origins only, and a
 * phone may test over plain HTTP; React Native has no `crypto`.
 */
function madeUpKey() {
  const digit = () => Math.floor(Math.random() * 256);
  const bytes = globalThis.crypto?.getRandomValues?.(new Uint8Array(16)) ?? Uint8Array.from({ length: 16 }, digit);
  return Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("");
}
