// One run: what was followed in a source, where it was in each frame, and where a person set it.

import { at } from "./sources/times.js";

const MAX_ROWS = 400_000;

/**
 * A record is a frame: `{time, frame, seq, size, rows}`, by rising time. `frame` is its number in the source, from 0, or
 * null; `size` is the source's; `rows` maps the number of a target to its row. Boxes are fractions of the frame, so that
 * they stay right when the frame's size changes. Records and rows are never changed, only replaced.
 */
export class Run {
  /** `{id, name, kind, until}` by number; `until` is the time at which the target was removed, else Infinity. */
  targets = new Map();
  records = [];
  /** Boxes that a person set: `{time, target, box}`, by time. */
  marks = [];
  saved = true;
  #times = [];
  #ends = new Map(); // target → time of its last row
  #rows = 0;
  #next = 1;

  /** `source` is `{name, kind, fps, count, duration, size}`; `options` are the tracker's settings. */
  constructor(source, options) {
    Object.assign(this, { source, options });
  }

  /** Add a target; returns its number. */
  add({ id = this.#next, name = String(id), kind = "object" } = {}) {
    this.#next = Math.max(this.#next, id + 1);
    this.targets.set(id, { id, name, kind, until: Infinity });
    return id;
  }

  /** Name a target, or end it: `changes` has some of `name`, `kind`, `until`. */
  change(id, changes) {
    this.targets.set(id, { ...this.targets.get(id), ...changes });
    this.saved = false;
  }

  forget(id) {
    this.targets.delete(id);
    this.cut(id, -Infinity);
    this.marks = this.marks.filter(({ target }) => target !== id);
  }

  mark(time, target, box) {
    this.marks = [...this.marks.filter((one) => one.time !== time || one.target !== target), { time, target, box }].sort((a, b) => a.time - b.time);
    this.saved = false;
  }

  /** Add rows to the frame of `time`, in place of those of the same targets. */
  put({ time, rows, ...about }) {
    const place = this.place(time);
    const old = this.#times[place] === time ? this.records[place] : null;
    const record = { ...about, time, rows: new Map([...(old?.rows ?? []), ...rows]) };
    if (old) {
      this.records[place] = record;
    } else {
      const next = this.#times.length && this.#times[place] < time ? place + 1 : place;
      this.records.splice(next, 0, record);
      this.#times.splice(next, 0, time);
    }
    this.#rows += record.rows.size - (old?.rows.size ?? 0);
    for (const id of rows.keys()) this.#ends.set(id, Math.max(time, this.#ends.get(id) ?? -Infinity));
    while (this.#rows > MAX_ROWS) {
      this.#rows -= this.records.shift().rows.size;
      this.#times.shift();
    }
    this.saved = false;
  }

  /** Take away the rows of a target that are later than `time`. */
  cut(id, time) {
    this.records = this.records.map((record) => (record.time > time && record.rows.has(id) ? without(record, id) : record));
    this.#settle();
    this.saved = false;
  }

  /** Return the index of the last record that is not after `time`. */
  place(time) {
    return at(this.#times, time);
  }

  /** Return the record of exactly this time, or null. */
  record(time) {
    const place = this.place(time);
    return this.#times[place] === time ? this.records[place] : null;
  }

  /** Return the target's row in the frame of `time`, or the last one before; null where there is none. */
  row(id, time) {
    if (!this.records.length || time > this.end(id)) return this.record(this.end(id))?.rows.get(id) ?? null;
    for (let i = this.place(time); i >= 0 && this.#times[i] <= time; i--) {
      const row = this.records[i].rows.get(id);
      if (row) return row;
    }
    return null;
  }

  /** Return the time of the target's last row. */
  end(id) {
    return this.#ends.get(id) ?? -Infinity;
  }

  /** Return the targets that are followed at `time`. */
  alive(time = Infinity) {
    return [...this.targets.values()].filter(({ id, until }) => (time === Infinity ? until === Infinity : until > time) && this.#ends.has(id));
  }

  /** Return the time up to which all targets have been followed; null without targets. */
  get frontier() {
    const ends = this.alive().map(({ id }) => this.end(id));
    return ends.length ? Math.min(...ends) : null;
  }

  get first() {
    return this.#times[0] ?? null;
  }

  get last() {
    return this.#times.at(-1) ?? null;
  }

  /** Return the number of the next frame message, for a session that goes on. */
  get nextSeq() {
    return this.records.reduce((most, { seq }) => Math.max(most, seq), -1) + 1;
  }

  /** Return up to `most` of a target's rows up to `time`, the newest last. */
  samples(id, time, most) {
    const found = [];
    for (let i = this.place(time); i >= 0 && found.length < most; i--) {
      const row = this.records[i]?.rows.get(id);
      if (row && this.#times[i] <= time) found.push(row);
    }
    return found.reverse();
  }

  /** Return what `restore` brings back. */
  memento() {
    const { targets, records, marks, saved } = this;
    return { targets: new Map(targets), records: [...records], marks, saved, next: this.#next };
  }

  restore({ targets, records, marks, saved, next }) {
    Object.assign(this, { targets: new Map(targets), records: [...records], marks, saved });
    this.#next = next;
    this.#settle();
  }

  #settle() {
    this.records = this.records.filter(({ rows }) => rows.size);
    this.#times = this.records.map(({ time }) => time);
    this.#rows = 0;
    this.#ends.clear();
    for (const { time, rows } of this.records) {
      this.#rows += rows.size;
      for (const id of rows.keys()) this.#ends.set(id, time);
    }
  }
}

function without(record, id) {
  const rows = new Map(record.rows);
  rows.delete(id);
  return { ...record, rows };
}
