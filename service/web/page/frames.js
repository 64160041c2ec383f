// Canvases for frames in flight, which are reused.

export class Frames {
  #free = [];

  /** A frame: the picture of `video` at `time`, scaled to `size`. */
  grab(video, [width, height], time) {
    const canvas = this.#free.pop() ?? document.createElement("canvas");
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    canvas.getContext("2d").drawImage(video, 0, 0, width, height);
    return { canvas, time };
  }

  /** Take a frame back for reuse. */
  release({ canvas }) {
    this.#free.push(canvas);
  }
}
