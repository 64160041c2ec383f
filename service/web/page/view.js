// Draws a run: boxes on the stage, lists, strips, maps, timeline and figures.

import { Comparison } from "./comparison.js";
import { Maps } from "./maps.js";
import { Figures, TargetList } from "./panels.js";
import { RunList } from "./runlist.js";
import { KEPT, Strips } from "./strips.js";
import { Timeline } from "./timeline.js";

const PANELS_MS = 66;
const FIGURES_MS = 250;
const TRAIL = 90;

export class View {
  chosen = null;
  /** The run whose boxes are shown beside those of the shown run, or null. */
  other = null;
  #app;
  #strips = new Strips();
  #maps = new Maps();
  #figures = new Figures();
  #ownMaps = new Map(); // target → the maps of its newest result
  #panelsAt = 0;
  #later = 0;
  #trackMs = null;

  constructor(app) {
    this.#app = app;
    this.list = new TargetList({
      onchoose: (id) => app.edits.choose(id),
      onremove: (id) => app.edits.remove(id),
      onname: (id) => app.onname(id),
    });
    this.comparison = new Comparison(() => this.draw(true));
    app.stage.onpainted = () => this.comparison.draw(app.stage, this.other && this.targetsAt(this.other, app.shown.time));
    this.runs = new RunList(app);
    this.timeline = new Timeline(app);
    setInterval(() => this.#draw(), FIGURES_MS);
  }

  /** The targets that are in the picture: their rows, with number, name and trail. */
  get targets() {
    return this.targetsAt(this.#app.run, this.#app.shown.time);
  }

  /** The targets of `run` that are in the picture at a time. */
  targetsAt(run, time) {
    const here = run?.alive(time).filter(({ id }) => time <= run.end(id)) ?? [];
    return here.flatMap(({ id, name, kind }) => {
      const row = run.row(id, time);
      const past = this.#app.settings.values.trail ? trail(run.samples(id, time, TRAIL)) : [];
      return row ? [{ ...row, id, name, kind, trail: past }] : [];
    });
  }

  /** Draw the boxes at once and everything else at a lower rate. Returns whether the rest was drawn. */
  draw(now = false) {
    const { run, stage, recorder } = this.#app;
    const { scene, root } = stage;
    const { targets } = this;
    if (!run?.targets.has(this.chosen)) this.chosen = run?.targets.keys().next().value ?? null;
    root.dataset.frames = run?.records.length ?? 0;
    if (!run || this.other === run || this.other?.opening !== run.opening) this.other = null;
    const other = this.comparison.apart ? [] : this.targetsAt(this.other, this.#app.shown.time);
    Object.assign(scene, { targets, chosen: this.chosen, other });
    stage.draw();
    recorder.take(stage.picture, scene);
    const wait = this.#panelsAt + PANELS_MS - performance.now();
    if (!now && wait > 0) {
      this.#later ||= setTimeout(() => this.draw(true), wait); // so that the last of several is drawn too
      return false;
    }
    clearTimeout(this.#later);
    this.#later = 0;
    this.#panelsAt = performance.now();
    this.#panels(run, targets);
    return true;
  }

  #panels(run, targets) {
    const { source, shown, settings } = this.#app;
    this.list.draw(run, targets, this.chosen, source?.size ?? [0, 0]);
    this.runs.draw();
    const name = this.chosen === null ? "" : `target ${run.targets.get(this.chosen).name}`;
    this.#strips.draw(name, this.chosen === null ? [] : run.samples(this.chosen, shown.time, KEPT));
    this.timeline.draw();
    if (settings.values.maps) this.#maps.draw(name, this.#ownMaps.get(this.chosen)).catch(() => {}); // replaced while it was read
  }

  /** The target whose box contains `[x, y]`; of several, the smallest; null for none. */
  at([x, y]) {
    const inside = ({ box: [left, top, w, h] }) => x >= left && x <= left + w && y >= top && y <= top + h;
    const [hit] = this.targets.filter(inside).sort((a, b) => a.box[2] * a.box[3] - b.box[2] * b.box[3]);
    return hit?.id ?? null;
  }

  /** Take a result's maps, and add its milliseconds of tracking to the figure, a decaying mean. */
  took(ms, maps) {
    for (const [id, own] of maps) this.#ownMaps.set(id, own);
    if (ms !== null) this.#trackMs = this.#trackMs === null ? ms : this.#trackMs + 0.1 * (ms - this.#trackMs);
  }

  /** Show another run's boxes too; null for none. */
  compare(run) {
    this.other = run;
    this.draw(true);
  }

  clearMaps() {
    this.#ownMaps.clear();
    this.#maps.clear();
  }

  clear() {
    this.chosen = null;
    this.#trackMs = null;
    this.clearMaps();
    this.#figures.clear();
  }

  #draw() {
    const { follower, run, source } = this.#app;
    const stats = follower.tracking?.stream?.stats;
    if (!stats) return;
    const missed = source.count === null ? stats.dropped + stats.skipped + follower.skipped : missing(run);
    this.#figures.draw(stats, missed, this.#trackMs);
  }
}

/** How many frames between the first and the last record of a run have none. */
export function missing({ records }) {
  if (!records.length) return 0;
  return records.at(-1).frame - records[0].frame + 1 - records.length;
}

const trail = (rows) => rows.map(({ box: [x, y, w, h] }) => [x + w / 2, y + h / 2]);
