// Frames that are on their way: canvases that are used again.

export class Frames {
  #free = [];

  /** What `video` shows at `time`, brought to `size`. */
  grab(video, [width, height], time) {
    const canvas = this.#free.pop() ?? document.createElement("canvas");
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    canvas.getContext("2d").drawImage(video, 0, 0, width, height);
    return { canvas, time };
  }

  /** The frame is needed no more. */
  release({ canvas }) {
    this.#free.push(canvas);
  }
}
