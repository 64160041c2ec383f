/** Ends sessions with the page that made them: otherwise each reload would keep a place until its idle time is over. */

export class PageSessions {
  #ids = new Set();
  #end;

  /** `end(id)` must reach the service although the page is going away. */
  constructor(end) {
    this.#end = end;
  }

  add(id) {
    if (this.#ids.size === 0) globalThis.addEventListener?.("pagehide", this.#leave);
    this.#ids.add(id);
  }

  delete(id) {
    this.#ids.delete(id);
    if (this.#ids.size === 0) globalThis.removeEventListener?.("pagehide", this.#leave);
  }

  // A page that goes into the back-forward cache ends its sessions too: it may never come back, and hears nothing there.
  #leave = () => {
    for (const id of [...this.#ids]) {
      this.#end(id);
      this.delete(id);
    }
  };
}
