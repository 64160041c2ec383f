/** A session with its stream, from the first frame to the end, for components that come and go. */

import { MFCMTError } from "./errors.js";

const isVideo = (source) => typeof HTMLVideoElement !== "undefined" && source instanceof HTMLVideoElement;

export class Run {
  stream = null;
  #tell;
  #session = null;
  #unfollow = () => {};
  #ended = false;

  /** `tell(change)` is called with what changes of `{status, targets, size, error}`. */
  constructor(tell) {
    this.#tell = tell;
  }

  /** Start on what `source` shows, and follow it if it is a video. Failures are told, not thrown. */
  async start(client, source, boxes, { session, stream: options, fps } = {}) {
    try {
      this.#session = await client.createSession({ frame: source, boxes, ...session });
    } catch (error) {
      this.#fail(error);
      return;
    }
    if (this.#ended) {
      this.end();
      return;
    }
    const { targets, size } = this.#session.info;
    this.#tell({ targets, size });
    this.stream = this.#session.stream({ maxSide: session?.maxSide, quality: session?.quality, ...options });
    this.stream.on("status", ({ status, error }) => this.#tell({ status, error }));
    this.stream.on("result", (result) => this.#tell({ targets: result.targets, size: result.size }));
    this.stream.on("targets", (message) => this.#tell({ targets: message.targets }));
    this.stream.on("problem", (error) => this.#tell({ error }));
    this.#tell({ status: this.stream.status });
    if (isVideo(source)) this.#unfollow = this.stream.follow(source, { fps });
  }

  /** Return the stream. Throws where there is none. */
  running() {
    if (!this.stream) throw new MFCMTError({ code: "stream-ended", detail: "nothing is tracked yet: start a run first" });
    return this.stream;
  }

  /** End stream and session, also one that is still being created. */
  end() {
    this.#ended = true;
    this.#unfollow();
    this.stream?.close();
    this.#session?.close().catch(() => {});
  }

  #fail(error) {
    this.#tell({ status: "closed", error });
  }
}
