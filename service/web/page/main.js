// The page's controls: buttons, menus, keys.

import { App } from "./app.js";
import { byId, download, el } from "./dom.js";
import { toCsv, toJson } from "./export.js";
import { connection } from "./panels.js";
import { Recorder } from "./recorder.js";
import { cameras, openCamera, openFile, openSample } from "./source.js";
import { key } from "./tracking.js";

const app = new App({ changed, askKey });
let facing = "environment";

byId("choose-sample").addEventListener("click", () => app.open(openSample));
byId("choose-camera").addEventListener("click", () => camera({ facing }));
byId("choose-file").addEventListener("click", () => byId("file").click());
byId("file").addEventListener("change", ({ target }) => {
  const [file] = target.files;
  if (file) app.open(() => openFile(file));
  target.value = "";
});
byId("change-source").addEventListener("click", () => app.close());
byId("follow-suggestion").addEventListener("click", follow);
byId("play").addEventListener("click", playOrPause);
byId("step").addEventListener("click", step);
byId("stop").addEventListener("click", () => app.stop());
byId("flip").addEventListener("click", () => {
  facing = facing === "environment" ? "user" : "environment";
  camera({ facing });
});
byId("seek").addEventListener("input", ({ target }) => app.player.seek(Number(target.value)));
byId("add-target").addEventListener("click", add);
byId("record").addEventListener("click", record);
byId("key-cancel").addEventListener("click", () => byId("key-dialog").close("cancel"));
byId("open-keys").addEventListener("click", () => byId("keys-dialog").showModal());
byId("export").addEventListener("click", ({ target }) => {
  const { format } = target.closest("button")?.dataset ?? {};
  if (format) exportBoxes(format);
});
byId("export").addEventListener("toggle", ({ newState }) => newState === "open" && above(byId("export"), byId("open-export")));
byId("settings").elements.camera.addEventListener("change", ({ target }) => camera({ deviceId: target.value }));

const stage = byId("stage");
for (const kind of ["dragenter", "dragover"]) {
  stage.addEventListener(kind, (event) => {
    event.preventDefault();
    stage.dataset.drop = "";
  });
}
for (const kind of ["dragleave", "drop"]) stage.addEventListener(kind, () => delete stage.dataset.drop);
stage.addEventListener("drop", (event) => {
  event.preventDefault();
  const [file] = event.dataTransfer.files;
  if (file) app.open(() => openFile(file));
});

document.addEventListener("keydown", (event) => {
  const { target } = event;
  const busy = target.closest("input, select, textarea, dialog, [popover]");
  if (busy || event.ctrlKey || event.metaKey || event.altKey || event.defaultPrevented) return;
  const on = target.closest("button, a");
  const keys = { ".": step, a: add, r: record, Delete: () => app.chosen !== null && app.remove(app.chosen) };
  if (event.key === " " && !on) playOrPause();
  else if (/^[1-9]$/.test(event.key)) app.choose(Number(event.key));
  else if (keys[event.key]) keys[event.key]();
  else return;
  event.preventDefault();
});

addEventListener("pagehide", () => app.tracking?.abandon());
addEventListener("pageshow", ({ persisted }) => persisted && location.reload());
addEventListener("online", () => app.state === "idle" && connection("Ready", "idle"));

async function camera(which) {
  if (await app.open(() => openCamera(which))) await listCameras();
}

async function listCameras() {
  const found = await cameras();
  const current = app.source?.video.srcObject?.getVideoTracks()[0]?.getSettings().deviceId;
  const options = found.map(({ deviceId, label }, i) => el("option", { value: deviceId, textContent: label || `Camera ${i + 1}` }));
  byId("settings").elements.camera.replaceChildren(...options);
  if (current) byId("settings").elements.camera.value = current;
  byId("camera-row").hidden = found.length < 2;
  byId("flip").hidden = found.length < 2;
}

async function follow() {
  const { suggestion } = app.stage.scene;
  if (suggestion) await app.box(suggestion);
}

function playOrPause() {
  if (!app.source) return;
  if (app.player.playing) app.player.pause();
  else app.play();
}

function step() {
  if (app.source) app.player.step();
}

function add() {
  if (app.state !== "tracking") return;
  app.adding = !app.adding;
  changed();
}

async function record() {
  if (app.recorder.running) {
    const { blob, suffix } = await app.recorder.stop();
    download(blob, `${fileName()}.${suffix}`);
  } else if (app.source && Recorder.possible) {
    app.recorder.start(app.stage.picture);
  }
  changed();
}

