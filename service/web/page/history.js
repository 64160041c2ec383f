// The history of every target: path, scores and status, and every box for the export.

export const KEPT = 240; // samples of a strip
const MAX_ROWS = 400_000;

/** Boxes are fractions of the frame here, so that they stay right when the frame's size changes. */
export class History {
  targets = new Map();
  #frames = [];
  #rows = 0;
  #next = 1;

  /** A number for a new target. */
  number() {
    return this.#next++;
  }

  clear() {
    this.targets.clear();
    this.#frames = [];
    this.#rows = 0;
    this.#next = 1;
  }

  /**
   * Add a result. `ids` are the page's numbers for its targets, `of` is the source's size at `time`.
   * Returns the changes of status.
   */
  note({ seq, size, targets }, ids, time, of) {
    const [width, height] = size;
    const changes = [];
    const rows = targets.map((target, i) => {
      const [x, y, w, h] = target.box;
      const box = [x / width, y / height, w / width, h / height];
      const id = ids[i];
      const known = this.targets.get(id) ?? { id, status: null, trail: [], samples: [] };
      if (known.status !== target.status) changes.push({ id, from: known.status, to: target.status, seq, time });
      Object.assign(known, { status: target.status, confidence: target.confidence, box, maps: target.maps ?? null });
      push(known.trail, [box[0] + box[2] / 2, box[1] + box[3] / 2], KEPT);
      const { status, reliable, confidence, scores, flags, psr, scale } = target;
      push(known.samples, { confidence, scores, flags, psr, status }, KEPT);
      this.targets.set(id, known);
      return { target: id, box, status, reliable, scores, psr, scale, confidence };
    });
    for (const id of this.targets.keys()) if (!ids.includes(id)) this.targets.delete(id);
    this.#keep({ seq, time, size: of, rows });
    return changes;
  }

  /** Clear the trail of a target that was corrected. */
  restart(id) {
    const known = this.targets.get(id);
    if (known) known.trail.length = 0;
  }

  get frames() {
    return this.#frames;
  }

  /** The number of the next frame, for a new session that goes on. */
  get next() {
    return (this.#frames.at(-1)?.seq ?? -1) + 1;
  }

  #keep(frame) {
    const last = this.#frames.at(-1);
    if (last && last.time === frame.time) this.#rows -= this.#frames.pop().rows.length; // the same frame again, after a correction
    this.#frames.push(frame);
    this.#rows += frame.rows.length;
    while (this.#rows > MAX_ROWS) this.#rows -= this.#frames.shift().rows.length;
  }
}

function push(list, value, most) {
  list.push(value);
  if (list.length > most) list.shift();
}
