// Runs as lines of text: CSV, OTB, MOT. The forms are those of `mfcmt track`.

import { byTarget, numbers, rowsOf } from "./rows.js";

const COLUMNS = ["frame", "time_s", "target", "x", "y", "w", "h", "status", "reliable", "fused", "template", "statistical", "psr", "updated", "scale", "confidence"];

export function csv(run) {
  const lines = [COLUMNS.join(",")];
  for (const { frame, time, target, box, status, reliable, scores, psr, updated, scale, confidence } of rowsOf(run)) {
    const { fused, template, statistical } = scores ?? {};
    const cells = [frame, micro(time), target.name, ...box, status, reliable, fused, template, statistical, psr, updated, scale, confidence];
    lines.push(cells.map(cell).join(","));
  }
  return `${lines.join("\n")}\n`;
}

/** A line for each frame of one target, with pixels counted from 1. */
export function otb(run, target) {
  const [, rows] = byTarget(run).find(([{ id }]) => id === target) ?? [null, []];
  return rows.map(({ box }) => `${fromOne(box)}\n`).join("");
}

/** Frames, pixels and targets are counted from 1; a lost target has no line. */
export function mot(run) {
  const number = numbers(run);
  const told = [...rowsOf(run)].filter(({ status }) => status !== "lost");
  return told.map((row) => `${number(row) + 1},${row.target.id},${fromOne(row.box)},${(row.confidence ?? 1).toFixed(4)},-1,-1,-1\n`).join("");
}

const fromOne = ([x, y, w, h]) => [x + 1, y + 1, w, h].map((value) => value.toFixed(3)).join(",");

/** A time, to a microsecond. */
export const micro = (time) => Math.round(time * 1e6) / 1e6;

function cell(value) {
  if (typeof value === "number") return Number(value.toPrecision(10));
  const text = String(value ?? "");
  return /[",\n\r]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
}