function exportBoxes(format) {
  const { frames } = app.history;
  const text = format === "csv" ? toCsv(frames) : toJson(frames, app.source?.name ?? null);
  download(new Blob([text], { type: format === "csv" ? "text/csv" : "application/json" }), `${fileName()}.${format}`);
  byId("export").hidePopover();
}

function fileName() {
  const stem = (app.source?.name ?? "boxes").replace(/\.[^.]*$/, "").replace(/[^\w-]+/g, "-").toLowerCase();
  return `mfcmt-${stem}-${new Date().toISOString().slice(0, 19).replace(/[:T]/g, "")}`;
}

async function askKey(error) {
  const dialog = byId("key-dialog");
  if (key.get() && error.code === "unauthenticated") byId("key-text").textContent = "This key is not valid. Enter another one.";
  key.forget();
  byId("key").value = dialog.returnValue = "";
  dialog.showModal();
  await new Promise((done) => dialog.addEventListener("close", done, { once: true }));
  if (dialog.returnValue !== "ok" || !byId("key").value) return false;
  key.set(byId("key").value.trim());
  return true;
}

/** Place the menu above the button that opened it. */
function above(menu, button) {
  const { right, top } = button.getBoundingClientRect();
  const { width, height } = menu.getBoundingClientRect();
  menu.style.left = `${Math.max(8, right - width)}px`;
  menu.style.top = `${Math.max(8, top - height - 8)}px`;
}

/** Update controls and hints to the present state. */
function changed() {
  const { state, source, player } = app;
  const here = source !== null;
  document.documentElement.dataset.state = state;
  byId("welcome").hidden = here;
  byId("change-source").hidden = !here;
  byId("play").disabled = !here;
  byId("play").setAttribute("aria-label", player.playing ? "Pause" : player.ended ? "Back to the beginning" : "Play");
  byId("play-icon").setAttribute("href", player.playing ? "#i-pause" : "#i-play");
  byId("step").disabled = !here || state === "starting";
  byId("stop").disabled = state !== "tracking" && state !== "ended";
  byId("add-target").disabled = state !== "tracking";
  byId("add-target").setAttribute("aria-pressed", app.adding);
  byId("open-export").disabled = app.history.frames.length === 0;
  byId("record").disabled = !here || !Recorder.possible;
  byId("record").setAttribute("aria-pressed", app.recorder.running);
  byId("record-text").textContent = app.recorder.running ? "Save" : "Record";
  byId("recording").hidden = !app.recorder.running;
  byId("recording-time").textContent = app.clock(app.recorder.seconds).split(".")[0];
  if (!here || source.live) byId("flip").hidden ||= !here;
  else byId("flip").hidden = true;
  position();
  suggestion();
  const words = hint();
  byId("hint").hidden = !words;
  if (byId("hint").textContent !== words) byId("hint").textContent = words;
}

function position() {
  const { source, state } = app;
  const file = source !== null && !source.live;
  byId("seek-row").hidden = !file;
  byId("clock").textContent = source ? (file ? `${app.clock()} / ${app.clock(source.duration)}` : app.clock(source.time)) : "";
  if (!file) return;
  byId("seek").max = source.duration;
  byId("seek").disabled = state !== "open"; // a jump would lose the targets
  if (document.activeElement !== byId("seek") || state !== "open") byId("seek").value = source.time;
}

function suggestion() {
  const box = app.state === "open" ? app.stage.scene.suggestion : null;
  const button = byId("follow-suggestion");
  button.hidden = !box || app.stage.scene.draft !== null;
  if (button.hidden) return;
  const rect = app.stage.rect();
  button.style.left = `${rect.x + (box[0] + box[2] / 2) * rect.w - button.offsetWidth / 2}px`;
  button.style.top = `${rect.y + (box[1] + box[3]) * rect.h + 12}px`;
}

function hint() {
  const { state, stage: { byKeys }, player, chosen, adding } = app;
  if (byKeys) return "Arrows move the box, Shift and arrows resize it, Enter sets it, Esc cancels";
  if (state === "starting") return "Starting…";
  if (state === "open") return app.stage.scene.suggestion ? "Or drag a box around anything else" : "Drag a box around what to follow";
  if (state !== "tracking") return "";
  if (adding) return "Drag a box around the new target";
  if (chosen === null) return "Drag a box around what to follow";
  if (player.ended) return "End of the video";
  if (app.history.targets.get(chosen)?.status === "lost") return `Target ${chosen} is lost, and the tracker searches for it. Draw a box to correct it.`;
  return player.playing ? "" : `A new box corrects target ${chosen}`;
}

changed();
if (location.hash === "#demo") app.open(openSample).then((opened) => opened && follow());
