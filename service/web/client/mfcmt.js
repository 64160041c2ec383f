/** Client of the MFCMT tracking service, for browsers and Node. See README.md and mfcmt.d.ts. */

export { Client, Session } from "./lib/client.js";
export { MFCMTError } from "./lib/errors.js";
export { encodeFrame, regionsByDefault } from "./lib/frame.js";
export { fittedSize } from "./lib/pixels.js";
export { Stream } from "./lib/stream.js";

export const VERSION = "0.1.0";
