/** Where the sessions of a service are that has several nodes. */

const OF_SESSION = /^(?:http|ws)(s?)(:\/\/.+)\/v1\/sessions\/([^/?]+)(?:[/?].*)?$/;

export class Places {
  #url;
  #urls = new Map();

  /** `url` is the service's own, by which every session is found of which no node is known. */
  constructor(url) {
    this.#url = url;
  }

  /** Return the URL of a call. */
  url(where) {
    const [, , , id] = OF_SESSION.exec(this.#url + where) ?? [];
    return (this.#urls.get(id) ?? this.#url) + where;
  }

  /** Remember the node in the URL of a session, of one of its calls or of its stream. */
  learn(url) {
    const [found, secure, rest, id] = OF_SESSION.exec(url ?? "") ?? [];
    if (!found || (!secure && this.#url.startsWith("https"))) return false;
    this.#urls.set(id, `http${secure}${rest}`);
    return true;
  }

  /** Ask the service's own URL again, because the node does not answer; whether a node was known. */
  forget(where) {
    const [, , , id] = OF_SESSION.exec(this.#url + where) ?? [];
    return this.#urls.delete(id);
  }
}
