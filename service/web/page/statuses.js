// Tells of changes of status that matter: in the log, and aloud only what was lost or found.

import { announce } from "./dom.js";
import { log } from "./panels.js";

export class Statuses {
  #known = new Map();

  /** Note the rows of a frame whose time, as text, is `clock`. */
  note(rows, clock) {
    for (const [id, { status }] of rows) {
      const before = this.#known.get(id);
      if (status !== "uncertain" || !before) this.#known.set(id, status); // it comes and goes; the strips show it
      if (!before) {
        log.add(clock, `Target ${id}`, status === "tracking" ? "started" : "started; the box shows nothing to follow", status);
      } else if (status !== before && status === "lost") {
        this.#tell(id, clock, "lost", "lost");
      } else if (status === "tracking" && before === "lost") {
        this.#tell(id, clock, "found again", "tracking");
      }
    }
  }

  clear() {
    this.#known.clear();
  }

  #tell(id, clock, what, status) {
    log.add(clock, `Target ${id}`, what, status);
    announce(`Target ${id} ${what}`);
  }
}
