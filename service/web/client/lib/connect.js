/** Attaches to a session: at first, and again after a break. */

import { codecNamed } from "./codec.js";
import { connect } from "./connection.js";
import { path } from "./session.js";
import { MFCMTError, connectionLost, mayPass, streamEnded } from "./errors.js";

const FIRST_DELAY_MS = 50;
const LONGEST_DELAY_MS = 2000;
const IN_BROWSER = typeof document !== "undefined" || typeof WorkerGlobalScope !== "undefined";

export class Connector {
  #client;
  #id;
  #options;
  #codec;
  #onMessage;
  #takeUp;
  #onRetry;
  #name = null;
  #ticketSpent = false;
  #stopped = false;
  #hurry = () => {};

  /**
   * `takeUp(connection)` makes the stream go on; if it rejects, the attempt has failed. `onRetry(error, waitMs)` is
   * called for every attempt that failed and will be repeated.
   */
  constructor(client, id, options, { onMessage, takeUp, onRetry }) {
    this.#client = client;
    this.#id = id;
    this.#options = options;
    this.#codec = codecNamed(options.codec, client.msgpack);
    this.#onMessage = onMessage;
    this.#takeUp = takeUp;
    this.#onRetry = onRetry;
  }

  /**
   * Connect after `pauseMs`, with back-off. After the first time only a connection of ours that was left behind is taken
   * over. Rejects with what ended the last attempt, when trying again does not help or the time is over. A service that
   * is not `resumable` has lost its sessions when it comes back.
   */
  async open(pauseMs, resumable) {
    const giveUpAt = performance.now() + pauseMs + this.#options.reconnectForMs;
    let delay = FIRST_DELAY_MS;
    let wait = pauseMs;
    let unanswered = false;
    for (;;) {
      await this.#pause(wait);
      if (this.#stopped) throw streamEnded();
      try {
        return await this.#attempt();
      } catch (failed) {
        if (this.#stopped) throw streamEnded();
        // An attempt without an answer may have attached under a name that we do not know.
        unanswered ||= failed.code === "connection-lost";
        const error = await this.#explained(failed);
        const again = this.#name !== null;
        if (this.#goesTo(error) && performance.now() < giveUpAt) {
          wait = 0;
          continue;
        }
        if (error.code === "connection-lost") this.#client.places.forget(path(this.#id));
        const ours = again && unanswered && error.code === "attached-elsewhere";
        if (performance.now() > giveUpAt || !(ours || mayPass(error, again && resumable))) throw error;
        wait = Math.max(delay * (0.5 + Math.random() / 2), (error.retryAfter ?? 0) * 1000);
        delay = Math.min(2 * delay, LONGEST_DELAY_MS);
        this.#onRetry(error, wait);
      }
    }
  }

  /** Do not wait for the next attempt. */
  hurry() {
    this.#hurry();
  }

  stop() {
    this.#stopped = true;
    this.#hurry();
  }

  async #attempt() {
    const { mode, takeover } = this.#options;
    const ticket = await this.#ticket();
    const way = this.#name ? { resume: this.#name } : { takeover: takeover || undefined };
    const connection = await connect({
      WebSocket: this.#client.WebSocket,
      url: this.#client.streamUrl(this.#id, { mode, ...way }),
      codec: this.#codec,
      ticket,
      timeoutMs: this.#client.timeoutMs,
      onMessage: this.#onMessage,
    });
    this.#name = connection.ready.attachment;
    try {
      if (!this.#stopped) await this.#takeUp(connection);
      if (this.#stopped) throw streamEnded();
    } catch (error) {
      connection.abandon();
      throw error;
    }
    return connection;
  }

  /** Return a ticket: a browser cannot send its key with a WebSocket; Node could, and does the same. */
  async #ticket() {
    const { ticket } = this.#options;
    if (typeof ticket === "function") {
      try {
        return await ticket();
      } catch (cause) {
        throw cause instanceof MFCMTError ? cause : connectionLost("no ticket was given", cause);
      }
    }
    if (ticket && !this.#ticketSpent) {
      this.#ticketSpent = true;
      return ticket;
    }
    if (!this.#client.key) return null;
    return (await this.#client.ticket(this.#id, undefined, { timeoutMs: this.#options.stallMs })).ticket;
  }

  /** Whether another node has the session, which is asked next. */
  #goesTo({ code, problem }) {
    return code === "elsewhere" && (problem.known || this.#client.places.learn(problem.url));
  }

  /** Find out why a handshake was refused: outside of browsers there is an HTTP status at best, without its problem. */
  async #explained(failed) {
    if (IN_BROWSER || failed.type !== "about:blank" || this.#options.ticket) return failed;
    try {
      const { info } = await this.#client.getSession(this.#id);
      if (await this.#client.findPlace(this.#id)) return new MFCMTError({ code: "elsewhere", status: 307, known: true });
      // The key is good, so it was our ticket that the node did not know: its store had forgotten it.
      if (failed.status === 401) return connectionLost("the ticket was not known any more", failed);
      if (!info.stream.attached) return failed;
      return new MFCMTError({ code: "attached-elsewhere", status: 409, detail: "a stream is attached" });
    } catch (error) {
      return error;
    }
  }

  #pause(ms) {
    return new Promise((resolve) => {
      const timer = setTimeout(resolve, ms);
      this.#hurry = () => {
        clearTimeout(timer);
        resolve();
      };
    });
  }
}
