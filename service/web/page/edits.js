// What a person does to runs: sets boxes, goes on, stops, shows another run, takes back.

import { Between } from "./between.js";
import { read } from "./importer.js";
import { log, notice } from "./panels.js";
import { Run } from "./run.js";

export class Edits {
  #app;
  #runs;

  constructor(app) {
    this.#app = app;
    this.#runs = app.runs;
    this.between = new Between(app);
  }

  /** Set a target's box in the picture that is shown; what follows is followed anew. */
  async place(box, target = null) {
    this.#runs.keep(target === null ? "a new target" : `a correction of target ${target}`);
    if (!this.#app.run) this.#runs.add(this.#newRun());
    const { run, shown } = this.#app;
    const live = this.#app.follower.tracking && (this.#app.source.live || (shown.time === this.#app.follower.heard && !this.#app.follower.silentMs));
    const id = target ?? run.add();
    run.mark(shown.time, id, box);
    this.#app.view.chosen = id;
    if (live) {
      await this.#placeNow(run, id, box, target === null);
    } else {
      run.cut(id, shown.time);
      if (target !== null) run.change(id, { until: Infinity });
      const others = run.alive().filter((one) => one.id !== id && run.end(one.id) === shown.time);
      const placed = [{ target: id, box }, ...others.map((one) => ({ target: one.id, box: run.row(one.id, shown.time).box }))];
      await this.#tried(placed, this.#app.state === "open" || this.#app.player.playing, () => this.place(box, target));
    }
    if (target !== null) log.add(this.#app.clock(shown.time), `Target ${id}`, "corrected");
    this.#app.panels(true);
  }

  /** Follow the targets of the run again from where they were followed last. */
  async resume(play = true) {
    const { run, source } = this.#app;
    const time = run?.frontier ?? null;
    this.#app.follower.stop();
    if (time === null) {
      this.#app.to(run ? "ended" : "open");
      return;
    }
    this.#app.player.pause();
    if (!source.live) await this.#app.player.move((one) => one.seek(time));
    const here = run.alive().filter(({ id }) => source.live || run.end(id) === time);
    await this.#tried(here.map(({ id }) => ({ target: id, box: run.row(id, time).box })), play, () => this.resume(play));
  }

  /** Track the chosen target between its newest box up to here and the one that was set before, from both ends. */
  async join() {
    const { between } = this;
    const app = this.#app;
    if (app.state === "starting" || !between.ends) return;
    const [{ target }, { time }] = between.ends;
    this.#runs.keep(`the way of target ${target} between two boxes`);
    try {
      if (await between.join()) log.add(app.clock(time), `Target ${target}`, "tracked back to the box before, and joined");
    } catch (error) {
      this.#runs.giveUp();
      app.trouble.tell(error, { again: () => this.join() });
    }
    app.panels(true);
  }

  /** Follow the shown run's targets once more as another run, through every frame, from the boxes that were set. */
  async repeat() {
    const { run } = this.#app;
    this.#runs.keep("another run");
    const again = this.#newRun();
    for (const { id, name, kind } of run.targets.values()) again.add({ id, name, kind });
    const [first] = run.marks;
    this.#app.halt();
    this.#runs.add(again);
    await this.#app.player.move((one) => one.seek(first.time));
    const placed = run.marks.filter(({ time }) => time === first.time);
    for (const { target, box } of placed) again.mark(first.time, target, box);
    await this.#tried(placed, true, () => this.repeat(), run.marks);
  }

  /** Show the run that a file tells of, for the source that is open. */
  async import(file) {
    const run = this.#newRun();
    try {
      await read(file, run, this.#app.source);
    } catch (error) {
      this.#app.trouble.tell(error);
      return;
    }
    this.#runs.keep("an import");
    this.#app.halt();
    this.#runs.add(run);
    await this.#shownAgain(run);
  }

  /** End the run and keep the source. */
  stop() {
    this.#app.halt();
    this.#runs.show(null);
    this.#app.view.clear();
    log.add(this.#app.clock(), "Stopped", "the run is in the list");
    this.#app.to("open");
    if (this.#app.source?.live) this.#app.player.play();
  }

  /** Show a run of the list, with its source where that can be opened again. */
  async show(run) {
    if (run === this.#app.run) return;
    this.#app.halt();
    if (this.#app.opening !== run.opening && !(await this.#app.open(run.opening))) return;
    this.#runs.show(run);
    await this.#shownAgain(run);
  }

  async #shownAgain(run) {
    this.#app.follower.reached = run.frontier ?? -Infinity;
    this.#app.to("ended");
    if (!this.#app.source.live && run.first !== null) await this.#app.player.move((one) => one.seek(run.first));
  }

  /** Remove a run from the list; undo brings it back. */
  removeRun(run) {
    this.#runs.keep("the removal of a run");
    if (run === this.#app.run) this.#app.halt();
    this.#runs.remove(run);
    if (!this.#app.run && this.#app.source) this.#app.to("open");
  }

  undo(back = true) {
    const what = back ? this.#runs.undo() : this.#runs.redo();
    if (!what) return;
    this.#app.halt();
    const { run } = this.#app;
    log.add(this.#app.clock(), back ? "Undone" : "Done again", what);
    this.#app.follower.reached = run?.frontier ?? -Infinity;
    this.#app.to(run?.records.length ? "ended" : "open");
    if (run?.last != null && !this.#app.source?.live && this.#app.shown.time > run.last) this.#app.player.move((one) => one.seek(run.last));
    this.#app.panels(true);
  }

  choose(id) {
    if (id === null || !this.#app.run?.targets.has(id)) return;
    this.#app.view.chosen = id;
    this.#app.intent = null;
    this.#app.panels(true);
  }

  /** Stop following a target; what was tracked of it stays. */
  async remove(id) {
    this.#runs.keep(`the end of target ${id}`);
    try {
      if (this.#app.follower.tracking?.ids.has(id)) await this.#app.follower.tracking.remove(id);
    } catch (error) {
      this.#runs.giveUp();
      this.#app.trouble.tell(error);
      return;
    }
    const { run, shown } = this.#app;
    run.cut(id, shown.time);
    run.change(id, { until: shown.time });
    log.add(this.#app.clock(), `Target ${id}`, "removed");
    this.#app.panels(true);
  }

  /** Start a session for the `placed` boxes. One that cannot be had leaves all as it was, and is told with `again`. */
  async #tried(placed, play, again, script = []) {
    const { run } = this.#app;
    try {
      await this.#app.start(placed, play, script);
    } catch (error) {
      if (this.#app.run !== run || this.#app.state !== "starting") return;
      if (!run.records.length) this.#runs.giveUp();
      this.#app.to(this.#app.run ? "ended" : "open");
      this.#app.trouble.tell(error, { again });
    }
  }

  async #placeNow(run, id, box, fresh) {
    const { follower, source, stage } = this.#app;
    const frame = follower.grab(this.#app.picture(), [stage.picture.width, stage.picture.height]);
    try {
      if (source.live) await follower.tracking.place(frame, [{ target: id, box }]);
      else await follower.tracking.amend(frame, { target: id, box });
      notice.hide();
    } catch (error) {
      this.#runs.giveUp();
      if (fresh) this.#app.view.chosen = this.#app.run?.targets.keys().next().value ?? null;
      this.#app.trouble.tell(error);
    }
  }

  #newRun() {
    const { name, kind, fps, count, duration, size, names } = this.#app.source;
    const { preset, maxSide } = this.#app.settings.values;
    const run = new Run({ name, kind, fps, count, duration, size, names }, { preset, maxSide, mode: this.#app.mode });
    return Object.assign(run, { opening: this.#app.opening });
  }
}
