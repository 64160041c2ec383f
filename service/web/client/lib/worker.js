/** Starts workers that encode. Only `mfcmt.js` imports this: Hermes, which runs React Native apps, cannot read `import.meta`. */

import { canvasEncoder, serveEncoder } from "./pixels.js";

const UP_WITHIN_MS = 5000;
const WARNING =
  "MFCMT: frames are encoded on the main thread, because no worker starts here. Allow worker-src 'self' or blob: in the page's " +
  "Content-Security-Policy, or build @mfcmt/client/worker as a file of its own and give its address as new Client({ workerUrl }).";

const useless = new Set();
let warned = false;

/** The file beside this one. Bundlers that know this form of words (vite, webpack, Parcel) bundle the worker. */
const beside = () => new Worker(new URL("./encoder-worker.js", import.meta.url), { type: "module" });

/** The same worker as text, for bundlers that leave the file behind (esbuild) and modules of another origin. */
function inlined() {
  const source = `(${serveEncoder})(self, (${canvasEncoder})());`;
  const url = URL.createObjectURL(new Blob([source], { type: "text/javascript" }));
  try {
    return new Worker(url);
  } finally {
    setTimeout(() => URL.revokeObjectURL(url), UP_WITHIN_MS);
  }
}

/** Resolves with a running worker; null, and a warning once, where the page can have none. `url` is a file to use in place of ours. */
export async function openWorker(url) {
  if (typeof Worker === "undefined" || typeof OffscreenCanvas === "undefined") return null;
  const ways = url ? [() => new Worker(url, { type: "module" })] : [beside, inlined].filter((way) => !useless.has(way));
  for (const way of ways) {
    const worker = await running(way);
    if (worker) return worker;
    useless.add(way);
  }
  if (!warned) console.warn(WARNING);
  warned = true;
  return null;
}

function running(start) {
  return new Promise((resolve) => {
    let worker;
    const give = (found) => {
      clearTimeout(timer);
      if (!found) worker?.terminate();
      resolve(found);
    };
    const timer = setTimeout(give, UP_WITHIN_MS, null);
    try {
      worker = start();
      worker.onerror = (event) => {
        event.preventDefault?.();
        give(null);
      };
      worker.onmessage = () => give(worker);
    } catch {
      give(null);
    }
  });
}
