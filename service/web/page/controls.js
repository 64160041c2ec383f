// Keeps the controls as the application is: what can be pressed, what it says.

import { byId } from "./dom.js";
import { Recorder } from "./recorder.js";

export class Controls {
  #app;

  constructor(app) {
    this.#app = app;
    app.onname = (id) => this.#name(id);
    byId("name-cancel").addEventListener("click", () => byId("name-dialog").close("cancel"));
  }

  update() {
    const { state, source, player, run, intent, chosen, runs, stage, recorder, edits } = this.#app;
    const here = source !== null;
    document.documentElement.dataset.state = state;
    byId("welcome").hidden = here;
    byId("change-source").hidden = !here;
    enable("play", here);
    byId("play").setAttribute("aria-label", player.playing ? "Pause" : player.ended ? "Back to the beginning" : "Play");
    byId("play-icon").setAttribute("href", player.playing ? "#i-pause" : "#i-play");
    enable("step", here && state !== "starting");
    enable("back", here && !source.live && source.count !== null && state !== "starting");
    enable("stop", run !== null && state !== "starting");
    for (const [id, what] of [["undo", runs.canUndo], ["redo", runs.canRedo]]) {
      enable(id, what !== null && state !== "starting");
      byId(id).title = what ? `${id === "undo" ? "Undo" : "Redo"}: ${what}` : "";
    }
    press("add-target", run !== null, intent === "add");
    press("redraw-target", run !== null && chosen !== null, intent === "correct");
    enable("join", state !== "starting" && edits.between.ends !== null);
    stage.free = intent !== null;
    enable("open-export", Boolean(run?.records.length));
    press("record", here && Recorder.possible, recorder.running);
    byId("record-text").textContent = recorder.running ? "Save" : "Record";
    byId("recording").hidden = !recorder.running;
    byId("recording-time").textContent = this.#app.clock(recorder.seconds).split(".")[0];
    if (!here || !source.live) byId("flip").hidden = true;
    this.#position();
    this.#suggestion();
    const words = this.#hint();
    byId("hint").hidden = !words;
    if (byId("hint").textContent !== words) byId("hint").textContent = words;
  }

  #position() {
    const { source, shown } = this.#app;
    const file = source !== null && !source.live;
    byId("seek-row").hidden = !file;
    const now = this.#app.clock();
    byId("clock").textContent = file ? `${now} / ${this.#app.clock(source.duration)}` : source ? now : "";
    if (!file) return;
    const seek = byId("seek");
    const known = source.count !== null;
    Object.assign(seek, known ? { max: source.count - 1, step: 1 } : { max: source.duration || 0, step: 1 / source.fps });
    seek.value = known ? shown.index : shown.time;
    seek.setAttribute("aria-valuetext", known ? `${now}, frame ${shown.index + 1} of ${source.count}` : now);
  }

  #suggestion() {
    const { state, stage } = this.#app;
    const box = state === "open" ? stage.scene.suggestion : null;
    const button = byId("follow-suggestion");
    button.hidden = !box || stage.scene.draft !== null;
    if (button.hidden) return;
    const rect = stage.rect();
    button.style.left = `${rect.x + (box[0] + box[2] / 2) * rect.w - button.offsetWidth / 2}px`;
    button.style.top = `${rect.y + (box[1] + box[3]) * rect.h + 12}px`;
  }

  #hint() {
    const { state, stage, player, run, chosen, intent, source, shown, edits } = this.#app;
    if (stage.byKeys) return "Arrows move the box, Shift and arrows resize it, Enter sets it, Esc cancels";
    if (state === "starting") return edits.between.doing ?? "Starting…";
    if (state === "open") return stage.scene.suggestion ? "Or drag a box around anything else" : "Drag a box around what to follow";
    if (!run) return "";
    const name = run.targets.get(chosen)?.name;
    if (intent === "add" || chosen === null) return "Drag a box around the new target";
    if (intent === "correct") return `Drag a box around target ${name}`;
    if (player.playing) return this.#lost(run.row(chosen, shown.time), name);
    if (player.ended) return "End of the video";
    if (!source.live && shown.time < run.end(chosen)) return `Change the box of target ${name} to track again from here`;
    return this.#lost(run.row(chosen, shown.time), name) || `Drag the box of target ${name} to correct it, or draw another target`;
  }

  #lost(row, name) {
    return row?.status === "lost" ? `Target ${name} is lost, and the tracker searches for it. Move its box, or redraw it, to correct it.` : "";
  }

  async #name(id) {
    const { run, runs } = this.#app;
    const { name, kind } = run.targets.get(id);
    const dialog = byId("name-dialog");
    byId("name").value = name;
    byId("kind").value = kind;
    const kinds = new Set([...run.targets.values()].map((one) => one.kind));
    byId("kinds").replaceChildren(...[...kinds].map((value) => Object.assign(document.createElement("option"), { value })));
    dialog.returnValue = "";
    dialog.showModal();
    await new Promise((done) => dialog.addEventListener("close", done, { once: true }));
    if (dialog.returnValue !== "ok") return;
    runs.keep(`the name of target ${id}`);
    run.change(id, { name: byId("name").value.trim() || String(id), kind: byId("kind").value.trim() || "object" });
    this.#app.view.draw(true);
  }
}

function enable(id, can) {
  byId(id).disabled = !can;
}

function press(id, can, pressed) {
  enable(id, can);
  byId(id).setAttribute("aria-pressed", pressed);
}
