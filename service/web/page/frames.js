// Canvases for frames in flight, which are reused.

export class Frames {
  #free = [];

  /** A frame: what `source` shows (it has `draw(context, width, height)`, `time` and `index`), scaled to `size`. */
  grab(source, [width, height]) {
    const canvas = this.#free.pop() ?? document.createElement("canvas");
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    source.draw(canvas.getContext("2d"), width, height);
    return { canvas, time: source.time, index: source.index };
  }

  /** Take a frame back for reuse. */
  release({ canvas }) {
    this.#free.push(canvas);
  }
}
