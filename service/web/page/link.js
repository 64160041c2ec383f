// A link to a source with a box: `?src=ADDRESS&box=x,y,w,h`, in pixels of the source.

import { openAddress, openSample } from "./sources/open.js";

export class Link {
  constructor(address, box) {
    Object.assign(this, { address, box });
  }

  /** The link in the page's address, or null. */
  static here() {
    const query = new URLSearchParams(location.search);
    const address = query.get("src");
    const box = (query.get("box") ?? "").split(",").map(Number);
    return address ? new Link(address, box.length === 4 && box.every(Number.isFinite) ? box : null) : null;
  }

  /** Open the source, and follow the box where there is one. */
  async open(app) {
    const opened = await app.open(() => (this.address === "sample" ? openSample() : openAddress(this.address)));
    if (!opened || !this.box) return;
    const [width, height] = app.source.size;
    const [x, y, w, h] = this.box;
    await app.box([x / width, y / height, w / width, h / height]);
  }
}
