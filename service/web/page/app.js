// The application: opens a source, follows what is drawn in it, shows results, reports trouble.

import { fittedSize } from "../client/mfcmt.js";
import { byId } from "./dom.js";
import { Edits } from "./edits.js";
import { Follower } from "./follower.js";
import { connection, log, notice } from "./panels.js";
import { Player } from "./player.js";
import { Recorder } from "./recorder.js";
import { Runs } from "./runs.js";
import { OF_THE_SESSION, Settings } from "./settings.js";
import { Stage } from "./stage.js";
import { Statuses } from "./statuses.js";
import { Trouble } from "./trouble.js";
import { View } from "./view.js";
import { Watch } from "./watch.js";

/**
 * States: `idle` (no source), `open` (a source, no run), `starting`, `tracking` (a session follows the run's targets),
 * `ended` (a run is shown, and nothing is followed).
 */
export class App {
  state = "idle";
  shown = { time: 0, index: null };
  recorder = new Recorder();
  statuses = new Statuses();
  /** What the next box does: `null` (by where it is drawn), `add` or `correct`. */
  intent = null;
  /** How the source was opened. */
  opening = null;

  /**
   * `changed()` is called when the controls must be redrawn, `keepRecording()` before the picture goes that is recorded;
   * `askKey()` resolves to whether a key was entered.
   */
  constructor({ changed, askKey, keepRecording }) {
    Object.assign(this, { changed, keepRecording });
    this.runs = new Runs(() => this.panels(true));
    this.trouble = new Trouble({ clock: () => this.clock(), askKey });
    this.settings = new Settings((name) => this.#setting(name));
    this.stage = new Stage(byId("stage"), byId("picture"), byId("overlay"), {
      onbox: (box, target) => this.box(box, target),
      onpick: (point) => this.edits.choose(this.view.at(point)),
      onhold: (on) => {
        this.player.hold("box", on);
        this.changed();
      },
    });
    this.view = new View(this);
    this.player = new Player({
      deliver: () => this.#deliver(),
      preview: () => this.#preview(),
      changed: () => this.#moved(),
      failed: (error) => this.trouble.tell(error),
    });
    this.follower = new Follower({
      sourceSize: () => this.source.size,
      onresult: (frame, told) => this.#result(frame, told),
      onstatus: (change) => this.watch.status(change),
      onproblem: (error) => this.trouble.refused(error),
      onend: (error) => this.#ended(error),
    });
    this.watch = new Watch(this);
    this.edits = new Edits(this);
  }

  /** The target that is corrected by a drag on its box. */
  get chosen() {
    return this.view.chosen;
  }

  get run() {
    return this.runs.shown;
  }

  get source() {
    return this.player.source;
  }

  /** Every frame of a file is followed, and of a camera the newest, unless the settings say otherwise. */
  get mode() {
    const { mode } = this.settings.values;
    return mode === "auto" ? (this.source?.live ? "latest" : "lossless") : mode;
  }

  /** Open the source that the function `opening` returns. A failure is shown with a button to try again. */
  async open(opening) {
    notice.hide();
    connection("Opening…", "busy");
    let source;
    try {
      source = await opening();
    } catch (error) {
      this.trouble.tell(error, { again: () => this.open(opening) });
      this.watch.pill();
      return false;
    }
    this.#leave();
    this.player.open(source);
    this.opening = opening;
    const { onend } = source;
    source.onend = () => {
      onend();
      if (source.live) this.trouble.tell({ code: `${source.kind}-ended` }, { again: () => this.open(opening) });
    };
    this.stage.scene.suggestion = source.suggestion;
    this.stage.mirror = Boolean(source.mirrored);
    this.to("open");
    this.#preview();
    this.stage.focus();
    return true;
  }

  /** Go back to the choice of sources. */
  close() {
    this.#leave();
    this.player.close();
    this.stage.hide();
    this.to("idle");
    byId("choose-sample").focus();
  }

  /** Handle a box, in fractions of the frame: of `target`, or of a new one. */
  async box(box, target = null) {
    if (this.intent === "correct") target = this.chosen;
    if (this.intent === "add") target = null;
    this.intent = null;
    try {
      if (this.state !== "starting") await this.edits.place(box, target);
    } finally {
      this.player.hold("box", false);
    }
  }

  async play() {
    await this.#back();
    await this.player.play();
    this.changed();
  }

  async step() {
    if (!this.source) return;
    await this.#back();
    await this.player.step();
  }

  async back() {
    if (this.source?.count != null && this.shown.index > 0) await this.move((one) => one.show(this.shown.index - 1));
  }

  /** Move a file to a frame, or to a time where its frames have no numbers. */
  goTo(place) {
    return this.move((one) => (one.count === null ? one.seek(place) : one.show(place)));
  }

  /** Move a file. `to(source)` moves the source. */
  async move(to) {
    this.player.pause();
    await this.player.move(to);
    this.changed();
  }

  /** Return from a place beyond what is followed: no frame may be left out. */
  async #back() {
    const { source, follower } = this;
    if (source.live || !follower.tracking || source.time <= follower.reached) return;
    await this.player.move((one) => one.seek(follower.reached));
  }

