/** Checks what a user gives before anything is sent. */

import { MFCMTError } from "./errors.js";

const DEFAULT_URL = "http://127.0.0.1:8000";

const wrong = (detail) => new MFCMTError({ code: "bad-request", detail });

/** Return a box as four numbers. Throws for anything else. */
export function numbers(box) {
  const values = typeof box === "string" ? [] : Array.from(box ?? [], Number);
  if (values.length !== 4 || values.some(Number.isNaN)) {
    throw wrong(`a box is four numbers, [x, y, w, h], not ${JSON.stringify(box)}`);
  }
  return values;
}

/** Return the service's base URL without a slash at the end; in a page it may be relative, and is its origin by default. */
export function baseUrl(url) {
  const here = globalThis.location?.href?.startsWith("http") ? globalThis.location : null;
  const given = String(url || (here?.origin ?? DEFAULT_URL)).trim();
  let parsed = null;
  if (given.includes("://") || (here && /^[/.]/.test(given))) {
    try {
      parsed = new URL(given, here?.href);
    } catch {
      // refused below
    }
  }
  if (parsed?.username || parsed?.password) {
    throw wrong("url must not contain a user and password; give an API key as key");
  }
  if (!["http:", "https:"].includes(parsed?.protocol)) {
    throw wrong(`url must be http: or https: with a host, such as ${DEFAULT_URL}, not ${JSON.stringify(given)}`);
  }
  if (parsed.search || parsed.hash) {
    throw wrong(`url must be the service's base, without a query or fragment, not ${JSON.stringify(given)}`);
  }
  return parsed.href.replace(/\/+$/, "");
}

/** Return the API key, or null. Throws for one with a character that no key has, without repeating it. */
export function apiKey(key) {
  if (key && !/^[!-~]+$/.test(key)) {
    throw wrong("key must not contain spaces, line ends or characters beyond ASCII");
  }
  return key || null;
}
