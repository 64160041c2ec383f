// The timeline under the picture: a lane for each target, with status as colour, confidence as height, and marks.

import { byId, colour, crisp } from "./dom.js";

const LANE_PX = 26;
const GAP_PX = 3;
const MOST_LANES = 6;
const COLOURS = { tracking: "--tracking", uncertain: "--uncertain", lost: "--lost" };
const DRAW_MS = 200;
const ZOOM = 1.5;
const LEAST_S = 0.2;

export class Timeline {
  #app;
  #canvas = byId("timeline");
  #drawnAt = 0;
  #later = 0;
  #span = null; // [from, to] in seconds, where it is zoomed

  constructor(app) {
    this.#app = app;
    const canvas = this.#canvas;
    new ResizeObserver(() => this.draw(true)).observe(canvas);
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      this.#go(event);
    });
    canvas.addEventListener("pointermove", (event) => canvas.hasPointerCapture(event.pointerId) && this.#go(event));
    canvas.addEventListener("wheel", (event) => this.#wheel(event), { passive: false });
    byId("zoom-in").addEventListener("click", () => this.zoom(ZOOM));
    byId("zoom-out").addEventListener("click", () => this.zoom(1 / ZOOM));
  }

  /** Show less or more of the source, around its present place. */
  zoom(by, around = this.#app.shown.time) {
    const [from, to] = this.#range();
    const [first, last] = this.#whole();
    const length = Math.max((to - from) / by, LEAST_S);
    if (length >= last - first) {
      this.#span = null;
    } else {
      const start = Math.min(Math.max(around - (around - from) / by, first), last - length);
      this.#span = [start, start + length];
    }
    this.draw(true);
  }

  draw(now = false) {
    const { run, source } = this.#app;
    byId("timeline-row").hidden = !run || !source;
    if (!run || !source) return;
    const wait = this.#drawnAt + DRAW_MS - performance.now();
    if (!now && wait > 0) {
      this.#later ||= setTimeout(() => this.draw(true), wait);
      return;
    }
    clearTimeout(this.#later);
    this.#later = 0;
    this.#drawnAt = performance.now();
    this.#paint(run);
  }

  #paint(run) {
    const targets = [...run.targets.values()].slice(0, MOST_LANES);
    this.#canvas.style.height = `${Math.max(1, targets.length) * (LANE_PX + GAP_PX)}px`;
    const { context, width, height } = crisp(this.#canvas);
    context.clearRect(0, 0, width, height);
    const [from, to] = this.#follow();
    const x = (time) => ((time - from) / (to - from)) * width;
    targets.forEach(({ id, name }, i) => {
      const top = i * (LANE_PX + GAP_PX);
      context.fillStyle = colour(id === this.#app.chosen ? "--raised-more" : "--raised");
      context.fillRect(0, top, width, LANE_PX);
      this.#lane(context, run, id, { x, top, width, from, to });
      context.fillStyle = colour("--ink");
      context.font = "600 10px ui-monospace, monospace";
      context.fillText(name, 4, top + 10);
    });
    context.fillStyle = colour("--ink");
    context.fillRect(Math.round(x(this.#app.shown.time)) - 1, 0, 2, height);
  }

  #lane(context, run, id, { x, top, width, from, to }) {
    const { records } = run;
    const columns = new Map(); // pixel → [sum of confidence, number, worst status]
    const worse = { tracking: 0, uncertain: 1, lost: 2 };
    for (let i = run.place(from); i < records.length && records[i].time <= to; i++) {
      const row = records[i].rows.get(id);
      if (!row || records[i].time < from) continue;
      const px = Math.floor(x(records[i].time));
      const column = columns.get(px) ?? { sum: 0, count: 0, status: "tracking" };
      column.sum += row.confidence ?? 1;
      column.count++;
      if (worse[row.status] > worse[column.status]) column.status = row.status;
      columns.set(px, column);
    }
    const wide = Math.max(1, Math.ceil(width / Math.max(1, (to - from) * (this.#app.source.fps || 30))));
    for (const [px, { sum, count, status }] of columns) {
      const tall = Math.max(2, (sum / count) * (LANE_PX - 2));
      context.fillStyle = colour(COLOURS[status]);
      context.fillRect(px, top + LANE_PX - tall, wide, tall);
    }
    context.fillStyle = colour("--ink");
    for (const { time } of run.marks.filter((mark) => mark.target === id)) {
      context.beginPath();
      context.moveTo(x(time) - 4, top);
      context.lineTo(x(time) + 4, top);
      context.lineTo(x(time), top + 6);
      context.fill();
    }
  }

  #whole() {
    const { run, source } = this.#app;
    if (source.live) return [run.first ?? 0, Math.max(run.last ?? 0, (run.first ?? 0) + 1)];
    return [0, Math.max(source.duration || 0, run.last ?? 0, LEAST_S)];
  }

  #range() {
    return this.#span ?? this.#whole();
  }

  /** The range that is shown; where it is zoomed, it keeps the present place in sight. */
  #follow() {
    const { time } = this.#app.shown;
    if (this.#span && (time < this.#span[0] || time > this.#span[1])) {
      const length = this.#span[1] - this.#span[0];
      this.#span = [Math.max(0, time - length / 4), Math.max(0, time - length / 4) + length];
    }
    return this.#range();
  }

  #go(event) {
    const { source } = this.#app;
    const { left, width, top, height } = this.#canvas.getBoundingClientRect();
    const [from, to] = this.#range();
    const targets = [...this.#app.run.targets.keys()].slice(0, MOST_LANES);
    const lane = Math.floor(((event.clientY - top) / height) * targets.length);
    if (event.type === "pointerdown") this.#app.edits.choose(targets[Math.min(Math.max(lane, 0), targets.length - 1)] ?? null);
    if (source.live) return;
    const time = from + (Math.min(Math.max(event.clientX - left, 0), width) / width) * (to - from);
    this.#app.move((one) => one.seek(time));
  }

  #wheel(event) {
    if (!event.ctrlKey && !event.metaKey) return; // else the page scrolls
    event.preventDefault();
    const { left, width } = this.#canvas.getBoundingClientRect();
    const [from, to] = this.#range();
    this.zoom(event.deltaY < 0 ? ZOOM : 1 / ZOOM, from + ((event.clientX - left) / width) * (to - from));
  }
}
