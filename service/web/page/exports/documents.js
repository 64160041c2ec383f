// Runs as documents of other tools: COCO for video, CVAT for video 1.1, YOLO. The forms are those of `mfcmt track`.

import { zipped } from "./zip.js";
import { points } from "./paths.js";
import { byTarget, imageName, numbers, rowsOf, seen, stem } from "./rows.js";
import { micro } from "./lines.js";

const TOLERANCE_PX = 2;
const round = (value, digits) => Math.round(value * 10 ** digits) / 10 ** digits;
const kindsOf = (tracks) => [...new Set(tracks.map(([{ kind }]) => kind))];

/** Images with the number of their frame, annotations with the number of their track; numbers count from 1. */
export function coco(run) {
  const { source } = run;
  const [width, height] = source.size;
  const tracks = byTarget(run);
  const kinds = kindsOf(tracks);
  const number = numbers(run);
  const images = new Map();
  const annotations = [];
  for (const [target, rows] of tracks) {
    for (const row of rows) {
      const frame = number(row);
      images.set(frame, { id: frame + 1, video_id: 1, frame_id: frame, file_name: imageName(source, frame), width, height, time_s: micro(row.time) });
      const box = seen(row);
      if (!box) continue;
      const [x, y, w, h] = box.map((value) => round(value, 3));
      annotations.push({
        id: annotations.length + 1,
        image_id: frame + 1,
        video_id: 1,
        track_id: target.id,
        instance_id: target.id,
        category_id: kinds.indexOf(target.kind) + 1,
        bbox: [x, y, w, h],
        area: round(w * h, 3),
        segmentation: [],
        iscrowd: 0,
        score: round(row.confidence ?? 1, 4),
        status: row.status,
      });
    }
  }
  const told = {
    info: { description: `${source.name}, tracked with MFCMT` },
    videos: [{ id: 1, name: source.name, width, height, fps: source.fps }],
    categories: kinds.map((name, i) => ({ id: i + 1, name })),
    tracks: tracks.map(([{ id, name, kind }]) => ({ id, name, category_id: kinds.indexOf(kind) + 1, video_id: 1 })),
    images: [...images.values()].sort((a, b) => a.id - b.id),
    annotations,
  };
  return `${JSON.stringify(told, null, 1)}\n`;
}

/** A track for each target, with a box at each keyframe, between which CVAT interpolates. The label is the class. */
export function cvat(run) {
  const { source } = run;
  const tracks = byTarget(run);
  const number = numbers(run);
  const length = source.count ?? run.records.length;
  const attribute = [["name", "name"], ["mutable", "False"], ["input_type", "text"], ["default_value", ""], ["values", ""]].map(([name, value]) => tag(name, value));
  const labels = kindsOf(tracks).map((kind) => tag("label", [tag("name", kind), tag("attributes", [tag("attribute", attribute)])]));
  const [width, height] = source.size;
  const task = [
    tag("name", source.name), tag("size", length), tag("mode", "interpolation"), tag("start_frame", 0), tag("stop_frame", Math.max(0, length - 1)),
    tag("labels", labels), tag("original_size", [tag("width", width), tag("height", height)]), tag("source", source.name),
  ];
  const paths = tracks.map(([target, rows]) => {
    const boxes = [...points(rows, number, TOLERANCE_PX)];
    const last = boxes.at(-1);
    const end = number(rows.at(-1));
    if (last?.present && end < length - 1) boxes.push({ ...last, frame: end + 1, present: false }); // a track that ends before the clip
    return tag("track", boxes.map((one) => boxTag(one, target.name)), { id: target.id - 1, label: target.kind, source: "auto" });
  });
  const root = tag("annotations", [tag("version", "1.1"), tag("meta", [tag("task", task)]), ...paths]);
  return `<?xml version="1.0" encoding="utf-8"?>\n${written(root, 0)}\n`;
}

/** A zip file with a text file for each frame (`class x y w h`, shares of the frame), and `data.yaml`. */
export async function yolo(run) {
  const tracks = byTarget(run);
  const kinds = kindsOf(tracks);
  const number = numbers(run);
  const files = new Map();
  for (const row of rowsOf(run)) {
    const name = `labels/${stem(imageName(run.source, number(row)).split("/").at(-1))}.txt`;
    const box = seen(row);
    const [width, height] = row.size;
    const shares = box && [(box[0] + box[2] / 2) / width, (box[1] + box[3] / 2) / height, box[2] / width, box[3] / height];
    const line = shares ? `${kinds.indexOf(row.target.kind)} ${shares.map((share) => share.toFixed(6)).join(" ")}\n` : "";
    files.set(name, (files.get(name) ?? "") + line);
  }
  const names = kinds.map((kind, i) => `  ${i}: ${JSON.stringify(kind)}\n`).join("");
  files.set("data.yaml", `path: .\ntrain: images\nval: images\nnames:\n${names}`);
  return zipped(files);
}

function boxTag({ frame, box: [x, y, w, h], present }, name) {
  const edges = Object.fromEntries(Object.entries({ xtl: x, ytl: y, xbr: x + w, ybr: y + h }).map(([key, value]) => [key, value.toFixed(2)]));
  const about = { frame, keyframe: 1, outside: present ? 0 : 1, occluded: 0, ...edges, z_order: 0 };
  return tag("box", [tag("attribute", name, { name: "name" })], about);
}

/** An element: `content` is text, or a list of elements. */
function tag(name, content, attributes = {}) {
  return { name, content, attributes };
}

function written({ name, content, attributes }, depth) {
  const space = "  ".repeat(depth);
  const head = [name, ...Object.entries(attributes).map(([key, value]) => `${key}="${escaped(value).replaceAll('"', "&quot;")}"`)].join(" ");
  if (!Array.isArray(content)) return String(content) === "" ? `${space}<${head} />` : `${space}<${head}>${escaped(content)}</${name}>`;
  if (!content.length) return `${space}<${head} />`;
  return `${space}<${head}>\n${content.map((one) => written(one, depth + 1)).join("\n")}\n${space}</${name}>`;
}

const escaped = (value) => String(value).replaceAll("&", "&amp;").replaceAll("<", "&lt;").replaceAll(">", "&gt;");
