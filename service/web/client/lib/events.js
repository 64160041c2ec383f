/** A stream's events, and its results as an async iterator. */

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
          throw error; // the listener's fault is reported and does not disturb the stream
        });
      }
    }
  }
}

/**
 * A queue with one reader. `onRead` is called for every item that is taken; `onLeave` when a loop over the queue is left
 * early, which waits for the promise that it returns.
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

  /** Add an item; it is dropped while nobody has begun to read. */
  put(item) {
    if (this.#readers.length) this.#readers.shift().resolve({ value: item, done: false });
    else if (this.#open) this.#items.push(item);
  }

  /** End the iteration after what waits, with an error or without. */
  end(error) {
    this.#ended = { error };
    for (const reader of this.#readers.splice(0)) this.#finish(reader);
  }

  /** Return the iterator of all items from now on. */
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
    this.#ended = { error: null }; // thrown once
    if (error) reject(error);
    else resolve({ value: undefined, done: true });
  }
}
