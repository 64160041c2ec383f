/** What a user gives, checked before anything is sent. */

import { MFCMTError } from "./errors.js";

const DEFAULT_URL = "http://127.0.0.1:8000";

const wrong = (detail) => new MFCMTError({ code: "bad-request", detail });

/** A box as four numbers. */
export function numbers(box) {
  const told = typeof box === "string" ? [] : Array.from(box ?? [], Number);
  if (told.length !== 4 || told.some(Number.isNaN)) {
    throw wrong(`a box is four numbers, [x, y, w, h], not ${JSON.stringify(box)}`);
  }
  return told;
}

/** The service's base URL without a slash at the end; in a page it may be relative, and is its origin by default. */
export function baseUrl(url) {
  const here = globalThis.location?.href?.startsWith("http") ? globalThis.location : null;
  const given = String(url || (here?.origin ?? DEFAULT_URL)).trim();
  let parsed = null;
  if (given.includes("://") || (here && /^[/.]/.test(given))) {
    try {
      parsed = new URL(given, here?.href);
    } catch {
      // told below
    }
  }
  if (parsed?.username || parsed?.password) {
    throw wrong("url has no user and password in it: an API key is given as key");
  }
  if (!["http:", "https:"].includes(parsed?.protocol)) {
    throw wrong(`url is http: or https: and a host, as ${DEFAULT_URL}, not ${JSON.stringify(given)}`);
  }
  if (parsed.search || parsed.hash) {
    throw wrong(`url is the service's base, without a query or fragment, not ${JSON.stringify(given)}`);
  }
  return parsed.href.replace(/\/+$/, "");
}

/** An API key, or null; it is never repeated. */
export function apiKey(key) {
  if (key && !/^[!-~]+$/.test(key)) {
    throw wrong("key has a character that no key has: a space, a line's end or one beyond ASCII");
  }
  return key || null;
}
