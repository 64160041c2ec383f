/** Encodes pixels; runs in the worker and on the main thread alike. */

/** Return the size of a `width`×`height` frame whose longer side may be `maxSide` at most. */
export function fittedSize(width, height, maxSide) {
  const scale = maxSide ? Math.min(1, maxSide / Math.max(width, height)) : 1;
  return [Math.max(1, Math.round(width * scale)), Math.max(1, Math.round(height * scale))];
}

// The two functions below are also sent to workers as text, so they use nothing of this module.

/**
 * Return an encoder with a canvas of its own. Its `encode(image, {size, region, imageType, quality, weigh})` scales
 * `image` to `size` and encodes the part `region` of that; it resolves with `{blob, wholeBytes}`. With `weigh`,
 * `wholeBytes` is the size that the whole frame would have, else null.
 */
export function canvasEncoder() {
  const canvas = typeof OffscreenCanvas === "undefined" ? document.createElement("canvas") : new OffscreenCanvas(1, 1);

  const drawn = async (image, [frameWidth, frameHeight], [x, y, width, height], type, quality) => {
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
  };

  return {
    async encode(image, { size, region, imageType, quality, weigh }) {
      const whole = [0, 0, size[0], size[1]];
      const blob = await drawn(image, size, region ?? whole, imageType, quality);
      const wholeBytes = weigh && region ? (await drawn(image, size, whole, imageType, quality)).size : null;
      return { blob, wholeBytes };
    },
  };
}

/** Serve a worker's messages: `{id, image, how}` in, `{id, bytes, wholeBytes}` or `{id, error}` out. */
export function serveEncoder(scope, encoder) {
  scope.onmessage = async ({ data: { id, image, how } }) => {
    try {
      const { blob, wholeBytes } = await encoder.encode(image, how);
      const bytes = await blob.arrayBuffer();
      scope.postMessage({ id, bytes, wholeBytes }, [bytes]);
    } catch (error) {
      scope.postMessage({ id, error: String(error) });
    } finally {
      image.close();
    }
  };
  scope.postMessage({ up: true });
}
