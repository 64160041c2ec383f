// Live strips of the chosen target: its confidence, the three scores and the fused map's peak.

import { byId, colour, crisp, el } from "./dom.js";

export const KEPT = 240; // samples of a strip
const THRESHOLDS = [0.4, 0.2]; // of the confidence: tracking from the first on, lost after a second below the other

const STRIPS = [
  { name: "Confidence", key: "confidence", most: 1, lines: THRESHOLDS, help: "probability that the box overlaps the target by more than half; lines at 0.4 (tracking) and 0.2 (lost)" },
  { name: "Fused", key: "fused", most: 2, lines: [1], help: "peak of the fused map over its mean of the last ten frames" },
  { name: "Template", key: "template", most: 2, lines: [1], help: "the template maps' peak over its mean of the last ten frames" },
  { name: "Statistical", key: "statistical", most: 2, lines: [1], help: "the colour histogram map's peak over its mean of the last ten frames" },
  { name: "Fused peak", key: "psr", most: 0, lines: [], help: "peak-to-sidelobe ratio of the fused map" },
];

export class Strips {
  #rows = STRIPS.map((strip) => {
    const canvas = el("canvas", { role: "img" });
    canvas.setAttribute("aria-label", strip.help);
    const value = el("span", { className: "value", textContent: "–" }); // no <output>: it would be read out at each change
    const row = el("div", { className: "strip", title: strip.help }, el("span", { className: "name", textContent: strip.name }), canvas, value);
    row.dataset.key = strip.key;
    return { ...strip, canvas, value, row };
  });

  constructor() {
    byId("strips").append(...this.#rows.map(({ row }) => row));
  }

  /** Draw the rows `samples` of the target with this name, or nothing. */
  draw(name, samples) {
    byId("strips-of").textContent = name;
    for (const strip of this.#rows) {
      const values = samples.map((sample) => valueOf(strip.key, sample));
      const passed = samples.map((sample) => hasPassed(strip.key, sample));
      const last = values.at(-1);
      strip.value.textContent = last == null ? "–" : last > 99 ? ">99" : last.toFixed(last < 10 ? 2 : 1);
      strip.row.dataset.passed = passed.at(-1) ?? true;
      chart(strip, values, passed);
    }
  }
}

function valueOf(key, sample) {
  return (key === "confidence" || key === "psr" ? sample[key] : sample.scores?.[key]) ?? null;
}

function hasPassed(key, { flags, status }) {
  if (key === "confidence") return status === "tracking";
  return flags?.[key] ?? true;
}

function chart({ canvas, most, lines }, values, passed) {
  const { context, width, height } = crisp(canvas);
  context.clearRect(0, 0, width, height);
  const top = most || Math.max(20, ...values.filter((value) => value !== null)) * 1.1;
  const y = (value) => height - 2 - (Math.min(value, top) / top) * (height - 4);
  const x = (i) => width - (values.length - i) * (width / KEPT);
  context.fillStyle = colour("--line");
  for (const line of lines) context.fillRect(0, Math.round(y(line)), width, 1); // a threshold, or 1: as on the frames before
  context.fillStyle = colour("--uncertain");
  passed.forEach((fine, i) => fine || context.fillRect(x(i), 0, Math.max(1, width / KEPT), height));
  context.strokeStyle = colour("--ink");
  context.lineWidth = 1.25;
  context.beginPath();
  let open = false;
  values.forEach((value, i) => {
    if (value !== null) context[open ? "lineTo" : "moveTo"](x(i), y(value));
    open = value !== null;
  });
  context.stroke();
}
