// Plays a source into `deliver`: in real time, or (exact) frame by frame, however long each takes.

const LATE_MS = 500; // who is later than that does not catch up

export class Player {
  source = null;
  playing = false;
  ended = false;
  exact = false;
  #holds = new Set();
  #stepping = false;
  #march = 0;
  #pace = { wall: 0, time: Infinity };
  #delivered = Promise.resolve();
  #moving = Promise.resolve();

  /**
   * `deliver` takes the frame that is shown, and resolves when the next one may come. `preview` shows a frame that is not
   * delivered. `changed` is called on play, pause and the end, `failed(error)` when the source breaks.
   */
  constructor({ deliver, preview, changed, failed }) {
    Object.assign(this, { deliver, preview, changed, failed });
  }

  open(source) {
    this.close();
    this.source = source;
    this.ended = this.#stepping = false;
    this.#moving = this.#delivered = Promise.resolve();
    source.onframe = () => this.#frame();
    source.onend = () => this.#end();
    this.playing = source.live;
    this.changed();
  }

  close() {
    this.#march++;
    this.source?.close();
    this.source = null;
    this.playing = false;
    this.#holds.clear();
  }

  async play() {
    if (!this.source) return;
    if (this.ended) await this.source.seek(0);
    this.ended = false;
    this.playing = true;
    this.changed();
    if (!this.#holds.size) await this.#go();
  }

  pause() {
    this.playing = false;
    this.#rest();
    this.changed();
  }

  /** Go on by one frame. */
  async step() {
    if (this.playing) this.pause();
    if (this.source && !(await this.#advance())) this.#end();
  }

  /** Show another place of a file, without delivering it. `to(source)` moves the source there. */
  async move(to) {
    this.ended = false;
    await (this.#moving = this.#moving.then(() => this.source && to(this.source)).catch((error) => this.failed(error)));
  }

  /** Stand still for a reason (`on`), until it is over. A live source goes on. */
  hold(why, on) {
    if (!this.source || this.#holds.has(why) === on) return;
    const before = this.#holds.size;
    if (on) this.#holds.add(why);
    else this.#holds.delete(why);
    if (!this.playing || Boolean(before) === Boolean(this.#holds.size)) return;
    if (on) this.#rest();
    else this.#go();
  }

  held(why) {
    return this.#holds.has(why);
  }

  /** Apply a change of `exact`. */
  async refresh() {
    if (!this.playing || this.#holds.size) return;
    this.#rest();
    await this.#go();
  }

  /** Resolves when it is time for the frame of `time`, so that frames that need no work play in real time. */
  async inTime(time) {
    const now = performance.now();
    const due = this.#pace.wall + 1000 * (time - this.#pace.time);
    if (time <= this.#pace.time || due < now - LATE_MS || due > now + 10 * LATE_MS) this.#pace = { wall: now, time };
    else if (due > now) await new Promise((done) => setTimeout(done, due - now));
  }

  #rest() {
    this.#march++;
    this.source?.pause();
  }

  async #go() {
    this.#pace.time = Infinity;
    if (this.exact && !this.source.live) this.#walk(++this.#march);
    else await this.source.play();
  }

  /** Play frame by frame until it is stopped. */
  async #walk(march) {
    try {
      while (march === this.#march) {
        if (await this.#advance()) continue;
        if (march === this.#march) this.#end();
        return;
      }
    } catch (error) {
      this.pause();
      this.failed(error);
    }
  }

  /** Go on by one frame after those in flight. Resolves to false at the end. */
  #advance() {
    const one = async () => {
      if (!this.source) return true;
      this.#stepping = true;
      try {
        if (!(await this.source.step())) return false;
        await this.#delivered;
        return true;
      } finally {
        this.#stepping = false;
      }
    };
    return (this.#moving = this.#moving.then(one, one));
  }

  #frame() {
    const { live } = this.source;
    const running = this.playing && (live || !(this.#holds.size || this.exact));
    if (running || this.#stepping) this.#delivered = this.deliver();
    else if (!live) this.preview();
  }

  #end() {
    if (!this.source) return;
    this.ended = true;
    this.pause();
  }
}
