/** What a stream tells: events, and results as an async iterator. */

export class Events {
  #listeners = new Map();

  on(event, listener) {
    const listeners = this.#listeners.get(event) ?? new Set();
    this.#listeners.set(event, listeners.add(listener));
    return () => void listeners.delete(listener);
  }

  emit(event, detail) {
    for (const listener of [...(this.#listeners.get(event) ?? [])]) {
      try {
        listener(detail);
      } catch (error) {
        queueMicrotask(() => {
          throw error; // the listener's fault is reported, and is not the stream's
        });
      }
    }
  }
}

/**
 * A queue with one reader; `onRead` is called for every item that is taken, `onLeave` when a loop over it is left early,
 * which waits for what it returns.
 */
export class Inbox {
  #items = [];
  #readers = [];
  #open = false;
  #ended = null;
  #onRead;
  #onLeave;

  constructor(onRead, onLeave) {
    this.#onRead = onRead;
    this.#onLeave = onLeave;
  }

  get unread() {
    return this.#items.length;
  }

  /** Nothing is kept before anybody reads. */
  put(item) {
    if (this.#readers.length) this.#readers.shift().resolve({ value: item, done: false });
    else if (this.#open) this.#items.push(item);
  }

  /** After what waits, readers are told that this is all, or what went wrong. */
  end(error) {
    this.#ended = { error };
    for (const reader of this.#readers.splice(0)) this.#finish(reader);
  }

  /** The iterator of all that comes from now on. */
  read() {
    this.#open = true;
    const iterator = {
      next: () =>
        new Promise((resolve, reject) => {
          if (this.#items.length) {
            resolve({ value: this.#items.shift(), done: false });
            this.#onRead();
          } else if (this.#ended) {
            this.#finish({ resolve, reject });
          } else {
            this.#readers.push({ resolve, reject });
          }
        }),
      return: async () => {
        this.#open = false;
        this.#items.length = 0;
        await this.#onLeave();
        return { value: undefined, done: true };
      },
      [Symbol.asyncIterator]: () => iterator,
    };
    return iterator;
  }

  #finish({ resolve, reject }) {
    const { error } = this.#ended;
    this.#ended = { error: null }; // told once
    if (error) reject(error);
    else resolve({ value: undefined, done: true });
  }
}
