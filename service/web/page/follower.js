// Follows a run's targets through its source: what has to be sent, and what its answers say.

import { Frames } from "./frames.js";
import { Tracking, rowOf } from "./tracking.js";

/** `reached` is the time of the newest frame that was sent, up to which a file has been followed. */
export class Follower {
  tracking = null;
  reached = -Infinity;
  /** The time of the newest frame that was answered. */
  heard = -Infinity;
  skipped = 0;
  #frames = new Frames();
  #script = [];
  #sending = false;
  #base = 0;

  /** Calls `onresult(frame)` when the run has another record, and `onstatus`, `onproblem` and `onend` as Tracking does. */
  constructor(handlers) {
    Object.assign(this, handlers);
  }

  /**
   * Start a session on `frame` with `placed` boxes, `{target, box}`. The marks of `script` are set again on their frames.
   * Rejects if the session cannot be had; resolves to whether it is still wanted.
   */
  async start(run, frame, placed, options, script = []) {
    this.stop();
    this.run = run;
    this.skipped = 0;
    this.#script = script.filter(({ time }) => time > frame.time);
    this.#base = run.nextSeq;
    const tracking = new Tracking({
      onresult: (...told) => this.tracking === tracking && this.#note(...told),
      onstatus: (change) => this.tracking === tracking && this.onstatus(change),
      onproblem: (error) => this.tracking === tracking && this.onproblem(error),
      onspare: (spare) => this.#frames.release(spare),
      onend: (error) => this.tracking === tracking && this.onend(error),
    });
    this.tracking = tracking;
    this.reached = frame.time;
    try {
      await tracking.start(frame, placed, options);
    } catch (error) {
      if (this.tracking === tracking) this.stop();
      throw error;
    }
    return this.tracking === tracking;
  }

  stop() {
    this.tracking?.stop();
    this.tracking = null;
    this.#sending = false;
  }

  /** Whether answers are due. */
  get silentMs() {
    return this.tracking?.silentMs ?? 0;
  }

  grab(source, size) {
    return this.#frames.grab(source, size);
  }

  /** Send what `source` shows, scaled to `size`. Resolves when the next frame may come. */
  async send(source, size) {
    const { tracking } = this;
    if (!tracking.stream) return;
    const due = this.#due(source.time);
    const busy = tracking.mode === "lossless" || due.length ? this.#sending : !tracking.open;
    if (busy) {
      this.skipped++;
      tracking.skip();
      return;
    }
    this.#sending = true;
    this.reached = source.time;
    const frame = this.#frames.grab(source, size);
    try {
      if (due.length) await tracking.place(frame, due);
      else await tracking.send(frame);
    } catch (error) {
      if (this.tracking === tracking) this.onproblem(error);
    } finally {
      if (this.tracking === tracking) this.#sending = false;
    }
  }

  /**
   * Boxes that belong on the frame of `time`: marks of the script, and targets that were followed up to here before, and
   * whose path was not taken back.
   */
  #due(time) {
    const { ids } = this.tracking;
    const marks = this.#script.filter((mark) => mark.time === time);
    for (const { target, box } of marks) this.run.mark(time, target, box);
    const others = this.run.alive(time).filter(({ id }) => !ids.has(id) && this.run.end(id) === time);
    return [...marks, ...others.map(({ id }) => ({ target: id, box: this.run.row(id, time).box }))];
  }

  #note({ seq, size, targets, timing }, ids, frame) {
    if (!frame) return;
    const rows = new Map();
    const maps = new Map();
    targets.forEach((target, i) => {
      rows.set(ids[i], rowOf(target, size));
      if (target.maps) maps.set(ids[i], target.maps);
    });
    this.heard = frame.time;
    this.run.put({ time: frame.time, frame: frame.index, seq: seq + this.#base, size: this.sourceSize(), rows });
    this.onresult(frame, { rows, maps, tookMs: timing?.track_ms ?? null });
  }
}
