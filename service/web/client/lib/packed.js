/** Writes the bodies of calls as MessagePack: what a client sends there is an image and a few plain values. */

import { wrong } from "./errors.js";

const MAX_INT = 0xffffffff;

/** Return `value` as MessagePack: null, booleans, numbers, strings, bytes, arrays, and objects without their undefined members. */
export function packed(value) {
  const parts = [];
  write(value, parts);
  const whole = new Uint8Array(parts.reduce((sum, { length }) => sum + length, 0));
  let at = 0;
  for (const part of parts) {
    whole.set(part, at);
    at += part.length;
  }
  return whole;
}

function write(value, parts) {
  if (value === null) parts.push([0xc0]);
  else if (typeof value === "boolean") parts.push([value ? 0xc3 : 0xc2]);
  else if (typeof value === "number") parts.push(number(value));
  else if (typeof value === "string") {
    const bytes = utf8(value);
    parts.push(head(0xdb, bytes.length), bytes);
  } else if (value instanceof Uint8Array) parts.push(head(0xc6, value.length), value);
  else if (Array.isArray(value)) {
    parts.push(head(0xdd, value.length));
    for (const each of value) write(each, parts);
  } else if (typeof value === "object") {
    const members = Object.entries(value).filter(([, each]) => each !== undefined);
    parts.push(head(0xdf, members.length));
    for (const member of members) member.forEach((each) => write(each, parts));
  } else throw wrong(`a ${typeof value} cannot be sent`);
}

function head(kind, length) {
  const bytes = new DataView(new ArrayBuffer(5));
  bytes.setUint8(0, kind);
  bytes.setUint32(1, length);
  return new Uint8Array(bytes.buffer);
}

function number(value) {
  const bytes = new DataView(new ArrayBuffer(9));
  if (Number.isSafeInteger(value) && value >= 0) {
    bytes.setUint8(0, 0xcf);
    bytes.setUint32(1, Math.floor(value / (MAX_INT + 1)));
    bytes.setUint32(5, value % (MAX_INT + 1));
  } else if (Number.isInteger(value) && value >= -0x80000000 && value < 0) {
    bytes.setUint8(0, 0xd2);
    bytes.setInt32(1, value);
    return new Uint8Array(bytes.buffer, 0, 5);
  } else {
    bytes.setUint8(0, 0xcb);
    bytes.setFloat64(1, value);
  }
  return new Uint8Array(bytes.buffer);
}

/** Return `text` in UTF-8; not every React Native has a TextEncoder. */
function utf8(text) {
  const wellFormed = text.replace(/[\ud800-\udbff][\udc00-\udfff]|[\ud800-\udfff]/g, (found) => (found.length === 2 ? found : "\ufffd"));
  const escaped = encodeURIComponent(wellFormed).replace(/%(..)/g, (_, hex) => String.fromCharCode(parseInt(hex, 16)));
  return Uint8Array.from(escaped, (character) => character.charCodeAt(0));
}
