// Draws a run: boxes on the stage, lists, strips, maps and figures.

import { Maps } from "./maps.js";
import { Figures, TargetList } from "./panels.js";
import { Strips } from "./strips.js";

const PANELS_MS = 66;

export class View {
  chosen = null;
  #strips = new Strips();
  #maps = new Maps();
  #figures = new Figures();
  #panelsAt = 0;
  #trackMs = null;

  /** The list of targets calls `onchoose(id)` and `onremove(id)`. */
  constructor({ history, stage, recorder, settings, onchoose, onremove }) {
    Object.assign(this, { history, stage, recorder, settings });
    this.list = new TargetList({ onchoose, onremove });
  }

  get targets() {
    return [...this.history.targets.values()];
  }

  /** Draw the boxes at once and everything else at a lower rate. Returns whether the rest was drawn. */
  draw(sourceSize, now = false) {
    const { scene, root } = this.stage;
    if (!this.history.targets.has(this.chosen)) this.chosen = this.targets[0]?.id ?? null;
    root.dataset.frames = this.history.frames.length;
    Object.assign(scene, { targets: this.targets, chosen: this.chosen, trail: this.settings.values.trail });
    this.stage.draw();
    this.recorder.take(this.stage.picture, scene);
    const at = performance.now();
    if (!now && at - this.#panelsAt < PANELS_MS) return false;
    this.#panelsAt = at;
    const target = this.history.targets.get(this.chosen);
    this.list.draw(this.targets, this.chosen, sourceSize);
    this.#strips.draw(target);
    if (this.settings.values.maps) this.#maps.draw(target).catch(() => {}); // a map that was replaced while it was read
    return true;
  }

  /** The target whose box contains `[x, y]`; of several, the smallest; null for none. */
  at([x, y]) {
    const inside = ({ box: [left, top, w, h] }) => x >= left && x <= left + w && y >= top && y <= top + h;
    const [hit] = this.targets.filter(inside).sort((a, b) => a.box[2] * a.box[3] - b.box[2] * b.box[3]);
    return hit?.id ?? null;
  }

  /** Add a frame's milliseconds of tracking to the figure, a decaying mean. */
  took(ms) {
    this.#trackMs = this.#trackMs === null ? ms : this.#trackMs + 0.1 * (ms - this.#trackMs);
  }

  figures(stats, skipped) {
    this.#figures.draw(stats, skipped, this.#trackMs);
  }

  clearMaps() {
    this.#maps.clear();
  }

  clear() {
    this.chosen = null;
    this.#trackMs = null;
    this.#maps.clear();
    this.#figures.clear();
  }
}
