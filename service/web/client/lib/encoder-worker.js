/** Encodes images off the main thread: `{id, image, how}` in, `{id, bytes, wholeBytes}` or `{id, error}` out. */

import { CanvasEncoder } from "./pixels.js";

const encoder = new CanvasEncoder();

onmessage = async ({ data: { id, image, how } }) => {
  try {
    const { blob, wholeBytes } = await encoder.encode(image, how);
    const bytes = await blob.arrayBuffer();
    postMessage({ id, bytes, wholeBytes }, [bytes]);
  } catch (error) {
    postMessage({ id, error: String(error) });
  } finally {
    image.close();
  }
};

postMessage({ up: true });
