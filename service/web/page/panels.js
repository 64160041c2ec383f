// The panels beside the picture: targets, log, figures, notice, connection.

import { announce, byId, el, icon } from "./dom.js";

const LOG_LINES = 300;
const FINAL = { tracking: "tracking", uncertain: "uncertain", lost: "lost" };

/** The list of targets; it calls `onchoose(id)` and `onremove(id)`. */
export class TargetList {
  #items = new Map();

  constructor(handlers) {
    Object.assign(this, handlers);
  }

  /** Draw the history's `targets`; the last argument is the source's size in pixels. */
  draw(targets, chosen, [width, height]) {
    const ids = targets.map(({ id }) => id);
    for (const [id, item] of this.#items) {
      if (!ids.includes(id)) {
        item.row.remove();
        this.#items.delete(id);
      }
    }
    for (const { id, status, box } of targets) {
      const item = this.#items.get(id) ?? this.#add(id);
      const [x, y, w, h] = box;
      item.row.dataset.status = status;
      item.row.dataset.chosen = id === chosen;
      item.pick.setAttribute("aria-pressed", id === chosen);
      item.status.textContent = FINAL[status];
      item.where.textContent = [x * width, y * height, w * width, h * height].map(Math.round).join(" ");
    }
    byId("targets-empty").hidden = targets.length > 0;
  }

  #add(id) {
    const status = el("span", { className: "status" });
    const where = el("span", { className: "where", title: "x y w h, pixels" });
    const pick = el("button", { className: "pick", title: "Choose; a new box corrects it" }, el("span", { className: "number", textContent: id }), status, where);
    const remove = el("button", { className: "icon", title: "Remove" }, icon("remove"));
    remove.setAttribute("aria-label", `Remove target ${id}`);
    pick.addEventListener("click", () => this.onchoose(id));
    remove.addEventListener("click", () => this.onremove(id));
    const row = el("li", { data: { target: id } }, pick, remove);
    byId("targets").append(row);
    const item = { row, pick, status, where };
    this.#items.set(id, item);
    return item;
  }
}

export const log = {
  /** Add a line; `status` sets the color of its strong part. */
  add(at, strong, what = "", status = null) {
    const line = el("li", {}, el("time", { textContent: at }), el("span", {}, el("b", { textContent: strong }), what && ` ${what}`));
    if (status) line.dataset.status = status;
    const list = byId("log");
    list.prepend(line);
    while (list.children.length > LOG_LINES) list.lastChild.remove();
  },
  clear() {
    byId("log").replaceChildren();
  },
};

export const notice = {
  action: null,
  show({ title, text, label }, { tone = "bad", onaction = null } = {}) {
    byId("notice").dataset.tone = tone;
    byId("notice-title").textContent = title;
    byId("notice-text").textContent = text;
    const button = byId("notice-action");
    button.hidden = !(onaction && label);
    button.textContent = label ?? "";
    notice.action = onaction;
    byId("notice").hidden = false;
  },
  hide() {
    byId("notice").hidden = true;
    notice.action = null;
  },
};
byId("notice-action").addEventListener("click", () => {
  const { action } = notice;
  notice.hide();
  action?.();
});
byId("notice-close").addEventListener("click", notice.hide);

/** The state of the connection in the bar. Its tones are idle, good, busy and bad. */
export function connection(text, tone) {
  if (byId("connection-text").textContent === text) return;
  byId("connection").dataset.tone = tone;
  byId("connection-text").textContent = text;
  if (tone === "busy" || tone === "bad") announce(text);
}

/** The figures under the picture, from a stream's statistics. */
export class Figures {
  #bytes = [];

  draw(stats, skipped, trackMs) {
    const now = performance.now();
    this.#bytes.push([now, stats.bytesSent]);
    while (now - this.#bytes[0][0] > 3000) this.#bytes.shift();
    const [since, before] = this.#bytes[0];
    const mbit = now > since ? ((stats.bytesSent - before) * 8e-3) / (now - since) : 0;
    const saved = stats.bytesSaved / Math.max(1, stats.bytesSaved + stats.bytesSent);
    figure("latency", stats.latencyP50Ms?.toFixed(0), stats.latencyP50Ms === null ? "" : ` ms · p95 ${stats.latencyP95Ms.toFixed(0)}`);
    figure("rate", stats.rate.toFixed(0), " fps");
    figure("dropped", stats.dropped + stats.skipped + skipped, "");
    figure("track", trackMs?.toFixed(1), trackMs == null ? "" : " ms a frame");
    figure("sent", mbit.toFixed(1), " Mbit/s");
    figure("saved", stats.bytesSaved ? `${Math.round(100 * saved)} %` : "–", stats.bytesSaved ? ` ${volume(stats.bytesSaved)}` : "");
  }

  clear() {
    this.#bytes = [];
    for (const name of ["latency", "rate", "dropped", "track", "sent", "saved"]) figure(name, null, "");
  }
}

function figure(name, value, unit) {
  byId(`stat-${name}`).replaceChildren(String(value ?? "–"), el("small", { textContent: unit }));
}

const volume = (bytes) => (bytes < 1e6 ? `${Math.round(bytes / 1e3)} kB` : `${(bytes / 1e6).toFixed(1)} MB`);
