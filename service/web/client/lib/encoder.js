/** Captures what a source shows and has it encoded: in a worker where the browser can, else on the main thread. */

import { unsupportedSource } from "./errors.js";
import { canvasEncoder } from "./pixels.js";

const is = (source, ...names) => names.some((name) => globalThis[name] && source instanceof globalThis[name]);

/** Whether a source is an encoded image; otherwise it is pixels. Throws for anything else. */
export function isEncoded(source) {
  if (source instanceof ArrayBuffer || ArrayBuffer.isView(source) || is(source, "Blob")) return true;
  const pixels = ["HTMLVideoElement", "HTMLImageElement", "HTMLCanvasElement", "OffscreenCanvas", "ImageBitmap"];
  if (is(source, ...pixels, "ImageData", "VideoFrame")) return false;
  throw unsupportedSource("a frame is an encoded image, or pixels where there is a browser");
}

/** Resolves with the bytes of an encoded image. */
export async function bytesOf(source) {
  if (is(source, "Blob")) return new Uint8Array(await source.arrayBuffer());
  if (source instanceof ArrayBuffer) return new Uint8Array(source);
  return new Uint8Array(source.buffer, source.byteOffset, source.byteLength);
}

/** Resolves with what the source shows now, as an ImageBitmap or VideoFrame of our own; `transfer` takes over the source. */
export async function capture(source, transfer = false) {
  try {
    if (is(source, "VideoFrame")) return transfer ? source : source.clone();
    if (is(source, "ImageBitmap") && transfer) return source;
    return await createImageBitmap(source);
  } catch (cause) {
    throw unsupportedSource("the source shows no frame that may be read", cause);
  }
}

export const sizeOf = (image) => [image.displayWidth ?? image.width, image.displayHeight ?? image.height];

class WorkerEncoder {
  where = "worker";
  #worker;
  #jobs = new Map();
  #count = 0;

  constructor(worker) {
    this.#worker = worker;
    worker.onmessage = ({ data }) => {
      const job = this.#jobs.get(data.id);
      this.#jobs.delete(data.id);
      if (data.error) job?.reject(unsupportedSource(data.error));
      else job?.resolve({ bytes: new Uint8Array(data.bytes), wholeBytes: data.wholeBytes });
    };
  }

  encode(image, how, keep) {
    return new Promise((resolve, reject) => {
      const id = ++this.#count;
      this.#jobs.set(id, { resolve, reject });
      this.#worker.postMessage({ id, image, how }, keep ? [] : [image]);
    });
  }

  close() {
    this.#worker.terminate();
    for (const job of this.#jobs.values()) job.reject(unsupportedSource("the encoder was closed"));
    this.#jobs.clear();
  }
}

class MainEncoder {
  where = "main";
  #encoder = canvasEncoder();

  async encode(image, how, keep) {
    try {
      const { blob, wholeBytes } = await this.#encoder.encode(image, how);
      return { bytes: await bytesOf(blob), wholeBytes };
    } catch (cause) {
      throw unsupportedSource("the frame cannot be encoded", cause);
    } finally {
      if (!keep) image.close();
    }
  }

  close() {}
}

/**
 * Resolves with an encoder in the worker that `openWorker` resolves with, or on the main thread where it gives null. Its
 * `encode(image, {size, region, imageType, quality, weigh}, keep)` resolves with `{bytes, wholeBytes}` and closes the image
 * unless `keep` is set; one call at a time.
 */
export async function openEncoder(openWorker) {
  const worker = await openWorker();
  return worker ? new WorkerEncoder(worker) : new MainEncoder();
}
