// Plays a source into `deliver`: as it runs, or (exact) frame by frame however long each takes.

export class Player {
  source = null;
  playing = false;
  ended = false;
  exact = false;
  #held = false;
  #stepping = false;
  #march = 0;
  #delivered = Promise.resolve();

  /**
   * `deliver` takes the frame that is shown and resolves when the next may come; `preview` shows one that nobody
   * asked to be delivered; `changed` hears of playing, pausing and the end.
   */
  constructor({ deliver, preview, changed }) {
    Object.assign(this, { deliver, preview, changed });
  }

  open(source) {
    this.close();
    this.source = source;
    this.ended = false;
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

  /** The next frame only. */
  async step() {
    if (this.playing) this.pause();
    if (this.#stepping || !this.source) return;
    this.#stepping = true;
    try {
      if (await this.source.step()) await this.#delivered;
      else this.#end();
    } finally {
      this.#stepping = false;
    }
  }

  async seek(time) {
    this.ended = false;
    await this.source?.seek(time);
  }

  /** Stand still while a box is drawn; a camera cannot. */
  hold(on) {
    if (!this.source || this.#held === on) return;
    this.#held = on;
    if (!this.playing) return;
    if (on) this.#rest();
    else this.#go();
  }

  /** After `exact` was changed. */
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
    if (!this.exact || this.source.live) return this.source.play();
    const march = ++this.#march;
    while (march === this.#march) {
      if (!(await this.source.step())) {
        this.#end();
        return;
      }
      await this.#delivered;
    }
  }

  #frame() {
    const wanted = this.#stepping || (this.playing && (!this.#held || this.source.live));
    if (wanted) this.#delivered = this.deliver();
    else if (!this.source.live) this.preview();
  }

  #end() {
    if (!this.source) return;
    this.ended = true;
    this.pause();
  }
}
