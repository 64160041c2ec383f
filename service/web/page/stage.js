// The picture, what is drawn over it, and the drawing and changing of boxes by mouse, finger or keyboard.

import { HANDLES, between, mirrored, moved, nudged, resized } from "./boxes.js";
import { crisp } from "./dom.js";
import { paint, place } from "./overlay.js";
import { Zoom } from "./zoom.js";

const LEAST_PX = 5; // a shorter drag is a click
const NEAR_PX = { mouse: 7, touch: 18 };

/**
 * Boxes are fractions of the frame. Calls `onbox(box, target)` with the target whose box was changed, or null for a new
 * box; `onpick(point)` for a click; and `onhold(on)` around the drawing of a box.
 */
export class Stage {
  scene = { targets: [], chosen: null, other: [], draft: null, suggestion: null };
  /** Whether the picture is shown as in a mirror, as people know themselves; boxes are of the true picture all the same. */
  mirror = false;
  /** Called after each repaint. */
  onpainted = () => {};
  armed = false;
  /** Whether the next drag draws a new box wherever it begins. */
  free = false;
  #drag = null; // {pointer, from, change(point)}
  #of = null; // the target whose box the draft is
  #dirty = false;

  constructor(root, picture, overlay, handlers) {
    Object.assign(this, { root, picture, overlay }, handlers);
    this.zoom = new Zoom(root, { ratio: () => picture.width / picture.height, begin: () => this.cancel(), changed: () => this.draw() });
    new ResizeObserver(() => this.draw()).observe(root);
    root.addEventListener("pointerdown", (event) => this.#down(event));
    root.addEventListener("pointermove", (event) => this.#move(event));
    root.addEventListener("pointerup", (event) => this.#up(event));
    root.addEventListener("pointercancel", () => this.cancel());
    // A browser may take the end of a quick drag for a fling, and then drops the next tap.
    root.addEventListener("touchstart", (event) => this.#drag && event.preventDefault(), { passive: false });
    root.addEventListener("keydown", (event) => this.#key(event));
    root.addEventListener("blur", () => this.byKeys && this.cancel());
  }

  /** Whether a box is being drawn, by whatever means. */
  get drawing() {
    return this.#drag !== null || this.scene.draft !== null;
  }

  /** Whether a box is being drawn with the keyboard. */
  get byKeys() {
    return this.scene.draft !== null && this.#drag === null;
  }

  focus() {
    this.root.focus({ preventScroll: true });
  }

  /** Show what `source` draws (it has `draw(context, width, height)`) at a size. */
  show(source, [width, height]) {
    if (this.picture.width !== width || this.picture.height !== height) Object.assign(this.picture, { width, height });
    source.draw(this.picture.getContext("2d"), width, height);
    this.picture.hidden = this.overlay.hidden = false;
  }

  hide() {
    this.cancel();
    this.zoom.reset();
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
      const rect = this.rect();
      Object.assign(this.picture.style, { left: `${rect.x}px`, top: `${rect.y}px`, width: `${rect.w}px`, height: `${rect.h}px` });
      this.picture.style.transform = this.mirror ? "scaleX(-1)" : "";
      context.clearRect(0, 0, width, height);
      paint(context, rect, { ...(this.mirror ? inMirror(this.scene) : this.scene), handles: this.armed && !this.scene.draft });
      this.onpainted();
    });
  }

  /** The rectangle of the picture on the stage, in CSS pixels. */
  rect() {
    return this.zoom.rect(this.root.clientWidth, this.root.clientHeight);
  }

  cancel() {
    if (!this.scene.draft && !this.#drag) return;
    this.scene.draft = this.#drag = this.#of = null;
    this.onhold(false);
    this.draw();
  }

  /** Begin a box to be moved with the keyboard: the chosen target's (`correcting`), or a new one in the middle. */
  begin(correcting = false) {
    const chosen = correcting ? this.#chosen() : null;
    this.#of = chosen?.id ?? null;
    this.scene.draft = chosen?.box ?? this.scene.suggestion ?? [0.375, 0.375, 0.25, 0.25];
    this.focus();
    this.onhold(true);
    this.draw();
  }

  #chosen() {
    return this.scene.targets.find(({ id }) => id === this.scene.chosen) ?? null;
  }

  #set() {
    const [box, of] = [this.scene.draft, this.#of];
    this.scene.draft = this.#drag = this.#of = null;
    this.draw();
    this.onbox(box, of);
  }

  /** The point of an event, in fractions of the picture, and whether it is on it. */
  #point({ clientX, clientY }) {
    const bounds = this.root.getBoundingClientRect();
    const rect = this.rect();
    const [left, y] = [(clientX - bounds.left - this.root.clientLeft - rect.x) / rect.w, (clientY - bounds.top - this.root.clientTop - rect.y) / rect.h];
    const x = this.mirror ? 1 - left : left;
    const inside = x >= 0 && x <= 1 && y >= 0 && y <= 1;
    return { point: [Math.min(Math.max(x, 0), 1), Math.min(Math.max(y, 0), 1)], inside };
  }

  /** What a drag from `point` changes: the chosen box's handle, the box, or null for a new box. */
  #grip(point, kind) {
    const chosen = this.free ? null : this.#chosen();
    if (!chosen) return null;
    const rect = this.rect();
    const near = NEAR_PX[kind] ?? NEAR_PX.mouse;
    const [x, y, w, h] = place(chosen.box, rect);
    const [px, py] = [rect.x + point[0] * rect.w, rect.y + point[1] * rect.h];
    const small = Math.min(w, h) < 4 * near; // then the corners alone, or there would be nothing to move it by
    const handle = HANDLES.slice(0, small ? 4 : 8).find((one) => Math.hypot(px - x - one.x * w, py - y - one.y * h) <= near / (small ? 2 : 1));
    const inside = px >= x && px <= x + w && py >= y && py <= y + h;
    return handle || inside ? { chosen, handle: handle ?? null } : null;
  }

  #down(event) {
    if (!this.armed || event.button !== 0 || event.target.closest("button") || this.zoom.busy) return;
    const { point: from, inside } = this.#point(event);
    if (this.#drag || (event.pointerType === "touch" && !inside)) return;
    this.focus();
    const grip = this.#grip(from, event.pointerType);
    this.scene.draft = null;
    this.#of = grip?.chosen.id ?? null;
    this.#drag = { pointer: event.pointerId, from, change: changes(grip, from) };
    this.root.setPointerCapture(event.pointerId);
    this.onhold(true);
    event.preventDefault();
  }

  #move(event) {
    const { point } = this.#point(event);
    if (!this.#drag) {
      const grip = this.armed && event.pointerType === "mouse" ? this.#grip(point, "mouse") : null;
      this.root.style.cursor = grip ? (grip.handle?.cursor ?? "move") : "";
      return;
    }
    if (event.pointerId !== this.#drag.pointer) return;
    const { from, change } = this.#drag;
    const rect = this.rect();
    const far = Math.hypot((point[0] - from[0]) * rect.w, (point[1] - from[1]) * rect.h);
    const box = change(point);
    const large = Math.min(box[2] * rect.w, box[3] * rect.h) >= LEAST_PX;
    this.scene.draft = large && (this.scene.draft || far >= (this.#of === null ? 0 : 2)) ? box : null;
    this.draw();
  }

  #up(event) {
    if (event.pointerId !== this.#drag?.pointer) return;
    if (this.scene.draft) {
      this.#set();
      return;
    }
    const { from } = this.#drag;
    this.cancel();
    this.onpick(from);
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
      const turned = this.mirror ? mirrored : (box) => box;
      this.scene.draft = turned(nudged(turned(draft), event, 1 / this.picture.width));
      this.draw();
    } else {
      return;
    }
    event.preventDefault();
    event.stopPropagation();
  }
}

/** A scene as it is seen in a mirror. */
function inMirror(scene) {
  const one = (target) => ({ ...target, box: mirrored(target.box), trail: target.trail.map(([x, y]) => [1 - x, y]) });
  const { targets, other, draft, suggestion } = scene;
  return { ...scene, targets: targets.map(one), other: other.map(one), draft: draft && mirrored(draft), suggestion: suggestion && mirrored(suggestion) };
}

/** How the box follows the pointer that was pressed at `from`. */
function changes(grip, from) {
  const by = (to) => [to[0] - from[0], to[1] - from[1]];
  if (!grip) return (to) => between(from, to);
  if (grip.handle) return (to) => resized(grip.chosen.box, grip.handle, by(to));
  return (to) => moved(grip.chosen.box, by(to));
}
