// Zooms into the picture: by two fingers, by the wheel with Ctrl, by keys.

const MOST = 12;
const STEP = 1.25;

/** `by` is how much larger the picture is than it fits; `x` and `y` are the point of it in the middle, as fractions. */
export class Zoom {
  by = 1;
  x = 0.5;
  y = 0.5;
  #fingers = new Map();
  #root;

  /** `ratio()` is the picture's width over its height; `begin()` is called before, `changed()` after each change. */
  constructor(root, handlers) {
    this.#root = root;
    Object.assign(this, handlers);
    root.addEventListener("pointerdown", (event) => this.#touch(event), true);
    root.addEventListener("pointermove", (event) => this.#pinch(event), true);
    for (const kind of ["pointerup", "pointercancel"]) root.addEventListener(kind, ({ pointerId }) => this.#fingers.delete(pointerId), true);
    root.addEventListener("wheel", (event) => this.#wheel(event), { passive: false });
  }

  /** Whether two fingers are on the picture. */
  get busy() {
    return this.#fingers.size > 1;
  }

  reset() {
    Object.assign(this, { by: 1, x: 0.5, y: 0.5 });
    this.changed();
  }

  /** Where the picture is on a stage of this size. */
  rect(width, height) {
    const fit = Math.min(width, height * this.ratio());
    const [w, h] = [fit * this.by, (fit / this.ratio()) * this.by];
    const along = (middle, size, room) => (size <= room ? (room - size) / 2 : Math.min(Math.max(room / 2 - middle * size, room - size), 0));
    return { x: along(this.x, w, width), y: along(this.y, h, height), w, h };
  }

  /** Zoom by a factor, so that the point `[px, py]` of the stage stays where it is. */
  at(factor, [px, py] = [this.#root.clientWidth / 2, this.#root.clientHeight / 2]) {
    const { clientWidth: width, clientHeight: height } = this.#root;
    const before = this.rect(width, height);
    const [fx, fy] = [(px - before.x) / before.w, (py - before.y) / before.h];
    this.by = Math.min(Math.max(this.by * factor, 1), MOST);
    const { w, h } = this.rect(width, height);
    this.x = fx + (width / 2 - px) / w;
    this.y = fy + (height / 2 - py) / h;
    this.changed();
  }

  step(further) {
    this.at(further ? STEP : 1 / STEP);
  }

  #wheel(event) {
    if (!event.ctrlKey && !event.metaKey) return; // else the page scrolls
    event.preventDefault();
    const { left, top } = this.#root.getBoundingClientRect();
    this.at(event.deltaY < 0 ? STEP : 1 / STEP, [event.clientX - left, event.clientY - top]);
  }

  #touch({ pointerId, pointerType, clientX, clientY }) {
    if (pointerType !== "touch") return;
    this.#fingers.set(pointerId, [clientX, clientY]);
    if (this.busy) this.begin();
  }

  #pinch({ pointerId, clientX, clientY }) {
    if (!this.#fingers.has(pointerId)) return;
    const before = this.#spread();
    this.#fingers.set(pointerId, [clientX, clientY]);
    if (!this.busy) return;
    const after = this.#spread();
    const { left, top } = this.#root.getBoundingClientRect();
    const { clientWidth, clientHeight } = this.#root;
    const { w, h } = this.rect(clientWidth, clientHeight);
    this.x -= (after.x - before.x) / w;
    this.y -= (after.y - before.y) / h;
    this.at(after.far / Math.max(1, before.far), [after.x - left, after.y - top]);
  }

  #spread() {
    const [[ax, ay], [bx, by] = [ax, ay]] = this.#fingers.values();
    return { x: (ax + bx) / 2, y: (ay + by) / 2, far: Math.hypot(ax - bx, ay - by) };
  }
}
