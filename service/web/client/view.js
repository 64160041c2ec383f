/** Helpers for pages that show a picture and the boxes in it: where the picture lies, drawing a box, an overlay. */

const SVG = "http://www.w3.org/2000/svg";
// Boxes with a side below this are clicks, not boxes.
const LEAST_SIDE_PX = 4;
const STROKES = {
  tracking: { stroke: "#2da44e" },
  uncertain: { stroke: "#bf8700", "stroke-dasharray": "8 5" },
  lost: { stroke: "#cf222e", "stroke-dasharray": "2 4" },
};

/**
 * Where a picture of the size `[w, h]` lies in an area: `box(box)` and `point(point)` map from the picture to the area,
 * `boxBack` and `pointBack` the other way. `fit` and `position` are those of CSS, the position as fractions.
 */
export function letterbox([width, height], [areaWidth, areaHeight], { fit = "contain", position = [0.5, 0.5] } = {}) {
  const [x, y] = [areaWidth / width, areaHeight / height];
  const scales = {
    contain: [Math.min(x, y), Math.min(x, y)],
    cover: [Math.max(x, y), Math.max(x, y)],
    fill: [x, y],
    none: [1, 1],
    "scale-down": [Math.min(x, y, 1), Math.min(x, y, 1)],
  };
  const [scaleX, scaleY] = scales[fit] ?? scales.contain;
  const left = (areaWidth - width * scaleX) * position[0];
  const top = (areaHeight - height * scaleY) * position[1];
  return {
    /** The picture's own place in the area. */
    area: [left, top, width * scaleX, height * scaleY],
    point: ([px, py]) => [left + px * scaleX, top + py * scaleY],
    pointBack: ([px, py]) => [(px - left) / scaleX, (py - top) / scaleY],
    box: ([bx, by, w, h]) => [left + bx * scaleX, top + by * scaleY, w * scaleX, h * scaleY],
    boxBack: ([bx, by, w, h]) => [(bx - left) / scaleX, (by - top) / scaleY, w / scaleX, h / scaleY],
  };
}

/** Return the size `[w, h]` of what an element shows, in its own pixels. */
export function sourceSize(element) {
  return [
    element.videoWidth || element.naturalWidth || element.width,
    element.videoHeight || element.naturalHeight || element.height,
  ];
}

/** Return where a picture lies in the content box of a video, image or canvas; by default the one that it shows. */
export function letterboxOf(element, size = sourceSize(element)) {
  const { objectFit, objectPosition } = getComputedStyle(element);
  const [, , width, height] = contentBox(element);
  const free = letterbox(size, [width, height], { fit: objectFit, position: [0, 0] }).area;
  const room = [width - free[2], height - free[3]];
  const position = objectPosition.split(" ").map((part, axis) => {
    if (part.endsWith("%")) return parseFloat(part) / 100;
    return room[axis] === 0 ? 0 : parseFloat(part) / room[axis];
  });
  return letterbox(size, [width, height], { fit: objectFit, position });
}

/**
 * Let the user draw boxes on an element; returns the function that ends that. `onBox(box)` gets each box, in pixels of
 * what the element shows; `onDraft(box)` what has been drawn so far, and null when it is done or given up.
 */
