/** Makes the images that a stream sends from pixels: scaled to the session's frame, cropped to what is needed. */

import { openEncoder, sizeOf } from "./encoder.js";
import { fittedSize } from "./pixels.js";

// Once in this many crops the whole frame is encoded too, to know what regions save.
const WEIGH_EVERY = 30;
// Margin for each frame in flight that the service leaves no room for, as a fraction of the largest target's side.
const MARGIN_PER_FRAME = 0.25;
const SCALE_TOLERANCE_PX = 1;

export class FrameCropper {
  encoder = null;
  #openWorker;
  #opening = null;
  #closed = false;
  #crops = 0;
  #density = 1; // bytes for a pixel of the whole frame, over those for a pixel of the crop

  /** `openWorker()` resolves with a worker that encodes, or null. */
  constructor(openWorker) {
    this.#openWorker = openWorker;
  }

  /**
   * Encode a captured image; returns `{bytes, region, saved, sourceSize}`. `sessionSize` is the size of the session's frame, `needed`
   * the region that the trackers look at (null for the whole), `targets` with `ahead` how far they may move before this
   * frame is tracked. The image is closed unless `keep` is set.
   */
  async encode(image, { sessionSize, maxSide, needed, targets, ahead, imageType, quality, keep }) {
    const sourceSize = sizeOf(image);
    const size = frameSize(sourceSize, sessionSize, maxSide);
    const same = size[0] === sessionSize[0] && size[1] === sessionSize[1];
    const region = needed && same ? grown(needed, targets, ahead, size) : null;
    const weigh = region !== null && this.#crops++ % WEIGH_EVERY === 0;
    this.#opening ??= openEncoder(this.#openWorker);
    this.encoder = await this.#opening;
    if (this.#closed) this.encoder.close();
    const how = { size, region, imageType, quality, weigh };
    const { bytes, wholeBytes } = await this.encoder.encode(image, how, keep);
    const saved = region ? this.#saved(bytes.length, area(size) / area(region.slice(2)), wholeBytes) : 0;
    return { bytes, region, saved, sourceSize };
  }

  /** Estimate the bytes that the whole frame would have cost more, from the last whole frame that was encoded. */
  #saved(cropBytes, areas, wholeBytes) {
    if (wholeBytes !== null) this.#density = wholeBytes / cropBytes / areas;
    return Math.max(0, cropBytes * areas * this.#density - cropBytes);
  }

  close() {
    this.#closed = true;
    this.encoder?.close();
  }
}

const area = ([width, height]) => width * height;

/** Return the size to send a picture in: the session's where the shape is the same, else bounded by its longer side. */
export function frameSize([width, height], [w, h], maxSide) {
  const near = (a, b) => Math.abs(a - b) <= SCALE_TOLERANCE_PX;
  const fitted = fittedSize(width, height, maxSide ?? Math.max(w, h));
  if (near(fitted[0], w) && near(fitted[1], h)) return [w, h];
  const alike = near((width / height) * h, w) || near((height / width) * w, h);
  return alike && !maxSide ? [w, h] : fitted;
}

/** Return a region with room for `ahead` more frames; null where it is the whole frame. */
export function grown([x, y, w, h], targets, ahead, [width, height]) {
  const room = (side) => Math.ceil(ahead * MARGIN_PER_FRAME * Math.max(0, ...targets.map(({ box }) => box[side])));
  const [left, top] = [Math.max(0, x - room(2)), Math.max(0, y - room(3))];
  const right = Math.min(width, x + w + room(2));
  const bottom = Math.min(height, y + h + room(3));
  const whole = left === 0 && top === 0 && right === width && bottom === height;
  return whole ? null : [left, top, right - left, bottom - top];
}
