/** The two subprotocols: how messages look on a WebSocket. */

import { wrong } from "./errors.js";

const json = {
  subprotocol: "mfcmt.v1.json",
  frame(bytes, meta) {
    return [JSON.stringify({ type: "meta", ...meta }), bytes];
  },
  control: JSON.stringify,
  read(data) {
    return withMapsAsBytes(JSON.parse(data));
  },
};

const msgpack = ({ encode, decode }) => ({
  subprotocol: "mfcmt.v1.msgpack",
  frame(bytes, meta) {
    return [encode({ type: "frame", frame: bytes, ...meta })];
  },
  control: (message) => encode(message),
  read(data) {
    return decode(data);
  },
});

/** Return the codec of this name. MessagePack needs a `library` with `encode` and `decode`, such as @msgpack/msgpack. */
export function codecNamed(name, library) {
  if (name === "json") return json;
  if (name !== "msgpack") throw wrong(`codec is "json" or "msgpack", not ${JSON.stringify(name)}`);
  if (typeof library?.encode === "function" && typeof library.decode === "function") return msgpack(library);
  throw wrong(
    'codec "msgpack" needs a library: npm install @msgpack/msgpack, import * as msgpack from "@msgpack/msgpack", new Client({ msgpack })',
  );
}

/** Return `message` with its response maps as bytes: JSON carries them in base64. */
export function withMapsAsBytes(message) {
  for (const target of message.targets ?? []) {
    for (const [name, image] of Object.entries(target.maps ?? {})) {
      if (typeof image === "string") target.maps[name] = Uint8Array.from(atob(image), (c) => c.charCodeAt(0));
    }
  }
  return message;
}
