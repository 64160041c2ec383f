// Runs the bundle of native.js with those globals alone that React Native has, too: node run-native.mjs BUNDLE GIVEN.
import { readFile } from "node:fs/promises";
import vm from "node:vm";
import { WebSocket } from "ws";

const [bundle, particulars] = process.argv.slice(2);
const { frames, ...given } = JSON.parse(await readFile(particulars, "utf8"));
const images = await Promise.all(frames.map(async (path) => new Uint8Array(await readFile(path))));
const { fetch, AbortController, performance, setTimeout, clearTimeout, setInterval, clearInterval, queueMicrotask } = globalThis;
const timers = { setTimeout, clearTimeout, setInterval, clearInterval, queueMicrotask };
const world = vm.createContext({ fetch, WebSocket, AbortController, performance, console, ...timers });
vm.runInContext(await readFile(bundle, "utf8"), world);
process.stdout.write(JSON.stringify(await world.track({ ...given, frames: images })));
setTimeout(() => process.exit(0), 100);
