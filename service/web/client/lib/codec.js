/** The two subprotocols: how messages look on a WebSocket. */

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

function msgpack({ encode, decode }) {
  return {
    subprotocol: "mfcmt.v1.msgpack",
    frame(bytes, meta) {
      return [encode({ type: "frame", frame: bytes, ...meta })];
    },
    control: (message) => encode(message),
    read(data) {
      return decode(data);
    },
  };
}

/** Return `body` as MessagePack. */
export async function packed(body) {
  return (await import("../vendor/msgpack/index.mjs")).encode(body);
}

/** Resolves with the codec of this name; MessagePack is loaded only where it is asked for. */
export async function codecNamed(name) {
  return name === "msgpack" ? msgpack(await import("../vendor/msgpack/index.mjs")) : json;
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
