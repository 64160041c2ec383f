/** Boxes in pixels of a frame as it was sent, and in pixels of its source. */

/** The sizes `[w, h]` of a source and of what was sent of it. */
export class Scale {
  #source;
  #x;
  #y;

  constructor(source, sent) {
    this.#source = source;
    this.#x = source[0] / sent[0];
    this.#y = source[1] / sent[1];
  }

  toSent([x, y, w, h]) {
    return [x / this.#x, y / this.#y, w / this.#x, h / this.#y];
  }

  toSource([x, y, w, h]) {
    return [x * this.#x, y * this.#y, w * this.#x, h * this.#y];
  }

  /** Return a message of the service with its `size`, `region` and boxes in pixels of the source. */
  told(message) {
    const { size, region, targets, target } = message;
    const one = (each) => ({ ...each, box: this.toSource(each.box) });
    return {
      ...message,
      ...(size && { size: this.#source }),
      ...(region && { region: this.#covered(region) }),
      ...(targets && { targets: targets.map(one) }),
      ...(target && { target: one(target) }),
    };
  }

  /** Return the region in whole pixels, none of it left out. */
  #covered(region) {
    const [x, y, w, h] = this.toSource(region);
    const [left, top] = [Math.floor(x), Math.floor(y)];
    const right = Math.min(this.#source[0], Math.ceil(x + w));
    const bottom = Math.min(this.#source[1], Math.ceil(y + h));
    return [left, top, right - left, bottom - top];
  }
}

/** Where the source was sent as it is, or pixels as sent are wanted. */
export const UNSCALED = {
  toSent: (box) => box,
  toSource: (box) => box,
  told: (message) => message,
};
