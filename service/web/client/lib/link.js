/** A stream's connection, kept up: attached at first, resumed after every break, given up when that is in vain. */

import { Attaching } from "./attaching.js";
import { MFCMTError, connectionLost, streamEnded } from "./errors.js";

const CHECKS = 8; // within the time after which silence counts as a break

export class Link {
  status = "connecting";
  /** The open connection, when the stream has taken it up. */
  connection = null;
  /** After the end: resolves when the server has let go of the session. */
  released = Promise.resolve();
  /** The server will not read what is sent from now on; it closes when the rest is answered. */
  holding = false;
  #attaching;
  #stream;
  #stallMs;
  #waiting = [];
  #watchdog = null;
  #pauseMs = 0;
  #resumable = true;
  #hurry = () => this.#attaching.hurry();

  /**
   * `stream` is told: `receive(message)`, `takeUp(connection)` before the connection is used, `up()`, `down(error)`, `status(change)`, `end(error)`; and asked whether it is `expecting` an answer.
   */
  constructor(client, id, options, stream) {
    this.#stream = stream;
    this.#stallMs = options.stallMs;
    this.#attaching = new Attaching(client, id, options, {
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
        const connection = await this.#attaching.open(this.#pauseMs, this.#resumable);
        this.#pauseMs = 0;
        this.#resumable = true;
        this.#stand(connection);
        const error = await connection.closed;
        if (error.code !== "connection-lost") throw error;
        this.#fall(error);
      }
    } catch (error) {
      this.#stream.end(error instanceof MFCMTError ? error : connectionLost("a fault of the client", error));
    }
  }

  /** The connection when there is one; rejects with what ended the stream. */
  connected() {
    if (this.status === "closed") return Promise.reject(streamEnded());
    if (this.connection) return Promise.resolve(this.connection);
    return new Promise((resolve, reject) => this.#waiting.push({ resolve, reject }));
  }

  /** The server is going away and wants to be tried again after `pauseMs`. */
  drain(pauseMs, resumable) {
    this.#pauseMs = pauseMs;
    this.holding = this.#resumable = resumable;
    this.#become("draining");
  }

  close(error) {
    this.#become("closed", error);
    globalThis.removeEventListener?.("online", this.#hurry);
    clearInterval(this.#watchdog);
    this.#attaching.stop();
    if (this.connection) this.released = this.connection.abandon();
    this.connection?.end(streamEnded());
    this.connection = null;
    for (const { reject } of this.#waiting.splice(0)) reject(error ?? streamEnded());
  }

  #stand(connection) {
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

  #fall(error) {
    if (this.status === "closed") return;
    this.connection = null;
    clearInterval(this.#watchdog);
    this.#become("resuming", error, this.#pauseMs);
    this.#stream.down(error);
  }

  /** A connection that carries nothing any more tells so by silence only. */
  #watch(connection) {
    let buffered = connection.buffered;
    this.#watchdog = setInterval(() => {
      if (connection.buffered !== buffered || !this.#stream.expecting()) {
        buffered = connection.buffered;
        connection.heardAt = performance.now();
      } else if (performance.now() - connection.heardAt > this.#stallMs) {
        connection.abandon();
        connection.end(connectionLost(`nothing was heard for ${this.#stallMs} ms`));
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
