// The application: opens a source, starts a run when a box is drawn, shows results, reports trouble.

import { fittedSize } from "/static/client/mfcmt.js";
import { announce, byId } from "./dom.js";
import { Frames } from "./frames.js";
import { History } from "./history.js";
import { connection, log, notice } from "./panels.js";
import { Player } from "./player.js";
import { Recorder } from "./recorder.js";
import { OF_THE_SESSION, Settings } from "./settings.js";
import { Stage } from "./stage.js";
import { Tracking } from "./tracking.js";
import { Trouble } from "./trouble.js";
import { View } from "./view.js";

const FIGURES_MS = 250;

/** States: `idle` (no source), `open` (a source, no run), `starting`, `tracking`, `ended` (the run stopped by itself). */
export class App {
  state = "idle";
  adding = false;
  skipped = 0;
  history = new History();
  recorder = new Recorder();
  tracking = null;
  #frames = new Frames();
  #shownTime = 0;
  #base = 0;
  #sending = false;

  /** `changed()` is called when the controls must be redrawn; `askKey()` resolves to whether a key was entered. */
  constructor({ changed, askKey }) {
    this.changed = changed;
    this.trouble = new Trouble({ clock: () => this.clock(), askKey });
    this.settings = new Settings((name) => this.#setting(name));
    this.stage = new Stage(byId("stage"), byId("picture"), byId("overlay"), {
      onbox: (box) => this.box(box),
      onpick: (point) => this.choose(this.view.at(point)),
      onhold: (on) => {
        this.player.hold(on);
        this.changed();
      },
    });
    const { history, stage, recorder, settings } = this;
    const handlers = { onchoose: (id) => this.choose(id), onremove: (id) => this.remove(id) };
    this.view = new View({ history, stage, recorder, settings, ...handlers });
    this.player = new Player({
      deliver: () => this.#deliver(),
      preview: () => this.#preview(),
      changed: () => this.#moved(),
    });
    setInterval(() => this.tracking?.stream && this.view.figures(this.tracking.stream.stats, this.skipped), FIGURES_MS);
  }

  /** The target that a new box will correct. */
  get chosen() {
    return this.view.chosen;
  }

  get source() {
    return this.player.source;
  }

  /** Open the source that the function `opening` returns. A failure is shown with a button to try again. */
  async open(opening) {
    notice.hide();
    let source;
    try {
      source = await opening();
    } catch (error) {
      this.trouble.tell(error, { again: () => this.open(opening) });
      return false;
    }
    this.#leave();
    this.player.open(source);
    source.onend = after(source.onend, () => source.live && this.trouble.tell({ code: "camera-ended" }, { again: () => this.open(opening) }));
    this.stage.scene.suggestion = source.suggestion;
    this.#to("open");
    this.#preview();
    return true;
  }

  /** Go back to the choice of sources. */
  close() {
    this.#leave();
    this.player.close();
    this.stage.hide();
    this.#to("idle");
  }

  /** Handle a box that was drawn, in fractions of the frame. */
  async box(box) {
    try {
      if (this.state === "tracking") await this.#place(box);
      else if (this.state !== "starting") await this.begin([box]);
    } finally {
      this.player.hold(false);
    }
  }

  /** Start a run on the frame that is shown. */
  begin(boxes) {
    this.history.clear();
    log.clear();
    this.#base = 0;
    return this.#start(boxes, boxes.map(() => this.history.number()));
  }

  /** Start a new session for the present targets, from their present boxes. */
  async restart(play = true) {
    const targets = [...this.history.targets.values()];
    this.tracking?.stop();
    if (!targets.length) {
      this.#to("open");
      return;
    }
    this.#base = this.history.next;
    await this.#start(targets.map(({ box }) => box), targets.map(({ id }) => id), play);
  }

  /** End the run and keep the source. */
  stop() {
    this.tracking?.stop();
    this.tracking = null;
    this.player.pause();
    this.history.targets.clear();
    this.view.clearMaps();
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
    if (!this.history.targets.has(id)) return;
    this.view.chosen = id;
    this.adding = false;
    this.#panels(true);
  }

  async remove(id) {
    try {
      await this.tracking?.remove(id);
    } catch (error) {
      this.trouble.tell(error);
      return;
    }
    this.history.targets.delete(id);
    log.add(this.clock(), `Target ${id}`, "removed");
    this.#panels(true);
  }

  /** The time of the picture, as text. */
  clock(time = this.#shownTime) {
    const seconds = Math.max(0, time ?? 0);
    return `${Math.floor(seconds / 60)}:${(seconds % 60).toFixed(1).padStart(4, "0")}`;
  }

  async #start(boxes, ids, play = true) {
    const { values } = this.settings;
    const size = this.#size();
    const { picture } = this.stage;
    const frame = picture.width === size[0] && picture.height === size[1] ? this.#shown() : this.#grab(size);
    this.#to("starting");
    const tracking = new Tracking({
      number: () => this.history.number(),
      onresult: (result, of, seen) => this.tracking === tracking && this.#result(result, of, seen),
      onstatus: (change) => this.trouble.status(change),
      onproblem: (error) => this.trouble.refused(error),
      onspare: (frame) => this.#frames.release(frame),
      onend: (error) => this.#ended(error),
    });
    this.tracking?.stop();
    this.tracking = tracking;
    this.skipped = 0;
    try {
      await tracking.start(frame, boxes.map((box) => pixels(box, size)), ids, { ...values, label: this.source.name });
    } catch (error) {
      if (this.tracking !== tracking) return;
      this.tracking = null;
      this.#to(ids.some((id) => this.history.targets.has(id)) ? "ended" : "open");
      this.trouble.tell(error, { again: () => this.#start(boxes, ids, play) });
      return;
    }
    notice.hide();
    this.stage.scene.suggestion = null;
    this.#to("tracking");
    this.player.exact = values.mode === "lossless";
    if (play) await this.player.play();
  }

  async #place(box) {
    const target = this.adding || this.chosen === null ? null : this.chosen;
    const frame = this.#shown();
    try {
      if (target !== null) this.history.restart(target);
      await this.tracking.place(frame, pixels(box, [frame.canvas.width, frame.canvas.height]), target);
      if (target !== null) log.add(this.clock(frame.time), `Target ${target}`, "corrected");
      if (target === null) this.view.chosen = [...this.history.targets.keys()].at(-1) ?? this.chosen;
      this.adding = false;
      notice.hide();
    } catch (error) {
      this.trouble.tell(error);
    }
    this.#panels(true);
  }

  /** Track the frame that the player shows. */
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
    this.#panels();
    this.changed();
  }

