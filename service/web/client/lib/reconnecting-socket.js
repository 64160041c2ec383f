/** Keeps a stream connected: attaches, attaches again after every break, and gives up when that does not help. */

import { Connector } from "./connect.js";
import { MFCMTError, connectionLost, streamEnded } from "./errors.js";

const CHECKS = 8; // looks at the connection within `stallMs`

export class ReconnectingSocket {
  status = "connecting";
  /** The open connection, once the stream goes on with it; else null. */
  connection = null;
  /** Resolves, after the end, when the service has released the session. */
  released = Promise.resolve();
  /** Whether the service reads no more, and closes when the rest is answered. */
  holding = false;
  #connector;
  #stream;
  #stallMs;
  #waiting = [];
  #watchdog = null;
  #pauseMs = 0;
  #resumable = true;
  #hurry = () => this.#connector.hurry();

  /**
   * `stream` is called: `receive(message)`, `takeUp(connection)` before the connection is used, `up()`, `down(error)`,
   * `status(change)`, `end(error)`, and `expecting()`, which returns whether an answer is due.
   */
  constructor(client, id, options, stream) {
    this.#stream = stream;
    this.#stallMs = options.stallMs;
    this.#connector = new Connector(client, id, options, {
      onMessage: stream.receive,
      takeUp: stream.takeUp,
      onRetry: (error, waitMs) =>
        this.#become(this.status === "connecting" ? "connecting" : "resuming", error, waitMs),
    });
    globalThis.addEventListener?.("online", this.#hurry);
  }

  async run() {
    try {
      while (this.status !== "closed") {
        const connection = await this.#connector.open(this.#pauseMs, this.#resumable);
        this.#pauseMs = 0;
        this.#resumable = true;
        this.#attached(connection);
        const error = await connection.closed;
        if (error.code !== "connection-lost") throw error;
        this.#broke(error);
      }
    } catch (error) {
      this.#stream.end(error instanceof MFCMTError ? error : connectionLost("a fault of the client", error));
    }
  }

  /** Resolves with the connection as soon as there is one; rejects with what ended the stream. */
  connected() {
    if (this.status === "closed") return Promise.reject(streamEnded());
    if (this.connection) return Promise.resolve(this.connection);
    return new Promise((resolve, reject) => this.#waiting.push({ resolve, reject }));
  }

  /** The service shuts down and may be tried again after `pauseMs`. */
  drain(pauseMs, resumable) {
    this.#pauseMs = pauseMs;
    this.holding = this.#resumable = resumable;
    this.#become("draining");
  }

  close(error) {
    this.#become("closed", error);
    globalThis.removeEventListener?.("online", this.#hurry);
    clearInterval(this.#watchdog);
    this.#connector.stop();
    if (this.connection) this.released = this.connection.abandon();
    this.connection?.end(streamEnded());
    this.connection = null;
    for (const { reject } of this.#waiting.splice(0)) reject(error ?? streamEnded());
  }

  #attached(connection) {
    if (this.status === "closed") {
      connection.abandon();
      connection.end(streamEnded());
      return;
    }
    this.connection = connection;
    this.holding = false;
    this.#watch(connection);
    this.#become("open");
    this.#stream.up();
    for (const { resolve } of this.#waiting.splice(0)) resolve(connection);
  }

  #broke(error) {
    if (this.status === "closed") return;
    this.connection = null;
    clearInterval(this.#watchdog);
    this.#become("resuming", error, this.#pauseMs);
    this.#stream.down(error);
  }

  /** Break a connection that is silent while an answer is due: a dead one shows itself in no other way. */
  #watch(connection) {
    let buffered = connection.buffered;
    this.#watchdog = setInterval(() => {
      if (connection.buffered !== buffered || !this.#stream.expecting()) {
        buffered = connection.buffered;
        connection.heardAt = performance.now();
      } else if (performance.now() - connection.heardAt > this.#stallMs) {
        connection.abandon();
        connection.end(connectionLost(`nothing came for ${this.#stallMs} ms`));
      }
    }, this.#stallMs / CHECKS);
  }

  #become(status, error = null, retryInMs = null) {
    const previous = this.status;
    if (previous === "closed") return;
    this.status = status;
    this.#stream.status({ status, previous, error, retryInMs });
  }
}
