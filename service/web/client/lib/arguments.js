/** Checks what a user gives before anything is sent. */

import { wrong } from "./errors.js";

const DEFAULT_URL = "http://127.0.0.1:8000";
// scheme, user and password, host with port, path, query, fragment; React Native's URL does not take them apart.
const URL_PARTS = /^(https?):\/\/([^/?#@]*@)?((?:\[[\da-f:.]+\]|[^/?#@:\s[\]]+)(?::(\d+))?)(\/[^?#]*)?(\?[^#]*)?(#.*)?$/i;
const MAX_PORT = 65535;

/** Return a box as four numbers. Throws for anything else. */
export function numbers(box) {
  const values = typeof box === "string" ? [] : Array.from(box ?? [], Number);
  if (values.length !== 4 || values.some(Number.isNaN)) {
    throw wrong(`a box is four numbers, [x, y, w, h], not ${JSON.stringify(box)}`);
  }
  return values;
}

/** Return the origin of the page that this runs in; null outside of pages. */
export function pageOrigin() {
  const { location } = globalThis;
  return location?.href?.startsWith("http") ? location.origin : null;
}

/** Return the service's base URL without a slash at the end; in a page it may be relative, and is its origin by default. */
export function baseUrl(url) {
  const origin = pageOrigin();
  const given = String(url || (origin ?? DEFAULT_URL)).trim();
  const whole = origin && /^[/.]/.test(given) ? new URL(given, globalThis.location.href).href : given;
  const [, scheme, user, host, port, path = "", query, fragment] = URL_PARTS.exec(whole) ?? [];
  if (user) throw wrong("url must not contain a user and password; give an API key as key");
  if (!scheme || Number(port ?? 0) > MAX_PORT) {
    throw wrong(`url must be http: or https: with a host, such as ${DEFAULT_URL}, not ${JSON.stringify(given)}`);
  }
  if (query || fragment) {
    throw wrong(`url must be the service's base, without a query or fragment, not ${JSON.stringify(given)}`);
  }
  return `${scheme.toLowerCase()}://${host.toLowerCase()}${path}`.replace(/\/+$/, "");
}

/** Return the API key, or null. Throws for one with a character that no key has, without repeating it. */
export function apiKey(key) {
  if (key && !/^[!-~]+$/.test(key)) {
    throw wrong("key must not contain spaces, line ends or characters beyond ASCII");
  }
  return key || null;
}

/** Return one of `choices`. Throws for anything else. */
export function oneOf(name, choices, value) {
  if (choices.includes(value)) return value;
  throw wrong(`${name} is one of ${choices.map((each) => JSON.stringify(each)).join(" and ")}, not ${JSON.stringify(value)}`);
}

/** Return `?name=value&…` of the members that are defined. */
export function query(members) {
  const given = Object.entries(members).filter(([, value]) => value !== undefined && value !== null);
  return given.length ? `?${given.map((member) => member.map(encodeURIComponent).join("=")).join("&")}` : "";
}
