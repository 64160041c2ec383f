// The response view: the fused probability map and the single maps as small heat maps.

import { byId, el } from "./dom.js";

const NAMES = { fused: "Fused", gray: "Grey", fhog: "HOG", color_names: "Colours", background: "Background", statistical: "Histogram" };
const HELP = {
  fused: "the mean of all maps: its peak is where the target is taken to be",
  gray: "correlation filter on grey values",
  fhog: "correlation filter on histograms of oriented gradients",
  color_names: "correlation filter on the names of colours",
  background: "correlation filter that has learned the surroundings as what it is not",
  statistical: "colour histogram of target against surroundings",
};
const EVERY_MS = 90; // the eye needs no more
const HEAT = heat();

export class Maps {
  #tiles = new Map();
  #shownAt = 0;

  /** Show a target's `maps`, by their names. Without maps, the last ones stay. */
  async draw(name, maps) {
    byId("maps-of").textContent = name;
    const now = performance.now();
    if (!maps || now - this.#shownAt < EVERY_MS) return;
    this.#shownAt = now;
    const names = Object.keys(NAMES).filter((one) => maps[one]);
    this.#arrange(names);
    await Promise.all(names.map((one) => this.#paint(one, maps[one])));
  }

  clear() {
    this.#arrange([]);
  }

  #arrange(names) {
    if (names.join() === [...this.#tiles.keys()].join()) return;
    this.#tiles = new Map(names.map((name) => [name, el("canvas", { role: "img", title: HELP[name] })]));
    const figures = names.map((name) => {
      const canvas = this.#tiles.get(name);
      canvas.setAttribute("aria-label", `${NAMES[name]}: ${HELP[name]}`);
      return el("figure", {}, canvas, el("figcaption", { textContent: NAMES[name] }));
    });
    byId("maps").replaceChildren(...figures);
  }

  async #paint(name, png) {
    const bitmap = await createImageBitmap(new Blob([png], { type: "image/png" }));
    const canvas = this.#tiles.get(name);
    if (!canvas) return;
    Object.assign(canvas, { width: bitmap.width, height: bitmap.height });
    const context = canvas.getContext("2d", { willReadFrequently: true });
    context.drawImage(bitmap, 0, 0);
    bitmap.close();
    const image = context.getImageData(0, 0, canvas.width, canvas.height);
    const { data } = image;
    for (let i = 0; i < data.length; i += 4) data.set(HEAT[data[i]], i);
    context.putImageData(image, 0, 0);
  }
}

/** Colors from black over violet and orange to pale yellow, with evenly rising brightness. */
function heat() {
  const stops = [[0, 0, 4], [60, 15, 110], [150, 38, 103], [221, 81, 58], [252, 165, 10], [252, 255, 200]];
  return Array.from({ length: 256 }, (_, level) => {
    const at = (level / 255) * (stops.length - 1);
    const low = Math.min(Math.floor(at), stops.length - 2);
    return [...stops[low].map((value, i) => Math.round(value + (stops[low + 1][i] - value) * (at - low))), 255];
  });
}
