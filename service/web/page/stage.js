// The picture, what is drawn over it, and the drawing of boxes by mouse, finger or keyboard.

import { crisp } from "./dom.js";
import { paint } from "./overlay.js";

const LEAST_PX = 5; // a shorter drag is a click
const MOVE = 0.02;
const LEAST = 0.01;

/** Boxes are fractions of the frame. Calls `onbox(box)`, `onpick(point)`, and `onhold(on)` around the drawing of a box. */
export class Stage {
  scene = { targets: [], chosen: null, trail: true, draft: null, suggestion: null };
  armed = false;
  #corner = null;
  #pointer = null;
  #dirty = false;

  constructor(root, picture, overlay, handlers) {
    Object.assign(this, { root, picture, overlay }, handlers);
    new ResizeObserver(() => this.draw()).observe(root);
    root.addEventListener("pointerdown", (event) => this.#down(event));
    root.addEventListener("pointermove", (event) => this.#move(event));
    root.addEventListener("pointerup", (event) => this.#up(event));
    root.addEventListener("pointercancel", () => this.cancel());
    // A browser may take the end of a quick drag for a fling, and then drops the next tap.
    root.addEventListener("touchstart", (event) => this.#pointer !== null && event.preventDefault(), { passive: false });
    root.addEventListener("keydown", (event) => this.#key(event));
    root.addEventListener("blur", () => this.byKeys && this.cancel());
  }

  /** Whether a box is being drawn with the keyboard. */
  get byKeys() {
    return this.scene.draft !== null && this.#corner === null;
  }

  /** Show `source` (a canvas or a video) at `size`. */
  show(source, [width, height]) {
    if (this.picture.width !== width || this.picture.height !== height) Object.assign(this.picture, { width, height });
    this.picture.getContext("2d").drawImage(source, 0, 0, width, height);
    this.picture.hidden = this.overlay.hidden = false;
  }

  hide() {
    this.cancel();
    this.picture.hidden = this.overlay.hidden = true;
  }

  /** Draw the overlay with the next repaint. */
  draw() {
    if (this.#dirty) return;
    this.#dirty = true;
    requestAnimationFrame(() => {
      this.#dirty = false;
      if (this.overlay.hidden) return;
      const { context, width, height } = crisp(this.overlay);
      context.clearRect(0, 0, width, height);
      paint(context, this.rect(), this.scene);
    });
  }

  /** The rectangle of the picture on the stage, in CSS pixels. */
  rect() {
    const { clientWidth: width, clientHeight: height } = this.overlay;
    const scale = Math.min(width / this.picture.width, height / this.picture.height);
    const [w, h] = [this.picture.width * scale, this.picture.height * scale];
    return { x: (width - w) / 2, y: (height - h) / 2, w, h };
  }

  cancel() {
    if (!this.scene.draft && !this.#corner) return;
    this.scene.draft = this.#corner = this.#pointer = null;
    this.onhold(false);
    this.draw();
  }

  /** Begin a box in the middle, to be moved with the keyboard. */
  begin() {
    this.scene.draft = this.scene.suggestion ?? [0.375, 0.375, 0.25, 0.25];
    this.onhold(true);
    this.draw();
  }

  #set() {
    const box = this.scene.draft;
    this.scene.draft = this.#corner = this.#pointer = null;
    this.draw();
    this.onbox(box);
  }

  #point(event) {
    const bounds = this.overlay.getBoundingClientRect();
    const rect = this.rect();
    const [x, y] = [(event.clientX - bounds.left - rect.x) / rect.w, (event.clientY - bounds.top - rect.y) / rect.h];
    return [Math.min(Math.max(x, 0), 1), Math.min(Math.max(y, 0), 1)];
  }

  #down(event) {
    if (!this.armed || event.button !== 0 || this.#pointer !== null || event.target.closest("button")) return;
    this.root.focus({ preventScroll: true });
    this.#pointer = event.pointerId;
    this.#corner = this.#point(event);
    this.scene.draft = null;
    this.root.setPointerCapture(event.pointerId);
    this.onhold(true);
    event.preventDefault();
  }

  #move(event) {
    if (event.pointerId !== this.#pointer || !this.#corner) return;
    const [x, y] = this.#point(event);
    const [left, top] = [Math.min(x, this.#corner[0]), Math.min(y, this.#corner[1])];
    const box = [left, top, Math.abs(x - this.#corner[0]), Math.abs(y - this.#corner[1])];
    const rect = this.rect();
    this.scene.draft = Math.min(box[2] * rect.w, box[3] * rect.h) < LEAST_PX ? null : box;
    this.draw();
  }

  #up(event) {
    if (event.pointerId !== this.#pointer) return;
    if (this.scene.draft) {
      this.#set();
      return;
    }
    const point = this.#corner;
    this.cancel();
    this.onpick(point);
  }

  #key(event) {
    if (!this.armed || event.target !== this.root || event.ctrlKey || event.metaKey) return;
    const draft = this.scene.draft;
    if (event.key === "Enter") {
      if (this.byKeys) this.#set();
      else this.begin();
    } else if (event.key === "Escape" && draft) {
      this.cancel();
    } else if (this.byKeys && event.key.startsWith("Arrow")) {
      this.scene.draft = nudged(draft, event, event.altKey ? 1 / this.picture.width : MOVE);
      this.draw();
    } else {
      return;
    }
    event.preventDefault();
    event.stopPropagation();
  }
}

function nudged([x, y, w, h], { key, shiftKey }, by) {
  const across = key === "ArrowRight" ? by : key === "ArrowLeft" ? -by : 0;
  const down = key === "ArrowDown" ? by : key === "ArrowUp" ? -by : 0;
  const fit = (value, least, most) => Math.min(Math.max(value, least), most);
  if (shiftKey) return [x, y, fit(w + across, LEAST, 1 - x), fit(h + down, LEAST, 1 - y)];
  return [fit(x + across, 0, 1 - w), fit(y + down, 0, 1 - h), w, h];
}
