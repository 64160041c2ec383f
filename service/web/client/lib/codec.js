/** The two subprotocols: messages to and from what a WebSocket carries. */

const json = {
  subprotocol: "mfcmt.v1.json",
  frame(bytes, beside) {
    return [JSON.stringify({ type: "meta", ...beside }), bytes];
  },
  control: JSON.stringify,
  read(data) {
    return withMapsAsBytes(JSON.parse(data));
  },
};

function msgpack({ encode, decode }) {
  return {
    subprotocol: "mfcmt.v1.msgpack",
    frame(bytes, beside) {
      return [encode({ type: "frame", frame: bytes, ...beside })];
    },
    control: (message) => encode(message),
    read(data) {
      return decode(data);
    },
  };
}

/** A MessagePack body. */
export async function packed(told) {
  return (await import("../vendor/msgpack/index.mjs")).encode(told);
}

/** The codec of this name; MessagePack is loaded only where it is asked for. */
export async function codecNamed(name) {
  return name === "msgpack" ? msgpack(await import("../vendor/msgpack/index.mjs")) : json;
}

/** A result with its response maps as bytes: JSON carries them in base64. */
export function withMapsAsBytes(message) {
  for (const target of message.targets ?? []) {
    for (const [name, image] of Object.entries(target.maps ?? {})) {
      if (typeof image === "string") target.maps[name] = Uint8Array.from(atob(image), (c) => c.charCodeAt(0));
    }
  }
  return message;
}
