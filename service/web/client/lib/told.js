/** What the service said last of a session: in pixels as sent, which its next frames are made from. */

import { UNSCALED } from "./scale.js";

export class Told {
  info = null;
  size = null;
  region = null;
  targets = [];
  scale = UNSCALED;
  #client;
  #sourceSize;

  /** `client.scale` says how sent pixels relate to those of the source. */
  constructor(client, sourceSize) {
    this.#client = client;
    this.#sourceSize = sourceSize;
  }

  attached(ready) {
    this.info = ready;
    this.take(ready.session);
  }

  /** Take over what a message says; `sourceSize` is that of the frame that it answers, undefined if it answers none. */
  take({ size = this.size, region, targets }, sourceSize = this.#sourceSize) {
    Object.assign(this, { size, region, targets });
    this.#sourceSize = sourceSize;
    this.scale = this.#client.scale(sourceSize, size);
  }

  /** Return `size`, `region` or `targets` as the stream's user is told. */
  inSource(name) {
    return this.scale.told({ [name]: this[name] })[name];
  }
}
