/** A session, and the calls on it. */

import { numbers, query } from "./arguments.js";
import { packed } from "./packed.js";

export const path = (id) => `/v1/sessions/${encodeURIComponent(id)}`;
export const asJson = (body) => ({ headers: { "Content-Type": "application/json" }, body: JSON.stringify(body) });
export const asMessagePack = (body) => ({ headers: { "Content-Type": "application/msgpack" }, body: packed(body) });

export class Session {
  #client;
  #path;
  #sourceSize;
  #sentSize;

  /** `sourceSize` is the size of the first frame before it was scaled; null where that is not known. */
  constructor(client, info, sourceSize = null) {
    this.#client = client;
    this.#path = path(info.id);
    this.#sourceSize = sourceSize;
    this.#take(info);
  }

  get id() {
    return this.info.id;
  }

  async refresh() {
    this.#take(await this.#client.json("GET", this.#path));
    return this.info;
  }

  close() {
    return this.#client.deleteSession(this.id);
  }

  async track(frame, { ts, region, seq, ...encoding } = {}) {
    const { bytes, sourceSize } = await this.#client.image(frame, { region, ...encoding });
    const call = asMessagePack({ frame: bytes, ts, region, seq });
    const result = await this.#client.json("POST", `${this.#path}/frames`, call);
    this.#sourceSize = sourceSize;
    this.#sentSize = result.size;
    return this.#scale().told(result);
  }

  async addTarget(box) {
    return this.#change("POST", `${this.#path}/targets`, box);
  }

  async correctTarget(target, box) {
    return this.#change("PUT", `${this.#path}/targets/${target}`, box);
  }

  async removeTarget(target) {
    await this.#client.call("DELETE", `${this.#path}/targets/${target}`);
  }

  async trajectory({ format = "json", after, target } = {}) {
    const where = `${this.#path}/trajectory${query({ format, after, target })}`;
    if (format !== "json") return this.#client.call("GET", where, {}, (response) => response.text());
    const { results } = await this.#client.json("GET", where);
    return results.map((result) => this.#scale(result.size).told(result));
  }

  async snapshot() {
    return new Uint8Array(await this.#client.call("GET", `${this.#path}/snapshot`, {}, (response) => response.arrayBuffer()));
  }

  ticket(ttlS) {
    return this.#client.ticket(this.id, ttlS);
  }

  stream(options = {}) {
    return this.#client.stream(this.id, options, this.#sourceSize);
  }

  async #change(method, where, box) {
    const scale = this.#scale();
    return scale.told(await this.#client.json(method, where, asJson({ box: scale.toSent(numbers(box)) })));
  }

  #take(info) {
    this.#sentSize = info.size;
    this.info = info.size ? this.#scale().told(info) : info;
  }

  #scale(sentSize = this.#sentSize) {
    return this.#client.scale(this.#sourceSize, sentSize);
  }
}
