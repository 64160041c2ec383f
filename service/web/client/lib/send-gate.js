/** Lets frames through one at a time, in order of asking, as soon as there is room for another. */

export class SendGate {
  /** Frames that have been let through and are not sent yet. */
  taking = 0;
  #line = [];
  #gate = null;
  #open = false;
  #isFree;
  #onFree;

  /** `isFree()` returns whether there is room; `onFree()` is called whenever there is room again. */
  constructor(isFree, onFree) {
    this.#isFree = isFree;
    this.#onFree = onFree;
  }

  get waiting() {
    return this.#line.length;
  }

  /** Whether a frame would be let through at once. */
  get free() {
    return this.#line.length === 0 && this.taking === 0 && this.#isFree();
  }

  /** Resolves when there is room; another frame may take it first. */
  get freed() {
    if (this.free) return Promise.resolve();
    this.#gate ??= quiet(deferred());
    return this.#gate.promise;
  }

  /** Resolves in order of calling; the caller has the room until it calls `leave`. */
  enter() {
    const turn = deferred();
    this.#line.push(turn);
    this.update();
    return turn.promise;
  }

  /** Give the room back. */
  leave() {
    this.taking -= 1;
    this.update();
  }

  /** Look whether there is room now; to be called when anything has changed that may have made some. */
  update() {
    while (this.#line.length && this.taking === 0 && this.#isFree()) {
      this.taking += 1;
      this.#line.shift().resolve();
    }
    const free = this.free;
    const opened = free && !this.#open;
    this.#open = free;
    if (free) {
      this.#gate?.resolve();
      this.#gate = null;
    }
    if (opened) this.#onFree();
  }

  /** Reject all that wait. */
  fail(error) {
    this.#open = false;
    for (const turn of this.#line.splice(0)) turn.reject(error);
    this.#gate?.reject(error);
    this.#gate = null;
  }
}

/** A promise with the functions that settle it. */
export function deferred() {
  const made = {};
  made.promise = new Promise((resolve, reject) => Object.assign(made, { resolve, reject }));
  return made;
}

/** Mark a promise that may be rejected without anybody waiting for it. */
export function quiet(made) {
  made.promise.catch(() => {});
  return made;
}
