// Images in the order of their names, as the frames of a source: a folder of them, several files, or a zip file.

import { FrameSource, SourceError } from "./source.js";

export const IMAGES = /\.(jpe?g|png|webp|bmp|gif|avif)$/i;
const MOST_BYTES = 2 ** 31;
const FPS = 30; // images have no times; this is how fast they play

class ImagesSource extends FrameSource {
  #files;
  #picture = null;

  constructor(about, files, size) {
    const times = files.map((_, i) => i / FPS);
    super({ ...about, fps: FPS }, { times, duration: files.length / FPS, size, names: files.map(({ name }) => name) });
    this.#files = files;
  }

  draw(context, width, height) {
    context.drawImage(this.#picture, 0, 0, width, height);
  }

  async load(index) {
    if (this.#picture && index === this.index) return index;
    const picture = await decoded(this.#files[index]);
    this.#picture?.close();
    this.#picture = picture;
    this.size = [picture.width, picture.height];
    return index;
  }

  close() {
    super.close();
    this.#picture?.close();
  }
}

/** Open images: Files, of a folder or not. */
export async function openImages(files, name) {
  const byName = new Intl.Collator("en", { numeric: true }).compare;
  const images = [...files].filter((file) => IMAGES.test(file.name)).sort((a, b) => byName(a.webkitRelativePath || a.name, b.webkitRelativePath || b.name));
  if (!images.length) throw new SourceError("images-missing");
  const first = await decoded(images[0]);
  const source = new ImagesSource({ name, kind: "images" }, images, [first.width, first.height]);
  first.close();
  await source.show(0);
  return source;
}

/** Open the images of a zip file. */
export async function openZip(file) {
  const { unzipSync } = await import("../vendor/fflate/browser.js");
  let bytes = 0;
  const fits = ({ name, originalSize }) => {
    const wanted = IMAGES.test(name) && !/(^|\/)(\.|__MACOSX)/.test(name);
    if (wanted) bytes += originalSize;
    if (bytes > MOST_BYTES) throw new SourceError("zip-too-large");
    return wanted;
  };
  let found;
  try {
    found = unzipSync(new Uint8Array(await file.arrayBuffer()), { filter: fits });
  } catch (error) {
    throw error instanceof SourceError ? error : new SourceError("zip-unreadable", error);
  }
  return openImages(Object.entries(found).map(([name, data]) => new File([data], name)), file.name);
}

async function decoded(file) {
  try {
    return await createImageBitmap(file);
  } catch (error) {
    throw new SourceError("image-unreadable", new Error(file.name, { cause: error }));
  }
}
