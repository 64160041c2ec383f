// Makes a video of a run from its results: every frame of the source with its boxes, with the browser's encoder.

import { Film } from "./film.js";
import { paint } from "./overlay.js";

const LEAST_WIDTH = 640;

/**
 * Render the frames of `run` that `source` has, from the first to the last that was tracked. `scene(time)` returns what
 * the overlay shows at a time, `progress(share)` is called now and then and returns whether to go on. Resolves to
 * `{blob, suffix}`, or null if it was given up or the browser cannot encode.
 */
export async function render(run, source, { scene, progress }) {
  const [width, height] = source.size.map((side) => side & ~1);
  const canvas = Object.assign(document.createElement("canvas"), { width, height });
  const context = canvas.getContext("2d");
  const film = await Film.open(canvas);
  if (!film) return null;
  const began = run.first;
  await source.seek(began);
  for (;;) {
    source.draw(context, width, height);
    paint(context, { x: 0, y: 0, w: width, h: height }, scene(source.time), Math.max(1, width / LEAST_WIDTH));
    await film.add(source.time - began, source.lasts(source.index));
    if (!progress((source.time - began) / Math.max(run.last - began, 1e-3))) {
      await film.cancel();
      return null;
    }
    if (source.time >= run.last || !(await source.step())) break;
  }
  return { blob: await film.finish(), suffix: film.suffix };
}
