/** Controls on their way: each is answered by its `ref`. */

const MAX_TRIES = 3;

export class Controls {
  #pending = new Map(); // ref → {message, tries, resolve, reject}
  #forNext = [];
  #refs = 0;
  #link;
  #wantWhole;

  /** `wantWhole` is called when the next frame must be sent whole. */
  constructor(link, wantWhole) {
    this.#link = link;
    this.#wantWhole = wantWhole;
  }

  get waiting() {
    return this.#pending.size > this.#forNext.length;
  }

  /** Say it now, or with the next frame; what the server answers. */
  async say(control, onNext = false) {
    const connection = await this.#link.connected();
    const ref = ++this.#refs;
    const message = { ...control, ref };
    const answer = new Promise((resolve, reject) => this.#pending.set(ref, { message, tries: 1, resolve, reject }));
    if (onNext) this.#withNext(message);
    else connection.control(message);
    return answer;
  }

  /** What goes out right before the next whole frame. */
  takeForNext() {
    return this.#forNext.splice(0);
  }

  answer(message) {
    this.#pending.get(message.ref)?.resolve(message);
    this.#pending.delete(message.ref);
  }

  /** Whether the refusal was of a control. One for want of the whole frame is said again with the next, whole one. */
  refuse(ref, error, cuts) {
    const pending = this.#pending.get(ref);
    if (!pending) return false;
    if (error.code === "full-frame-needed" && cuts && pending.tries < MAX_TRIES) {
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
