/** Sends controls and hands on their answers, which echo a `ref`. */

const MAX_TRIES = 3;

export class Controls {
  #pending = new Map(); // ref → {message, tries, resolve, reject}
  #forNext = [];
  #refs = 0;
  #socket;
  #wantWhole;

  /** `wantWhole` is called when the next frame must be sent whole. */
  constructor(socket, wantWhole) {
    this.#socket = socket;
    this.#wantWhole = wantWhole;
  }

  get waiting() {
    return this.#pending.size > this.#forNext.length;
  }

  /** Send the control that `make()` returns once there is a connection: now, or with the next frame. Resolves with its answer. */
  async send(make, onNext = false) {
    const connection = await this.#socket.connected();
    const ref = ++this.#refs;
    const message = { ...make(), ref };
    const answer = new Promise((resolve, reject) => this.#pending.set(ref, { message, tries: 1, resolve, reject }));
    if (onNext) this.#withNext(message);
    else connection.control(message);
    return answer;
  }

  /** Return the controls to be sent right before the next whole frame. */
  takeForNext() {
    return this.#forNext.splice(0);
  }

  answer(message) {
    this.#pending.get(message.ref)?.resolve(message);
    this.#pending.delete(message.ref);
  }

  /** Hand on a refusal; returns whether it was a control's. One that needs the whole frame is sent again with the next. */
  refuse(ref, error, cropping) {
    const pending = this.#pending.get(ref);
    if (!pending) return false;
    if (error.code === "full-frame-needed" && cropping && pending.tries < MAX_TRIES) {
      pending.tries += 1;
      this.#withNext(pending.message);
    } else {
      this.#pending.delete(ref);
      pending.reject(error);
    }
    return true;
  }

  fail(error) {
    for (const { reject } of this.#pending.values()) reject(error);
    this.#pending.clear();
    this.#forNext.length = 0;
  }

  #withNext(message) {
    this.#forNext.push({ ...message, on: "next" });
    this.#wantWhole();
  }
}
