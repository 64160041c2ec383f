/** What every entry of the package exports beside its `Client`. */

export { MFCMTError } from "./errors.js";
export { encodeFrame, regionsByDefault } from "./frame.js";
export { fittedSize } from "./pixels.js";
export { Session } from "./session.js";
export { Stream } from "./stream.js";

export const VERSION = "0.1.0";
