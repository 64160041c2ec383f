// The course of things: a source is opened, a box starts a run, results are shown, troubles are told.

import { fittedSize } from "/static/client/mfcmt.js";
import { announce, byId } from "./dom.js";
import { History } from "./history.js";
import { Maps } from "./maps.js";
import { Figures, TargetList, connection, log, notice } from "./panels.js";
import { Player } from "./player.js";
import { explain } from "./problems.js";
import { Recorder } from "./recorder.js";
import { OF_THE_SESSION, Settings } from "./settings.js";
import { Stage } from "./stage.js";
import { Strips } from "./strips.js";
import { Tracking } from "./tracking.js";

const PANELS_MS = 66;
const FIGURES_MS = 250;
const SAME_PROBLEM_MS = 3000;

/** States: `idle` (no source), `open` (a source, no run), `starting`, `tracking`, `ended` (the run broke off). */
export class App {
  state = "idle";
  chosen = null;
  adding = false;
  skipped = 0;
  exportSize = [0, 0];
  history = new History();
  recorder = new Recorder();
  strips = new Strips();
  maps = new Maps();
  figures = new Figures();
  tracking = null;
  trackMs = null;
  #shownTime = 0;
  #base = 0;
  #panelsAt = 0;
  #sending = false;
  #problem = { code: null, at: 0 };

