// The panels beside the picture: targets, log, figures, notice, connection.

import { announce, byId, el, icon } from "./dom.js";
import { identity } from "./overlay.js";

const LOG_LINES = 300;

/** The list of targets; it calls `onchoose(id)`, `onname(id)` and `onremove(id)`. */
export class TargetList {
  #items = new Map();

  constructor(handlers) {
    Object.assign(this, handlers);
  }

  /** Draw the run's targets that were not removed; `here` are those that are in the picture. */
  draw(run, here, chosen, [width, height]) {
    const targets = [...(run?.targets.values() ?? [])].filter(({ until }) => until === Infinity);
    const ids = targets.map(({ id }) => id);
    for (const [id, item] of this.#items) {
      if (!ids.includes(id)) {
        item.row.remove();
        this.#items.delete(id);
      }
    }
    for (const { id, name, kind } of targets) {
      const item = this.#items.get(id) ?? this.#add(id);
      const row = here.find((one) => one.id === id);
      item.row.dataset.status = row?.status ?? "";
      item.row.dataset.chosen = id === chosen;
      item.pick.setAttribute("aria-pressed", id === chosen);
      item.number.textContent = name.length > 2 ? id : name;
      item.status.textContent = row?.status ?? "not here";
      const [x, y, w, h] = row?.box ?? [];
      const place = row ? [x * width, y * height, w * width, h * height].map(Math.round).join(" ") : "";
      const named = [name === String(id) ? "" : name, kind === "object" ? "" : kind].filter(Boolean).join(", ");
      item.where.textContent = [named, place].filter(Boolean).join(" · ");
    }
    byId("targets-empty").hidden = targets.length > 0;
  }

  #add(id) {
    const number = el("span", { className: "number" });
    number.style.borderBottomColor = identity(id);
    const status = el("span", { className: "status" });
    const where = el("span", { className: "where", title: "x y w h, pixels" });
    const pick = el("button", { className: "pick", title: "Choose; a drag on its box corrects it" }, number, status, where);
    const rename = this.#button("name", `Name target ${id}`, () => this.onname(id));
    const remove = this.#button("remove", `Remove target ${id}`, () => this.onremove(id));
    pick.addEventListener("click", () => this.onchoose(id));
    const row = el("li", { data: { target: id } }, pick, rename, remove);
    byId("targets").append(row);
    const item = { row, pick, number, status, where };
    this.#items.set(id, item);
    return item;
  }

  #button(name, label, onclick) {
    const button = el("button", { className: "icon", title: label, data: { does: name } }, icon(name));
    button.setAttribute("aria-label", label);
    button.addEventListener("click", onclick);
    return button;
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
  const before = byId("connection-text").textContent;
  if (before === text) return;
  byId("connection").dataset.tone = tone;
  byId("connection-text").textContent = text;
  const same = before.replace(/\d+/, "") === text.replace(/\d+/, ""); // the seconds that go by are not read out
  if (!same && (tone === "busy" || tone === "bad")) announce(text);
}

/** The figures under the picture, from a stream's statistics; `missed` is how many frames were not tracked. */
export class Figures {
  #bytes = [];

  draw(stats, missed, trackMs) {
    const now = performance.now();
    if (stats.bytesSent < (this.#bytes.at(-1)?.[1] ?? 0)) this.#bytes = []; // a new stream
    this.#bytes.push([now, stats.bytesSent]);
    while (now - this.#bytes[0][0] > 3000) this.#bytes.shift();
    const [since, before] = this.#bytes[0];
    const mbit = now > since ? ((stats.bytesSent - before) * 8e-3) / (now - since) : 0;
    const saved = stats.bytesSaved / Math.max(1, stats.bytesSaved + stats.bytesSent);
    figure("latency", stats.latencyP50Ms?.toFixed(0), stats.latencyP50Ms === null ? "" : ` ms · p95 ${stats.latencyP95Ms.toFixed(0)}`);
    figure("rate", stats.rate.toFixed(0), " fps");
    figure("dropped", missed, "");
    figure("track", trackMs?.toFixed(1), trackMs == null ? "" : " ms");
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
