// The settings: a form whose values the browser keeps.

import { byId } from "./dom.js";
import { regionsByDefault } from "../client/mfcmt.js";

const STORE = "mfcmt.settings.2";
const MODE_HELP = {
  auto: "Every frame of a file is tracked; of a camera the newest one.",
  latest: "The newest frame is sent: the least delay, and late frames are dropped.",
  lossless: "Every frame is answered; a file is played frame by frame.",
};
/** The settings whose change needs a new session. */
export const OF_THE_SESSION = ["maxSide", "maps", "preset"];

export class Settings {
  #form = byId("settings");

  /** `onchange(name)` is called after each change. */
  constructor(onchange) {
    const slim = regionsByDefault(); // a phone, or data to be saved
    const usual = { mode: "auto", maxSide: slim ? 480 : 640, quality: 0.8, regions: slim, maps: !slim, trail: true, preset: "default" };
    this.values = { ...usual, ...this.#stored() };
    this.#fill();
    this.#form.addEventListener("submit", (event) => event.preventDefault());
    this.#form.addEventListener("input", ({ target }) => {
      if (target.name === "camera") return;
      this.#read();
      this.#fill();
      onchange(target.name);
    });
  }

  #stored() {
    try {
      const kept = JSON.parse(localStorage.getItem(STORE) ?? "{}");
      return kept && typeof kept === "object" ? kept : {};
    } catch {
      return {};
    }
  }

  #read() {
    const { mode, maxSide, quality, regions, maps, trail, preset } = this.#form.elements;
    this.values = {
      mode: mode.value,
      maxSide: Number(maxSide.value),
      quality: Number(quality.value),
      regions: regions.checked,
      maps: maps.checked,
      trail: trail.checked,
      preset: preset.value,
    };
    localStorage.setItem(STORE, JSON.stringify(this.values));
  }

  #fill() {
    const { elements } = this.#form;
    for (const [name, value] of Object.entries(this.values)) {
      if (!elements[name]) continue;
      if (typeof value === "boolean") elements[name].checked = value;
      else elements[name].value = String(value);
    }
    byId("quality-value").textContent = Math.round(this.values.quality * 100);
    byId("mode-help").textContent = MODE_HELP[this.values.mode] ?? "";
    byId("maps-card").hidden = !this.values.maps;
  }
}
