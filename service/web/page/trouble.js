// Reports faults, refusals and recoveries to the user.

import { log, notice } from "./panels.js";
import { explain } from "./problems.js";

const SAME_PROBLEM_MS = 3000;

export class Trouble {
  lost = false;
  #last = { code: null, at: 0 };

  /** `clock()` returns the time of the picture; `askKey(error)` resolves to whether a key was entered. */
  constructor({ clock, askKey }) {
    Object.assign(this, { clock, askKey });
  }

  /** Handle a change of the stream's status. */
  status({ status }) {
    if (status === "open") {
      if (!this.lost) return;
      this.lost = false;
      log.add(this.clock(), "Connection", "is back; tracking goes on");
      notice.hide();
    } else if (status === "resuming" || status === "draining") {
      if (this.lost) return;
      this.lost = true;
      const text = status === "draining" ? "The server is being restarted." : "The network or the server failed.";
      log.add(this.clock(), "Connection", "lost; trying again");
      notice.show({ title: "Reconnecting", text: `${text} Tracking goes on by itself.` }, { tone: "busy" });
    }
  }

  /** Handle the refusal of one frame. The run goes on. */
  refused(error) {
    const now = performance.now();
    if (error.code === this.#last.code && now - this.#last.at < SAME_PROBLEM_MS) return;
    this.#last = { code: error.code, at: now };
    log.add(this.clock(), "Refused", error.detail || error.code, "uncertain");
  }

  /** Handle a run that ended by itself. */
  ended(error, remedies) {
    this.lost = false;
    log.add(this.clock(), "Ended", explain(error).title, "lost");
    this.tell(error, remedies);
  }

  /** Show a problem. The functions `again` and `restart` are its remedies, if it has one. */
  tell(error, { again = null, restart = null } = {}) {
    const told = explain(error);
    const ask = async () => (await this.askKey(error)) && (again ?? restart)?.();
    notice.show(told, { onaction: { again: again ?? restart, restart: restart ?? again, key: ask }[told.action] });
    if (told.action === "key") ask();
  }
}
