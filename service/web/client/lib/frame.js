/** Encodes a single frame as a session or stream would send it. */

import { capture, isEncoded, sizeOf } from "./encoder.js";
import { unsupportedSource } from "./errors.js";
import { canvasEncoder, fittedSize } from "./pixels.js";

export const QUALITY = 0.8;
export const IMAGE_TYPE = "image/jpeg";

export async function encodeFrame(source, { quality = QUALITY, imageType = IMAGE_TYPE, maxSide, region } = {}) {
  if (isEncoded(source)) throw unsupportedSource("the frame is encoded already");
  const image = await capture(source);
  try {
    const sourceSize = sizeOf(image);
    const size = fittedSize(...sourceSize, maxSide);
    const { blob } = await canvasEncoder().encode(image, { size, region, imageType, quality });
    return { blob, size, sourceSize };
  } catch (cause) {
    throw unsupportedSource("the frame cannot be encoded", cause);
  } finally {
    image.close();
  }
}

/** Whether streams send regions by themselves: on mobile devices, and where the browser is to save data. */
export function regionsByDefault() {
  const { userAgentData, userAgent = "", connection, maxTouchPoints = 0 } = globalThis.navigator ?? {};
  if (typeof document === "undefined") return false;
  const iPad = /Macintosh/.test(userAgent) && maxTouchPoints > 1;
  return Boolean(userAgentData?.mobile ?? (/Android|iPhone|iPad|Mobile/.test(userAgent) || iPad)) || Boolean(connection?.saveData);
}
