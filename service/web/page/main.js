// The page's controls: what each button and key does.

import { App } from "./app.js";
import { Controls } from "./controls.js";
import { byId, download, el } from "./dom.js";
import { Exporter, fileName } from "./exporter.js";
import { key } from "./tracking.js";
import { Recorder } from "./recorder.js";
import { Link } from "./link.js";
import { cameras, openCamera, openScreen } from "./sources/live.js";
import { openFiles, openSample } from "./sources/open.js";

const app = new App({ changed: () => controls.update(), askKey, keepRecording: record });
const controls = new Controls(app);
const exporter = new Exporter(app);
let facing = "environment";

const on = (id, does, event = "click") => byId(id).addEventListener(event, does);
const files = (chosen) => app.open(() => openFiles(chosen));

on("choose-sample", () => app.open(openSample));
on("choose-camera", () => camera({ facing }));
on("choose-screen", () => app.open(openScreen));
on("choose-file", () => byId("file").click());
on("choose-folder", () => byId("folder").click());
for (const id of ["file", "folder"]) {
  on(id, ({ target }) => {
    const chosen = [...target.files];
    if (chosen.length) files(chosen);
    target.value = "";
  }, "change");
}
on("import", () => byId("import-file").click());
on("import-file", ({ target }) => {
  if (target.files.length) app.edits.import(target.files[0]);
  target.value = "";
}, "change");
on("change-source", () => app.close());
on("follow-suggestion", follow);
on("play", playOrPause);
on("step", () => app.step());
on("back", () => app.back());
on("stop", () => app.edits.stop());
on("undo", () => app.edits.undo());
on("redo", () => app.edits.undo(false));
on("flip", () => {
  facing = facing === "environment" ? "user" : "environment";
  camera({ facing });
});
on("seek", ({ target }) => app.goTo(Number(target.value)), "input");
on("add-target", () => intend("add"));
on("join", () => app.edits.join());
on("redraw-target", () => intend("correct"));
on("record", record);
on("key-cancel", () => byId("key-dialog").close("cancel"));
on("open-keys", shortcuts);
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
  const chosen = [...event.dataTransfer.files];
  if (chosen.length) files(chosen);
});

const JUMP_S = 1;

const KEYS = {
  j: () => jump(-JUMP_S),
  k: playOrPause,
  l: () => jump(JUMP_S),
  ".": () => app.step(),
  ",": () => app.back(),
  a: () => intend("add"),
  b: () => app.edits.join(),
  c: correct,
  r: record,
  "+": () => app.stage.zoom.step(true),
  "=": () => app.stage.zoom.step(true),
  "-": () => app.stage.zoom.step(false),
  0: () => app.stage.zoom.reset(),
  "?": shortcuts,
  Delete: () => app.chosen !== null && app.edits.remove(app.chosen),
  Backspace: () => app.chosen !== null && app.edits.remove(app.chosen),
};

document.addEventListener("keydown", (event) => {
  const { target } = event;
  const busy = target.closest("select, textarea, dialog, [popover], input:not([type=range])");
  if (busy || event.altKey || event.defaultPrevented) return;
  const name = event.key.length === 1 ? event.key.toLowerCase() : event.key;
  if (event.ctrlKey || event.metaKey) {
    if (name !== "z" && name !== "y") return;
    app.edits.undo(name === "z" && !event.shiftKey);
  } else if (event.key === " " && !target.closest("button, a")) {
    playOrPause();
  } else if (/^[1-9]$/.test(name)) {
    app.edits.choose(Number(name));
  } else if (KEYS[name]) {
    KEYS[name]();
  } else {
    return;
  }
  event.preventDefault();
});

addEventListener("pageshow", ({ persisted }) => persisted && location.reload());
addEventListener("beforeunload", (event) => app.runs.unsaved && event.preventDefault());

async function camera(which) {
  if (await app.open(() => openCamera(which))) await listCameras();
}

async function listCameras() {
  const found = await cameras();
  const current = app.source?.video?.srcObject?.getVideoTracks()[0]?.getSettings().deviceId;
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
  if (app.player.playing) app.player.pause();
  else app.play();
}

/** Move a file by a number of seconds. */
function jump(seconds) {
  const { source, shown } = app;
  if (source && !source.live) app.move((one) => one.seek(Math.min(Math.max(0, shown.time + seconds), source.duration)));
}

function intend(what) {
  if (!app.run || (what === "correct" && app.chosen === null)) return;
  app.intent = app.intent === what ? null : what;
  controls.update();
}

/** Correct the chosen target: at once with the keyboard, where the picture has the focus. */
function correct() {
  if (document.activeElement === stage && app.run) app.stage.begin(true);
  else intend("correct");
}

function shortcuts() {
  byId("keys-dialog").showModal();
}

async function record() {
  if (app.recorder.running) {
    const name = fileName(app.source);
    const { blob, suffix } = await app.recorder.stop();
    download(blob, `${name}.${suffix}`);
  } else if (app.source && Recorder.possible) {
    await app.recorder.start(app.stage.picture);
  }
  controls.update();
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

controls.update();
exporter.update();
if (location.hash === "#demo") app.open(openSample).then((opened) => opened && follow());
else Link.here()?.open(app);
