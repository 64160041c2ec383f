/** Client of the MFCMT tracking service for React Native: frames are encoded images, so there is no worker. See README.md. */

export * from "./lib/exports.js";
export { Client } from "./lib/client.js";