  /** `changed()` after whatever the controls show has changed; `askKey()` resolves to whether one was given. */
  constructor({ changed, askKey }) {
    Object.assign(this, { changed, askKey });
    this.settings = new Settings((name) => this.#setting(name));
    this.targets = new TargetList({ onchoose: (id) => this.choose(id), onremove: (id) => this.remove(id) });
    this.stage = new Stage(byId("stage"), byId("picture"), byId("overlay"), {
      onbox: (box) => this.box(box),
      onpick: (point) => this.#pick(point),
      onhold: (on) => {
        this.player.hold(on);
        this.changed();
      },
    });
    this.player = new Player({
      deliver: () => this.#deliver(),
      preview: () => this.#preview(),
      changed: () => this.#moved(),
    });
    this.stage.scene.trail = this.settings.values.trail;
    setInterval(() => this.#figures(), FIGURES_MS);
  }

  get source() {
    return this.player.source;
  }

  /** Open what `opening` (a function) gives; what fails can be tried again. */
  async open(opening) {
    notice.hide();
    let source;
    try {
      source = await opening();
    } catch (error) {
      this.#tell(error, { again: () => this.open(opening) });
      return false;
    }
    this.#leave();
    this.player.open(source);
    source.onend = after(source.onend, () => source.live && this.#tell({ code: "camera-ended" }, { again: () => this.open(opening) }));
    this.stage.scene.suggestion = source.suggestion;
    this.#to("open");
    this.#preview();
    return true;
  }

  /** Back to the choice of sources. */
  close() {
    this.#leave();
    this.player.close();
    this.stage.hide();
    this.#to("idle");
  }

  /** A box was drawn, in fractions of the frame. */
  async box(box) {
    try {
      if (this.state === "tracking") await this.#place(box);
      else if (this.state !== "starting") await this.begin([box]);
    } finally {
      this.player.hold(false);
    }
  }

  /** A new run on the frame that is shown. */
  begin(boxes) {
    this.history.clear();
    log.clear();
    this.#base = 0;
    return this.#start(boxes, boxes.map(() => this.history.number()));
  }

  /** A new session for the targets of now, where they are now. */
  async restart() {
    const targets = [...this.history.targets.values()];
    this.tracking?.stop();
    if (!targets.length) {
      this.#to("open");
      return;
    }
    this.#base = (this.history.frames.at(-1)?.seq ?? -1) + 1;
    await this.#start(targets.map(({ box }) => box), targets.map(({ id }) => id));
  }

  /** End the run; the source stays. */
  stop() {
    this.tracking?.stop();
    this.tracking = null;
    this.player.pause();
    this.history.targets.clear();
    this.chosen = null;
    this.maps.clear();
    log.add(this.clock(), "Stopped");
    this.#to("open");
    if (this.source?.live) this.player.play();
  }

  async play() {
    if (this.player.ended && this.state !== "open") this.stop();
    if (this.player.ended) await this.player.seek(0);
    else await this.player.play();
    this.changed();
  }

  choose(id) {
    if (this.history.targets.has(id)) this.chosen = id;
    this.adding = false;
    this.#panels(true);
  }

  async remove(id) {
    try {
      await this.tracking?.remove(id);
    } catch (error) {
      this.#tell(error);
      return;
    }
    this.history.targets.delete(id);
    log.add(this.clock(), `Target ${id}`, "removed");
    if (this.chosen === id) this.chosen = [...this.history.targets.keys()][0] ?? null;
    this.#panels(true);
  }

  /** The time shown, in words. */
  clock(time = this.#shownTime) {
    const seconds = Math.max(0, time ?? 0);
    return `${Math.floor(seconds / 60)}:${(seconds % 60).toFixed(1).padStart(4, "0")}`;
  }

  async #start(boxes, ids) {
    const { values } = this.settings;
    const size = this.#size();
    const slot = this.#same(size) ? this.#shown() : this.#grab(size);
    this.#to("starting");
    const tracking = new Tracking({
      number: () => this.history.number(),
      onresult: (result, of, frame) => this.tracking === tracking && this.#result(result, of, frame),
      onstatus: (change) => this.#status(change),
      onproblem: (error) => this.#refused(error),
      onend: (error) => this.#ended(error),
    });
    this.tracking?.stop();
    this.tracking = tracking;
    this.exportSize = this.source.size;
    this.skipped = 0;
    this.trackMs = null;
    try {
      await tracking.start(slot, boxes.map((box) => pixels(box, size)), ids, { ...values, label: this.source.name });
    } catch (error) {
      if (this.tracking !== tracking) return;
      this.tracking = null;
      this.#to(ids.some((id) => this.history.targets.has(id)) ? "ended" : "open");
      this.#tell(error, { again: () => this.#start(boxes, ids) });
      return;
    }
    notice.hide();
    this.stage.scene.suggestion = null;
    this.#to("tracking");
    this.player.exact = values.mode === "lossless";
    await this.player.play();
  }

  async #place(box) {
    const target = this.adding || this.chosen === null ? null : this.chosen;
    const slot = this.#shown();
    try {
      if (target !== null) this.history.restart(target);
      await this.tracking.place(slot, pixels(box, [slot.canvas.width, slot.canvas.height]), target);
      if (target !== null) log.add(this.clock(slot.time), `Target ${target}`, "corrected");
      if (target === null) this.chosen = [...this.history.targets.keys()].at(-1) ?? this.chosen;
      this.adding = false;
      notice.hide();
    } catch (error) {
      this.#tell(error);
    }
    this.#panels(true);
  }

  /** The player shows a frame that is to be tracked. */
  async #deliver() {
    if (this.state === "starting") return;
    if (this.state !== "tracking") {
      this.#preview();
      return;
    }
    const busy = this.tracking.mode === "lossless" ? this.#sending : !this.tracking.open;
    if (busy) {
      this.skipped++;
      return;
    }
    this.#sending = true;
    await this.tracking.send(this.#grab(this.#size())).finally(() => (this.#sending = false));
  }

  #preview() {
    if (!this.source || this.state === "tracking" || this.state === "starting") return;
    this.#shownTime = this.source.time;
    this.stage.show(this.source.video, this.#size());
    if (this.source.suggestion) this.stage.scene.suggestion = this.source.time === 0 && this.state === "open" ? this.source.suggestion : null;
    this.#draw();
    this.#moved();
  }

  #result(result, ids, slot) {
    if (slot) {
      this.#shownTime = slot.time;
      this.stage.show(slot.canvas, [slot.canvas.width, slot.canvas.height]);
    }
    if (result.timing) this.trackMs = smooth(this.trackMs, result.timing.track_ms);
    const changes = this.history.note({ ...result, seq: result.seq + this.#base }, ids, slot ? slot.time : this.#shownTime);
    for (const { id, from, to, time } of changes) {
      log.add(this.clock(time), `Target ${id}`, from ? to : "started", to);
      if (from) announce(`Target ${id} ${to}`);
    }
    if (!this.history.targets.has(this.chosen)) this.chosen = ids[0] ?? null;
    this.#panels(changes.length > 0);
  }

  #status({ status, previous, error }) {
    if (status === "open") {
      connection("Tracking", "good");
      if (this.lost) {
        log.add(this.clock(), "Connection", "is back; tracking goes on");
        notice.hide();
      }
      this.lost = false;
    } else if (status === "resuming" || status === "draining") {
      connection("Reconnecting…", "busy");
      if (!this.lost) {
        const text = status === "draining" ? "The server is being restarted." : "The network or the server broke off.";
        log.add(this.clock(), "Connection", "lost; trying again");
        notice.show({ title: "Reconnecting", text: `${text} Tracking goes on by itself.` }, { tone: "busy" });
      }
      this.lost = true;
    } else if (status === "connecting" && !previous) {
      connection("Connecting…", "busy");
    }
    if (error && status === "closed") return;
    this.changed();
  }

  /** One frame or control was refused; the run goes on. */
  #refused(error) {
    const now = performance.now();
    if (error.code === this.#problem.code && now - this.#problem.at < SAME_PROBLEM_MS) return;
    this.#problem = { code: error.code, at: now };
    log.add(this.clock(), "Refused", error.detail || error.code, "uncertain");
  }

  /** The run is over, and not because somebody wanted it. */
  #ended(error) {
    this.tracking.stop();
    this.tracking = null;
    this.player.pause();
    this.lost = false;
    log.add(this.clock(), "Ended", explain(error).title, "lost");
    this.#to("ended");
    this.#tell(error);
  }