  #result(result, ids, frame) {
    if (frame) {
      this.#shownTime = frame.time;
      this.stage.show(frame.canvas, [frame.canvas.width, frame.canvas.height]);
    }
    if (result.timing) this.view.took(result.timing.track_ms);
    const numbered = { ...result, seq: result.seq + this.#base };
    const changes = this.history.note(numbered, ids, this.#shownTime, this.source.size);
    for (const { id, from, to, time } of changes) {
      log.add(this.clock(time), `Target ${id}`, from ? to : to === "tracking" ? "started" : "started; the box shows nothing to follow", to);
      if (from) announce(`Target ${id} ${to}`);
    }
    this.#panels(changes.length > 0);
  }

  #ended(error) {
    this.tracking.stop();
    this.tracking = null;
    this.player.pause();
    this.#to("ended");
    this.trouble.ended(error, { restart: () => this.restart() });
  }

  async #setting(name) {
    const { values } = this.settings;
    if (!values.maps) this.view.clearMaps();
    if (this.state === "open") this.#preview();
    if (this.state === "tracking" && OF_THE_SESSION.includes(name)) await this.restart(this.player.playing);
    if (this.state === "tracking" && name === "mode") {
      this.tracking.attach(values);
      this.player.exact = values.mode === "lossless";
      await this.player.refresh();
    }
    if (this.tracking?.stream) Object.assign(this.tracking.stream, { quality: values.quality, regions: values.regions });
    this.#panels();
  }

  #size() {
    const [width, height] = this.source.size;
    return fittedSize(width, height, this.settings.values.maxSide || null);
  }

  #grab(size) {
    return this.#frames.grab(this.source.video, size, this.source.time);
  }

  /** Record the picture as it is shown. */
  #shown() {
    const { picture } = this.stage;
    return this.#frames.grab(picture, [picture.width, picture.height], this.#shownTime);
  }

  #leave() {
    this.tracking?.stop();
    this.tracking = null;
    this.history.clear();
    this.adding = false;
    log.clear();
    this.view.clear();
    this.#panels(true);
  }

  #to(state) {
    this.state = state;
    this.stage.armed = state === "open" || state === "tracking" || state === "ended";
    const pills = { idle: ["Ready", "idle"], open: ["Ready", "idle"], starting: ["Starting…", "busy"], tracking: ["Tracking", "good"], ended: ["Stopped", "bad"] };
    connection(...pills[state]);
    this.#panels(true);
  }

  /** The player started or stopped playing. */
  #moved() {
    const { playing } = this.player;
    if (this.state === "tracking" && !this.trouble.lost) connection(playing ? "Tracking" : "Paused", playing ? "good" : "idle");
    this.changed();
  }

  #panels(now = false) {
    if (this.view.draw(this.source?.size ?? [0, 0], now)) this.changed();
  }
}

const pixels = ([x, y, w, h], [width, height]) => [x * width, y * height, w * width, h * height];

const after = (first, second) => () => {
  first();
  second();
};
