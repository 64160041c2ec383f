/** Client of the MFCMT tracking service, for browsers, Node and bundlers. See README.md and mfcmt.d.ts. */

import { Client as Core } from "./lib/client.js";
import { openWorker } from "./lib/worker.js";

export * from "./lib/exports.js";

export class Client extends Core {
  openWorker() {
    return openWorker(this.workerUrl);
  }
}
