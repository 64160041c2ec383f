// All runs of this page, the one that is shown, and what undo and redo bring back.

const MOST = 40;

export class Runs {
  list = [];
  shown = null;
  #undo = [];
  #redo = [];

  /** `changed()` is called whenever the list or what is shown is another. */
  constructor(changed) {
    this.changed = changed;
  }

  /** Add a run and show it. */
  add(run) {
    this.list = [...this.list, run];
    this.show(run);
  }

  show(run) {
    this.shown = run;
    this.changed();
  }

  remove(run) {
    this.list = this.list.filter((one) => one !== run);
    this.show(this.shown === run ? null : this.shown);
  }

  /** Whether any run has boxes that were not exported. */
  get unsaved() {
    return this.list.some(({ saved, records }) => !saved && records.length);
  }

  /** Remember how everything is, before `what` is done. */
  keep(what) {
    this.#undo.push(this.#memento(what));
    this.#undo.splice(0, this.#undo.length - MOST);
    this.#redo = [];
    this.changed();
  }

  /** Take back what was kept last, for good: it could not be done. */
  giveUp() {
    this.undo();
    this.#redo.pop();
    this.changed();
  }

  get canUndo() {
    return this.#undo.at(-1)?.what ?? null;
  }

  get canRedo() {
    return this.#redo.at(-1)?.what ?? null;
  }

  /** Take back what was done last; returns what that was, or null. */
  undo() {
    return this.#swap(this.#undo, this.#redo);
  }

  redo() {
    return this.#swap(this.#redo, this.#undo);
  }

  #memento(what) {
    return { what, list: this.list, shown: this.shown, run: this.shown?.memento() };
  }

  #swap(from, to) {
    const kept = from.pop();
    if (!kept) return null;
    to.push(this.#memento(kept.what));
    this.list = kept.list;
    this.shown = kept.shown;
    if (this.shown) this.shown.restore(kept.run);
    this.changed();
    return kept.what;
  }
}
