// The list of runs: show one again, export it, remove it.

import { agreement } from "./compare.js";
import { byId, el, icon } from "./dom.js";

export class RunList {
  #app;
  #drawn = "";

  constructor(app) {
    this.#app = app;
  }

  draw() {
    const { list, shown } = this.#app.runs;
    const { other } = this.#app.view;
    const rows = list.map((run, i) => ({ run, number: i + 1, text: summary(run), compared: run === other }));
    byId("runs-card").hidden = list.length === 0 && this.#app.source === null;
    byId("import").disabled = !this.#app.source || this.#app.source.live;
    const key = JSON.stringify(rows.map(({ text, run, compared }) => [text, run === shown, compared, shown?.opening === run.opening]));
    if (key === this.#drawn) return;
    this.#drawn = key;
    const focused = document.activeElement?.closest?.("#runs li")?.dataset.run;
    const part = document.activeElement?.dataset?.part;
    const found = shown && other ? agreement(shown, other) : null;
    this.#app.view.comparison.tell(found);
    byId("runs").replaceChildren(...rows.map((one) => this.#row(one, shown, found)));
    if (focused && part) byId("runs").querySelector(`li[data-run="${focused}"] [data-part="${part}"]`)?.focus();
  }

  #row({ run, number, text, compared }, shown, found) {
    const says = compared && found ? `${text}; ${told(found)}` : text;
    const pick = el("button", { className: "pick", data: { part: "pick" } }, el("b", { textContent: `${number} ${run.title ?? run.source.name}` }), el("small", { textContent: says }));
    pick.setAttribute("aria-pressed", run === shown);
    pick.addEventListener("click", () => this.#app.edits.show(run));
    const remove = el("button", { className: "icon", title: "Remove the run; undo brings it back", data: { part: "remove" } }, icon("remove"));
    remove.setAttribute("aria-label", `Remove run ${number}`);
    remove.addEventListener("click", () => this.#app.edits.removeRun(run));
    const compare = el("button", { className: "icon", title: "Compare with the run that is shown", data: { part: "compare" } }, icon("compare"));
    compare.setAttribute("aria-label", `Compare with run ${number}`);
    compare.setAttribute("aria-pressed", compared);
    compare.hidden = !shown || run === shown || run.opening !== shown.opening;
    compare.addEventListener("click", () => this.#app.view.compare(compared ? null : run));
    return el("li", { data: { run: number, chosen: run === shown, saved: run.saved } }, pick, compare, remove);
  }
}

const told = ({ count, iou, half }) => (count ? `overlap ${iou.toFixed(2)}, above half in ${Math.round(100 * half)} % of ${count} boxes` : "no frame in common");

/** Say how much of its source a run covers. */
export function summary({ records, source, targets, saved }) {
  const of = source.count === null || source.count === undefined ? `${records.length} frames` : `${records.length} of ${source.count} frames`;
  const things = targets.size === 1 ? "1 target" : `${targets.size} targets`;
  return `${of}, ${things}${saved ? "" : ", not exported"}`;
}
