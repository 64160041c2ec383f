// The export menu: what of the source was tracked, and each form as a file.

import { codeFor } from "./code.js";
import { announce, byId, download } from "./dom.js";
import { coco, cvat, yolo } from "./exports/documents.js";
import { json } from "./exports/json.js";
import { csv, mot, otb } from "./exports/lines.js";
import { connection } from "./panels.js";
import { render } from "./render.js";
import { missing } from "./view.js";

const FORMS = {
  csv: { make: csv, suffix: "csv", type: "text/csv" },
  json: { make: json, suffix: "json", type: "application/json" },
  mot: { make: mot, suffix: "txt", type: "text/plain" },
  otb: { make: otb, suffix: "txt", type: "text/plain" },
  coco: { make: coco, suffix: "coco.json", type: "application/json" },
  cvat: { make: cvat, suffix: "xml", type: "application/xml" },
  yolo: { make: yolo, suffix: "zip", type: "application/zip" },
};

export class Exporter {
  #app;
  #menu = byId("export");

  constructor(app) {
    this.#app = app;
    this.#menu.addEventListener("click", ({ target }) => {
      const { format } = target.closest("button")?.dataset ?? {};
      if (format) this.#save(format);
    });
    this.#menu.addEventListener("toggle", ({ newState }) => newState === "open" && this.update());
    byId("render").addEventListener("click", () => this.#film());
    byId("open-code").addEventListener("click", () => this.#code());
    byId("code-copy").addEventListener("click", () => {
      byId("code").select();
      navigator.clipboard?.writeText(byId("code").value).then(() => announce("Copied"));
    });
    byId("repeat").addEventListener("click", () => {
      this.#menu.hidePopover();
      app.edits.repeat();
    });
  }

  /** Make a video of the run, which is shown as far as it has come; Esc gives it up. */
  async #film() {
    const { run, view, stage } = this.#app;
    this.#menu.hidePopover();
    this.#app.player.pause();
    const film = await run.opening(); // a source of its own: the one that is shown stays where it is
    let wanted = true;
    const stop = ({ key }) => key === "Escape" && (wanted = false);
    addEventListener("keydown", stop);
    try {
      const scene = (time) => ({ ...stage.scene, targets: view.targetsAt(run, time), other: [], draft: null, suggestion: null, handles: false });
      const progress = (share) => {
        connection(`Making the video: ${Math.round(100 * share)} %`, "busy");
        return wanted;
      };
      const made = await render(run, film, { scene, progress });
      if (made) download(made.blob, `${fileName(run.source)}.${made.suffix}`);
      else if (wanted) this.#app.trouble.tell({ code: "no-encoder" });
    } catch (error) {
      this.#app.trouble.tell(error);
    } finally {
      removeEventListener("keydown", stop);
      film.close();
      this.#app.watch.pill();
    }
  }

  #code() {
    const { run } = this.#app;
    this.#menu.hidePopover();
    const last = run.records.at(-1);
    const result = { ...last, rows: Object.fromEntries(last.rows) };
    const texts = { ...codeFor(run), result: JSON.stringify(result, null, 2) };
    const show = () => (byId("code").value = texts[byId("code-kind").value]);
    byId("code-kind").onchange = show;
    show();
    byId("code-dialog").showModal();
  }

  /** Say how much was tracked, and place the menu above its button. */
  update() {
    const { run, source } = this.#app;
    if (!run) return;
    const { records } = run;
    const { count } = run.source;
    const gaps = count == null ? 0 : missing(run);
    const rest = count == null ? 0 : count - records.length;
    byId("covered").textContent = count == null ? `${records.length} frames were tracked.` : `${records.length} of ${count} frames were tracked.${gaps ? ` ${gaps} between them were left out.` : ""}`;
    byId("render").hidden = !source || source.live || typeof source.lasts !== "function";
    byId("repeat").hidden = !rest || !run.marks.length || !source || source.live;
    const { right, top } = byId("open-export").getBoundingClientRect();
    const { width, height } = this.#menu.getBoundingClientRect();
    this.#menu.style.left = `${Math.max(8, right - width)}px`;
    this.#menu.style.top = `${Math.max(8, top - height - 8)}px`;
  }

  async #save(format) {
    const { run, chosen } = this.#app;
    const { make, suffix, type } = FORMS[format];
    this.#menu.hidePopover();
    download(new Blob([await make(run, chosen)], { type }), `${fileName(run.source)}.${suffix}`);
    run.saved = true;
    this.#app.view.draw(true);
  }
}

/** A name for a file about a source, without its suffix. */
export function fileName(source) {
  const stem = (source?.name ?? "boxes").replace(/\.[^.]*$/, "").replace(/[^\w-]+/g, "-").toLowerCase();
  return `mfcmt-${stem}-${new Date().toISOString().slice(0, 19).replace(/[:T]/g, "")}`;
}
