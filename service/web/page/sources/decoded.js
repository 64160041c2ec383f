// A video file whose frames are decoded one by one, with WebCodecs.

import { FrameSource, SourceError } from "./source.js";
import { nearest } from "./times.js";
import { library } from "./table.js";

const FAR = 48; // frames; a jump that is longer begins at the key frame before its end
const EARLY_S = 1e-4; // containers round times

export class DecodedSource extends FrameSource {
  #input;
  #sink;
  #frames = null;
  #next = -1; // the number of the frame that comes next from #frames
  #sample = null;

  constructor(about, table, sink) {
    super({ ...about, fps: table.fps }, table);
    this.#input = table.input;
    this.#sink = sink;
  }

  draw(context, width, height) {
    this.#sample.draw(context, 0, 0, width, height);
  }

  /** Decode a frame; resolves to its number, which is a later one where the decoder cannot show it. */
  async load(index) {
    if (this.#sample && index === this.index) return index;
    if (index < this.#next || index > this.#next + FAR || !this.#frames) await this.#jump(index);
    const wanted = this.times[index] - EARLY_S;
    for (;;) {
      const { value: sample, done } = await this.#decoded();
      if (done) return this.#end();
      if (sample.timestamp < wanted) {
        sample.close();
        continue;
      }
      this.#sample?.close();
      this.#sample = sample;
      const found = nearest(this.times, sample.timestamp);
      this.#next = found + 1;
      return found;
    }
  }

  close() {
    super.close();
    this.#frames?.return().catch(() => {});
    this.#sample?.close();
    this.#sample = null;
    this.#input.dispose();
  }

  async #jump(index) {
    await this.#frames?.return();
    this.#frames = this.#sink.samples(this.times[index]);
    this.#next = index;
  }

  async #decoded() {
    try {
      return await this.#frames.next();
    } catch (error) {
      this.#frames = null;
      throw new SourceError("video-broken", error);
    }
  }

  /** The file ends before its table does: it has been cut off. */
  #end() {
    this.#frames = null;
    if (!this.#sample) throw new SourceError("video-broken");
    this.count = this.index + 1;
    this.duration = this.time + 1 / this.fps;
    return this.index;
  }
}

/** Open a file by its table (see table.js); resolves to null where the browser cannot decode it frame by frame. */
export async function openDecoded(about, table) {
  if (typeof VideoDecoder === "undefined" || !table || !(await table.track.canDecode().catch(() => false))) return null;
  const { VideoSampleSink } = await library();
  const source = new DecodedSource(about, table, new VideoSampleSink(table.track));
  try {
    await source.show(0);
    return source;
  } catch {
    source.close();
    return null; // what it said that it can decode
  }
}
