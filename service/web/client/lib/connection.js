/** One connection of a stream: it does not wait for credit and does not reconnect. */

import { MFCMTError, connectionLost, ofClose, ofHandshake } from "./errors.js";

const OPEN = 1;
const CLOSED = 3;
// A server that is gone does not answer a close.
const CLOSING_MS = 2000;

/**
 * Attach; resolves with the connection when `ready` has come, rejects with the refusal that came instead. Later messages
 * go to `onMessage`; `connection.closed` resolves with the error that ended it.
 */
export function connect({ WebSocket, url, codec, ticket, timeoutMs, onMessage }) {
  return new Promise((resolve, reject) => {
    const protocols = [codec.subprotocol, ...(ticket ? [`mfcmt.ticket.${ticket}`] : [])];
    const socket = new WebSocket(url, protocols);
    socket.binaryType = "arraybuffer";
    const connection = new Connection(socket, codec);
    let refusal = null;
    let opened = false;

    const fail = (error) => {
      clearTimeout(timer);
      connection.abandon();
      if (opened) connection.end(error);
      else reject(refusal ?? error);
    };
    const timer = setTimeout(() => fail(connectionLost("the server does not answer")), timeoutMs);
    socket.onmessage = ({ data }) => {
      let message;
      try {
        message = codec.read(data);
      } catch (cause) {
        fail(new MFCMTError({ code: "internal", detail: "what the server said cannot be read" }, { cause }));
        return;
      }
      connection.heardAt = performance.now();
      if (opened) {
        onMessage(message);
      } else if (message.type === "ready") {
        clearTimeout(timer);
        opened = true;
        connection.ready = message;
        resolve(connection);
      } else if (message.type === "error") {
        refusal = new MFCMTError(message.problem);
      }
    };
    socket.onerror = (event) => {
      refusal ??= ofHandshake(event.message); // a close follows
    };
    socket.onclose = ({ code, reason }) => fail(ofClose(code, reason));
  });
}

class Connection {
  #socket;
  #codec;

  constructor(socket, codec) {
    this.#socket = socket;
    this.#codec = codec;
    this.ready = null;
    this.closed = new Promise((resolve) => (this.end = resolve));
    this.heardAt = performance.now();
  }

  /** Bytes that have not left for the network. */
  get buffered() {
    return this.#socket.bufferedAmount ?? 0;
  }

  /** Send an image and what is said about it; false when the connection is no longer open. */
  frame(bytes, meta) {
    return this.#send(this.#codec.frame(bytes, meta));
  }

  control(message) {
    return this.#send([this.#codec.control(message)]);
  }

  /** Close and ignore further messages; resolves when the service has closed too, or after a while. */
  abandon() {
    const socket = this.#socket;
    socket.onmessage = socket.onclose = null;
    socket.onerror = () => {};
    try {
      socket.close(1000);
    } catch {
      // already closing
    }
    if (socket.readyState === CLOSED) return Promise.resolve();
    return new Promise((resolve) => {
      const timer = setTimeout(resolve, CLOSING_MS);
      timer.unref?.(); // in Node: no program waits for it
      socket.onclose = () => {
        clearTimeout(timer);
        resolve();
      };
    });
  }

  #send(parts) {
    if (this.#socket.readyState !== OPEN) return false;
    for (const part of parts) this.#socket.send(part);
    return true;
  }
}