export function drawBoxes(element, onBox, { onDraft = () => {}, signal } = {}) {
  const listening = new AbortController();
  const options = { signal: listening.signal };
  const { touchAction } = element.style;
  let start = null;

  const at = (event) => {
    const frame = element.getBoundingClientRect();
    const [left, top] = contentBox(element);
    const zoom = [frame.width / element.offsetWidth, frame.height / element.offsetHeight];
    const point = [(event.clientX - frame.left) / zoom[0] - left, (event.clientY - frame.top) / zoom[1] - top];
    const size = sourceSize(element);
    return letterboxOf(element).pointBack(point).map((value, axis) => Math.min(Math.max(value, 0), size[axis]));
  };
  const drawn = (event) => {
    const end = at(event);
    const sides = [0, 1].map((axis) => Math.abs(end[axis] - start[axis]));
    return [Math.min(start[0], end[0]), Math.min(start[1], end[1]), ...sides];
  };
  const down = (event) => {
    if (event.button !== 0 || start || !sourceSize(element)[0]) return;
    event.preventDefault();
    element.setPointerCapture(event.pointerId);
    start = at(event);
  };
  const move = (event) => start && onDraft(drawn(event));
  const up = (event) => {
    if (!start) return;
    const box = drawn(event);
    start = null;
    onDraft(null);
    const [, , width, height] = letterboxOf(element).box(box);
    if (Math.min(width, height) >= LEAST_SIDE_PX) onBox(box);
  };
  const cancel = () => {
    start = null;
    onDraft(null);
  };
  const stop = () => {
    listening.abort();
    element.style.touchAction = touchAction;
  };
  element.style.touchAction = "none"; // a finger draws and does not scroll
  element.addEventListener("pointerdown", down, options);
  element.addEventListener("pointermove", move, options);
  element.addEventListener("pointerup", up, options);
  element.addEventListener("pointercancel", cancel, options);
  signal?.addEventListener("abort", stop, options);
  if (signal?.aborted) stop();
  return stop;
}

/**
 * Lay an SVG with boxes over an element. `draw(targets, size)` shows the targets of a result of that size, `draft(box)` a
 * box that is being drawn (null for none), `remove()` takes the overlay away. `label(target)` returns a text for a target.
 * `svg` is an element to use, beside the one that it lies over; by default one is made.
 */
export function overlay(element, { label = () => "", svg } = {}) {
  const layer = svg ?? document.createElementNS(SVG, "svg");
  let shown = { targets: [], size: null, drafted: null };

  const show = (change) => {
    shown = { ...shown, ...change };
    const [left, top, width, height] = contentBox(element);
    const place = { left: element.offsetLeft + left, top: element.offsetTop + top, width, height };
    Object.assign(layer.style, { position: "absolute", pointerEvents: "none", overflow: "hidden" });
    for (const [side, pixels] of Object.entries(place)) layer.style[side] = `${pixels}px`;
    const { targets, size, drafted } = shown;
    const parts = [];
    if (targets.length && width && height) {
      const view = letterboxOf(element, size ?? undefined);
      for (const target of targets) parts.push(...marked(view.box(target.box), target.status, label(target)));
    }
    if (drafted && width && height) parts.push(...marked(letterboxOf(element).box(drafted), "tracking", ""));
    layer.replaceChildren(...parts);
  };

  if (!svg) element.after(layer);
  const observer = new ResizeObserver(() => show({}));
  observer.observe(element);
  return {
    svg: layer,
    draw: (targets, size = null) => show({ targets, size }),
    draft: (drafted) => show({ drafted }),
    remove() {
      observer.disconnect();
      if (svg) layer.replaceChildren();
      else layer.remove();
    },
  };
}

function marked([x, y, width, height], status, text) {
  const line = { fill: "none", "stroke-width": 3, class: `mfcmt-${status}`, ...(STROKES[status] ?? STROKES.lost) };
  const parts = [made("rect", { x, y, width, height, ...line })];
  if (text) {
    const place = { x, y: Math.max(12, y - 6), fill: line.stroke, "font-size": 13, "font-family": "system-ui, sans-serif" };
    const words = made("text", place);
    words.textContent = text;
    parts.push(words);
  }
  return parts;
}

function made(name, attributes) {
  const element = document.createElementNS(SVG, name);
  for (const [attribute, value] of Object.entries(attributes)) element.setAttribute(attribute, value);
  return element;
}

/** Return the content box of an element in CSS pixels, from the corner of its border box. */
function contentBox(element) {
  const style = getComputedStyle(element);
  const padding = ["Left", "Top", "Right", "Bottom"].map((side) => parseFloat(style[`padding${side}`]) || 0);
  return [
    element.clientLeft + padding[0],
    element.clientTop + padding[1],
    element.clientWidth - padding[0] - padding[2],
    element.clientHeight - padding[1] - padding[3],
  ];
}
