/** The worker that encodes images off the main thread. */

import { canvasEncoder, serveEncoder } from "./pixels.js";

serveEncoder(self, canvasEncoder());
