/** From a stream's pixels to the images that it sends: scaled to the session's frame, cut to what is needed. */

import { openEncoder, sizeOf } from "./encoder.js";
import { fittedSize } from "./pixels.js";

// Every so many cuts the whole frame is encoded too, to know what regions save.
const WEIGH_EVERY = 30;
// For each frame in flight that the server leaves no room for, so much of the largest target on each side.
const ROOM_PER_FRAME = 0.25;
const SCALE_TOLERANCE_PX = 1;

export class Cutter {
  encoder = null;
  #where;
  #opening = null;
  #closed = false;
  #cuts = 0;
  #density = 1; // bytes a pixel of the whole frame over those of the cut

  constructor(where) {
    this.#where = where;
  }

  /**
   * `{bytes, region, saved}` of a captured image. `sessionSize` is the frame that the session knows, `needed` the region
   * that the trackers look at (null: the whole), `targets` and `ahead` how much they may move before this frame is tracked.
   * Closes the image unless it is to be kept.
   */
  async encode(image, { sessionSize, maxSide, needed, targets, ahead, imageType, quality, keep }) {
    const size = frameSize(sizeOf(image), sessionSize, maxSide);
    const same = size[0] === sessionSize[0] && size[1] === sessionSize[1];
    const region = needed && same ? grown(needed, targets, ahead, size) : null;
    const weigh = region !== null && this.#cuts++ % WEIGH_EVERY === 0;
    this.#opening ??= openEncoder(this.#where);
    this.encoder = await this.#opening;
    if (this.#closed) this.encoder.close();
    const how = { size, region, imageType, quality, weigh };
    const { bytes, wholeBytes } = await this.encoder.encode(image, how, keep);
    return { bytes, region, saved: region ? this.#saved(bytes.length, area(size) / area(region.slice(2)), wholeBytes) : 0 };
  }

  /** What the whole frame would have cost more, by the last one weighed: its light may change, its contents change less. */
  #saved(cutBytes, areas, wholeBytes) {
    if (wholeBytes !== null) this.#density = wholeBytes / cutBytes / areas;
    return Math.max(0, cutBytes * areas * this.#density - cutBytes);
  }

  close() {
    this.#closed = true;
    this.encoder?.close();
  }
}

const area = ([width, height]) => width * height;

/** The size to send a picture in: the session's where the shape is the same, else bounded by its longer side. */
export function frameSize([width, height], [w, h], maxSide) {
  const near = (a, b) => Math.abs(a - b) <= SCALE_TOLERANCE_PX;
  const fitted = fittedSize(width, height, maxSide ?? Math.max(w, h));
  if (near(fitted[0], w) && near(fitted[1], h)) return [w, h];
  const alike = near((width / height) * h, w) || near((height / width) * w, h);
  return alike && !maxSide ? [w, h] : fitted;
}

/** A region with room for `ahead` more frames; null where it is the whole frame. */
export function grown([x, y, w, h], targets, ahead, [width, height]) {
  const room = (side) => Math.ceil(ahead * ROOM_PER_FRAME * Math.max(0, ...targets.map(({ box }) => box[side])));
  const [left, top] = [Math.max(0, x - room(2)), Math.max(0, y - room(3))];
  const right = Math.min(width, x + w + room(2));
  const bottom = Math.min(height, y + h + room(3));
  const whole = left === 0 && top === 0 && right === width && bottom === height;
  return whole ? null : [left, top, right - left, bottom - top];
}
