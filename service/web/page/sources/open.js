// Opens what a user chose: a video file, images, a zip file, the sample clip, an address.

import { openDecoded } from "./decoded.js";
import { IMAGES, openImages, openZip } from "./images.js";
import { openSeeking } from "./seeking.js";
import { SourceError } from "./source.js";
import { readTable } from "./table.js";

/** Open files of any kind that the page knows. */
export function openFiles(files) {
  const [first] = files;
  if (files.length > 1 || IMAGES.test(first.name)) return openImages(files, folderOf(first));
  if (/\.zip$/i.test(first.name)) return openZip(first);
  return openVideo(first, { name: first.name, kind: "file" });
}

/** Open the sample clip, with the box of its balloon as a suggestion. */
export async function openSample() {
  const named = (name) => fetch(new URL(`../${name}`, import.meta.url));
  const answers = await Promise.all([named("sample.webm"), named("sample.json")]).catch(() => []);
  if (!answers.length || !answers.every((answer) => answer.ok)) throw new SourceError("sample-missing");
  const { box, size } = await answers[1].json();
  const suggestion = [box[0] / size[0], box[1] / size[1], box[2] / size[0], box[3] / size[1]];
  const source = await openVideo(await answers[0].blob(), { name: "Sample clip", kind: "sample", suggestion });
  source.realTime = true; // a show, that nobody waits for
  return source;
}

/** Open a video or zip file at an address of this server, or of one that the page's policy allows. */
export async function openAddress(address) {
  const url = new URL(address, location.href);
  const name = decodeURIComponent(url.pathname.split("/").at(-1)) || url.host;
  let answer;
  try {
    answer = await fetch(url);
  } catch (error) {
    throw new SourceError("address-unreachable", error);
  }
  if (!answer.ok) throw new SourceError("address-unreachable", new Error(String(answer.status)));
  return openFiles([new File([await answer.blob()], name)]);
}

async function openVideo(blob, about) {
  const table = await readTable(blob);
  return (await openDecoded(about, table)) ?? openSeeking(blob, about, table);
}

const folderOf = (file) => file.webkitRelativePath?.split("/")[0] || file.name;