  /** A time of the source as text; the picture's by default. */
  clock(time = this.shown.time) {
    const seconds = Number.isFinite(time) ? Math.max(0, time) : 0;
    return `${Math.floor(seconds / 60)}:${(Math.floor(10 * (seconds % 60)) / 10).toFixed(1).padStart(4, "0")}`;
  }

  async start(placed, play, script) {
    const { run, source, stage } = this;
    const { values } = this.settings;
    const size = this.size();
    const { width, height } = stage.picture;
    const same = width === size[0] && height === size[1];
    const frame = this.follower.grab(source.live && same ? this.picture() : source, size);
    if (!source.live) Object.assign(frame, this.shown);
    this.to("starting");
    if (!(await this.follower.start(run, frame, placed, { ...values, mode: this.mode, label: source.name }, script))) return;
    notice.hide();
    stage.scene.suggestion = null;
    await this.#back();
    this.to("tracking");
    this.player.exact = this.mode === "lossless";
    if (play) await this.player.play();
  }

  /** Follow the frame that the player shows, or show what is known of it. */
  async #deliver() {
    const { run, source, follower, state, player } = this;
    if (state === "starting" || (source.live && player.held("box"))) return;
    if (!run || (!source.live && source.time <= follower.reached)) {
      this.#preview();
      if (run) await player.inTime(source.time);
      return;
    }
    if (!follower.tracking) {
      if (source.live || state !== "ended") this.#preview();
      else this.edits.resume(player.playing);
      return;
    }
    if (source.realTime) await player.inTime(source.time);
    await follower.send(source, this.size());
  }

  /** Show the source's frame with what is known of it. */
  #preview() {
    const { source, state, stage } = this;
    if (!source || state === "starting" || stage.drawing || (source.live && state === "tracking")) return;
    this.shown = { time: source.time, index: source.index };
    stage.show(source, this.size());
    if (source.suggestion) stage.scene.suggestion = (source.index ?? source.time) === 0 && state === "open" ? source.suggestion : null;
    this.panels();
    this.changed();
  }

  #result(frame, { rows, maps, tookMs }) {
    const { source, stage } = this;
    if (source.live || frame.time >= this.shown.time || this.player.playing) {
      this.shown = { time: frame.time, index: frame.index };
      stage.show({ draw: (context, ...size) => context.drawImage(frame.canvas, 0, 0, ...size) }, [frame.canvas.width, frame.canvas.height]);
    }
    this.view.took(tookMs, maps);
    this.statuses.note(rows, this.clock(frame.time));
    this.watch.pill();
    this.panels(!this.player.playing);
  }

  #ended(error) {
    this.halt();
    this.to("ended");
    if (this.watch.mayGoOn(error)) {
      log.add(this.clock(), "Session", "gone; a new one goes on from the present boxes");
      this.edits.resume();
    } else {
      this.trouble.ended(error, { restart: () => this.edits.resume() });
    }
  }

  async #setting(name) {
    const { values } = this.settings;
    const { tracking } = this.follower;
    if (!values.maps) this.view.clearMaps();
    if (this.state === "open") this.#preview();
    if (this.state === "tracking" && OF_THE_SESSION.includes(name)) await this.edits.resume(this.player.playing);
    if (this.state === "tracking" && name === "mode") {
      tracking.attach({ ...values, mode: this.mode });
      this.player.exact = this.mode === "lossless";
      await this.player.refresh();
    }
    if (tracking?.stream) tracking.set(values);
    this.panels();
  }

  size() {
    const [width, height] = this.source.size;
    return fittedSize(width, height, this.settings.values.maxSide || null);
  }

  /** The picture as it is shown, as a source. */
  picture() {
    const { picture } = this.stage;
    return { ...this.shown, draw: (context, w, h) => context.drawImage(picture, 0, 0, w, h) };
  }

  halt() {
    this.follower.stop();
    this.player.pause();
  }

  /** Leave the source; its runs stay in the list. */
  #leave() {
    this.halt();
    if (this.recorder.running) this.keepRecording();
    this.runs.show(null);
    this.intent = null;
    log.clear();
    this.view.clear();
  }

  to(state) {
    this.state = state;
    this.player.hold("start", state === "starting"); // no frame passes before there is somebody to follow it
    this.stage.armed = state === "open" || state === "tracking" || state === "ended";
    this.watch.pill();
    this.panels(true);
  }

  #moved() {
    this.watch.pill();
    this.changed();
  }

  panels(now = false) {
    if (this.view.draw(now)) this.changed();
  }
}
