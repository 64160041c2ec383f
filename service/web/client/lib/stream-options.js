/** The options of a stream. */

import { IMAGE_TYPE, QUALITY, regionsByDefault } from "./frame.js";

const DEFAULTS = {
  mode: "latest",
  codec: "json",
  regions: "auto",
  quality: QUALITY,
  imageType: IMAGE_TYPE,
  maxSide: null,
  encoder: "auto",
  takeover: false,
  reconnectForMs: 60_000,
  stallMs: 10_000,
};

/** Return the options that are given, the defaults of the others, and what `auto` means for regions here. */
export function streamOptions(given) {
  const options = { ...DEFAULTS, ...Object.fromEntries(Object.entries(given).filter(([, value]) => value !== undefined)) };
  return { ...options, regions: options.regions === "auto" ? regionsByDefault() : options.regions };
}