  #tell(error, { again } = {}) {
    const told = explain(error);
    const actions = {
      again,
      restart: this.history.targets.size ? () => this.restart() : null,
      key: async () => (await this.askKey(error)) && (again ? again() : this.restart()),
    };
    notice.show(told, { onaction: actions[told.action] ?? null });
    if (told.action === "key") actions.key();
  }

  async #setting(name) {
    const { values } = this.settings;
    this.stage.scene.trail = values.trail;
    if (!values.maps) this.maps.clear();
    if (this.state === "open") this.#preview();
    if (this.state === "tracking" && OF_THE_SESSION.includes(name)) await this.restart();
    if (this.state === "tracking" && name === "mode") {
      this.tracking.attach(values);
      this.player.exact = values.mode === "lossless";
      await this.player.refresh();
    }
    if (this.tracking?.stream) Object.assign(this.tracking.stream, { quality: values.quality, regions: values.regions });
    this.#draw();
  }

  #size() {
    const [width, height] = this.source.size;
    return fittedSize(width, height, this.settings.values.maxSide || null);
  }

  #same([width, height]) {
    return this.stage.picture.width === width && this.stage.picture.height === height;
  }

  #grab(size) {
    const canvas = (this.tracking ?? new Tracking({})).canvas(size);
    canvas.getContext("2d").drawImage(this.source.video, 0, 0, ...size);
    return { canvas, time: this.source.time, pooled: true };
  }

  /** A copy of the picture as it is shown. */
  #shown() {
    const { picture } = this.stage;
    const canvas = Object.assign(document.createElement("canvas"), { width: picture.width, height: picture.height });
    canvas.getContext("2d").drawImage(picture, 0, 0);
    return { canvas, time: this.#shownTime };
  }

  #pick([x, y]) {
    const inside = ({ box: [left, top, w, h] }) => x >= left && x <= left + w && y >= top && y <= top + h;
    const hit = [...this.history.targets.values()].filter(inside).sort((a, b) => a.box[2] * a.box[3] - b.box[2] * b.box[3])[0];
    if (hit) this.choose(hit.id);
  }

  #leave() {
    this.tracking?.stop();
    this.tracking = null;
    this.lost = false;
    this.history.clear();
    this.chosen = null;
    this.adding = false;
    log.clear();
    this.maps.clear();
    this.figures.clear();
    this.#panels(true);
  }

  #to(state) {
    this.state = state;
    this.stage.armed = state === "open" || state === "tracking" || state === "ended";
    const pills = { idle: ["Ready", "idle"], open: ["Ready", "idle"], starting: ["Starting…", "busy"], tracking: ["Tracking", "good"], ended: ["Stopped", "bad"] };
    connection(...pills[state]);
    this.#panels(true);
  }

  #moved() {
    this.changed();
  }

  #draw() {
    const { scene, root } = this.stage;
    root.dataset.frames = this.history.frames.length;
    scene.targets = [...this.history.targets.values()];
    scene.chosen = this.chosen;
    this.stage.draw();
    this.recorder.take(this.stage.picture, scene);
  }

  /** The parts beside the picture, not more often than the eye sees. */
  #panels(now = false) {
    this.#draw();
    const at = performance.now();
    if (!now && at - this.#panelsAt < PANELS_MS) return;
    this.#panelsAt = at;
    const target = this.history.targets.get(this.chosen);
    this.targets.draw([...this.history.targets.values()], this.chosen, this.exportSize);
    this.strips.draw(target);
    if (this.settings.values.maps) this.maps.draw(target).catch(() => {});
    this.changed();
  }

  #figures() {
    if (this.tracking?.stream) this.figures.draw(this.tracking.stream.stats, this.skipped, this.trackMs);
  }
}

const pixels = ([x, y, w, h], [width, height]) => [x * width, y * height, w * width, h * height];

/** A mean that forgets, so that the figure can be read. */
const smooth = (mean, value) => (mean === null ? value : mean + 0.1 * (value - mean));

const after = (first, second) => () => {
  first();
  second();
};
