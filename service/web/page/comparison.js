// Shows how another run compares with the shown one: its success curve, and its boxes over the same picture or beside it.

import { THRESHOLDS } from "./compare.js";
import { byId, colour, crisp } from "./dom.js";
import { paint } from "./overlay.js";

export class Comparison {
  /** Whether the other run has a picture of its own. */
  apart = false;
  #canvas = byId("beside");

  constructor(changed) {
    byId("apart").addEventListener("click", () => {
      this.apart = !this.apart;
      changed();
    });
  }

  /** Show the figures of an `agreement`, or nothing. */
  tell(found) {
    byId("comparison").hidden = !found;
    if (!found) return;
    byId("success-text").textContent = `success ${found.auc.toFixed(3)} (area under the curve), mean overlap ${found.iou.toFixed(3)}`;
    const { context, width, height } = crisp(byId("success"));
    context.clearRect(0, 0, width, height);
    context.fillStyle = colour("--line");
    context.fillRect(Math.round(width / 2), 0, 1, height); // an overlap of half
    context.strokeStyle = colour("--ink");
    context.lineWidth = 1.5;
    context.beginPath();
    found.curve.forEach((share, i) => context.lineTo(THRESHOLDS[i] * width, height - 1 - share * (height - 2)));
    context.stroke();
  }

  /** Show the picture of `stage` with the `targets` of the other run beside it, if it is wanted; null for none. */
  draw({ picture, zoom }, targets) {
    const shown = this.apart && targets !== null;
    byId("pictures").toggleAttribute("data-apart", shown);
    byId("apart").setAttribute("aria-pressed", this.apart);
    this.#canvas.hidden = !shown;
    if (!shown) return;
    const { context, width, height } = crisp(this.#canvas);
    const rect = zoom.rect(width, height);
    context.clearRect(0, 0, width, height);
    context.drawImage(picture, rect.x, rect.y, rect.w, rect.h);
    paint(context, rect, { targets, chosen: null, other: [], draft: null, suggestion: null });
  }
}
