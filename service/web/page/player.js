// Plays a source into `deliver`: in real time, or (exact) frame by frame, however long each takes.

export class Player {
  source = null;
  playing = false;
  ended = false;
  exact = false;
  #held = false;
  #stepping = false;
  #march = 0;
  #delivered = Promise.resolve();
  #moving = Promise.resolve();

  /**
   * `deliver` takes the frame that is shown, and resolves when the next one may come. `preview` shows a frame that is not
   * delivered. `changed` is called on play, pause and the end.
   */
  constructor({ deliver, preview, changed }) {
    Object.assign(this, { deliver, preview, changed });
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
    this.playing = this.#held = false;
  }

  async play() {
    if (!this.source) return;
    if (this.ended) await this.source.seek(0);
    this.ended = false;
    this.playing = true;
    this.changed();
    if (!this.#held) await this.#go();
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

  async seek(time) {
    this.ended = false;
    await this.source?.seek(time);
  }

  /** Stop while a box is drawn. A camera goes on. */
  hold(on) {
    if (!this.source || this.#held === on) return;
    this.#held = on;
    if (!this.playing) return;
    if (on) this.#rest();
    else this.#go();
  }

  /** Apply a change of `exact`. */
  async refresh() {
    if (!this.playing || this.#held) return;
    this.#rest();
    await this.#go();
  }

  #rest() {
    this.#march++;
    this.source?.pause();
  }

  async #go() {
    if (this.exact && !this.source.live) this.#walk(++this.#march);
    else await this.source.play();
  }

  /** Play frame by frame until it is stopped. */
  async #walk(march) {
    while (march === this.#march) {
      if (!(await this.#advance())) {
        this.#end();
        return;
      }
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
    const running = this.playing && (live || !(this.#held || this.exact));
    if (running || this.#stepping) this.#delivered = this.deliver();
    else if (!live) this.preview();
  }

  #end() {
    if (!this.source) return;
    this.ended = true;
    this.pause();
  }
}
