// Watches whether the server answers: a file waits while it does not, and the page says so.

import { byId } from "./dom.js";
import { connection } from "./panels.js";

const LOOK_MS = 250;
const HOLD_MS = 1000; // a file waits for an answer that takes longer
const SAY_MS = 2000; // and after that the picture is no longer called tracked
const AGAIN_MS = 20_000; // a session that is gone twice within this time needs a person
const GONE_MS = 5000; // a service that does not know the session for so long will not remember it

const WORDS = { idle: ["Ready", "idle"], open: ["Ready", "idle"], starting: ["Starting…", "busy"], ended: ["Stopped", "idle"] };

export class Watch {
  #app;
  #wentOnAt = -Infinity;
  #unknownSince = null;

  constructor(app) {
    this.#app = app;
    setInterval(() => this.look(), LOOK_MS);
    for (const kind of ["online", "offline", "visibilitychange"]) addEventListener(kind, () => this.look(), true);
  }

  /** Handle a change of the stream's status. */
  status(change) {
    this.#app.trouble.status(change);
    const unknown = change.error?.code === "session-not-found" && change.status === "resuming";
    if (unknown) this.#unknownSince ??= performance.now();
    else if (change.status === "open") this.#unknownSince = null;
    this.look();
  }

  /** Whether the page may go on by itself after a session that is gone: it has the frame and the boxes. */
  mayGoOn(error) {
    this.#unknownSince = null;
    const gone = error.code === "session-not-found" || (error.code === "session-gone" && error.reason === "lost");
    const now = performance.now();
    if (!gone || now - this.#wentOnAt < AGAIN_MS) return false;
    this.#wentOnAt = now;
    return true;
  }

  async look() {
    const { follower, player, source, state, trouble, mode } = this.#app;
    this.pill();
    if (state === "tracking" && this.#unknownSince !== null && performance.now() - this.#unknownSince > GONE_MS) {
      follower.onend({ code: "session-not-found", message: "the server does not know the session" });
      return;
    }
    if (!source || source.live) return;
    const hidden = document.hidden && mode === "latest"; // frame by frame, a hidden page loses nothing
    const away = state === "tracking" && (follower.silentMs > HOLD_MS || trouble.lost || hidden);
    if (away === player.held("away")) return;
    if (!away && mode === "latest" && state === "tracking" && !player.held("box")) {
      follower.reached = follower.heard;
      await player.move((one) => one.seek(follower.heard));
    }
    player.hold("away", away);
  }

  /** Say how it stands. */
  pill() {
    const { follower, player, state, trouble } = this.#app;
    const silent = state === "tracking" ? follower.silentMs : 0;
    const stale = silent > SAY_MS || (state === "tracking" && trouble.lost);
    byId("stage").toggleAttribute("data-stale", stale);
    if (state !== "tracking") connection(...WORDS[state]);
    else if (trouble.lost) connection("Reconnecting…", "busy");
    else if (silent > SAY_MS && !navigator.onLine) connection("This device is offline", "busy");
    else if (silent > SAY_MS) connection(`No answer for ${Math.floor(silent / 1000)} s`, "busy");
    else if (silent > HOLD_MS) connection("Waiting…", "busy");
    else connection(player.playing ? "Tracking" : "Paused", player.playing ? "good" : "idle");
  }
}
