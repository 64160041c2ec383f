/** Who waits until another frame may be sent. One frame at a time is between being taken and being sent. */

export class Room {
  taking = 0;
  #line = [];
  #gate = null;
  #open = false;
  #isFree;
  #onFree;

  /** `isFree()` says whether there is room; `onFree()` is called whenever there is again. */
  constructor(isFree, onFree) {
    this.#isFree = isFree;
    this.#onFree = onFree;
  }

  get waiting() {
    return this.#line.length;
  }

  /** Whether somebody who came now would get in. */
  get free() {
    return this.#line.length === 0 && this.taking === 0 && this.#isFree();
  }

  /** Resolves when there is room, which somebody else may then have taken. */
  get freed() {
    if (this.free) return Promise.resolve();
    this.#gate ??= quiet(deferred());
    return this.#gate.promise;
  }

  /** Resolves in order of calling, with the room taken. */
  turn() {
    const turn = deferred();
    this.#line.push(turn);
    this.look();
    return turn.promise;
  }

  /** Give back what was taken. */
  leave() {
    this.taking -= 1;
    this.look();
  }

  /** Something may have made room. */
  look() {
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

  fail(error) {
    this.#open = false;
    for (const turn of this.#line.splice(0)) turn.reject(error);
    this.#gate?.reject(error);
    this.#gate = null;
  }
}

export function deferred() {
  const made = {};
  made.promise = new Promise((resolve, reject) => Object.assign(made, { resolve, reject }));
  return made;
}

/** A promise that nobody has to wait for. */
export function quiet(made) {
  made.promise.catch(() => {});
  return made;
}
