/** Encodes pixels; runs in the worker and on the main thread alike. */

/** Return the size of a `width`×`height` frame whose longer side may be `maxSide` at most. */
export function fittedSize(width, height, maxSide) {
  const scale = maxSide ? Math.min(1, maxSide / Math.max(width, height)) : 1;
  return [Math.max(1, Math.round(width * scale)), Math.max(1, Math.round(height * scale))];
}

/** Encodes images on a canvas of its own. */
export class CanvasEncoder {
  #canvas = typeof OffscreenCanvas === "undefined" ? document.createElement("canvas") : new OffscreenCanvas(1, 1);

  /**
   * Scale `image` to `size` and encode the part `region` of that; resolves with `{blob, wholeBytes}`. With `weigh`,
   * `wholeBytes` is the size that the whole frame would have, else null.
   */
  async encode(image, { size, region, imageType, quality, weigh }) {
    const whole = [0, 0, ...size];
    const blob = await this.#blob(image, size, region ?? whole, imageType, quality);
    const wholeBytes = weigh && region ? (await this.#blob(image, size, whole, imageType, quality)).size : null;
    return { blob, wholeBytes };
  }

  async #blob(image, [frameWidth, frameHeight], [x, y, width, height], type, quality) {
    const canvas = this.#canvas;
    if (canvas.width !== width || canvas.height !== height) {
      canvas.width = width;
      canvas.height = height;
    }
    const context = canvas.getContext("2d", { alpha: false, willReadFrequently: true });
    const scaleX = (image.displayWidth ?? image.width) / frameWidth;
    const scaleY = (image.displayHeight ?? image.height) / frameHeight;
    context.drawImage(image, x * scaleX, y * scaleY, width * scaleX, height * scaleY, 0, 0, width, height);
    if (canvas.convertToBlob) return canvas.convertToBlob({ type, quality });
    return new Promise((resolve, reject) => {
      canvas.toBlob((blob) => (blob ? resolve(blob) : reject(new Error("the canvas gave no image"))), type, quality);
    });
  }
}
