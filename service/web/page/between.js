// Tracks a target between two boxes that a person set, from both ends, and joins the ways.

import { Frames } from "./frames.js";
import { join } from "./join.js";
import { Tracking, rowOf } from "./tracking.js";
import { at } from "./sources/times.js";

const BLOCK = 40; // frames in memory at once: they are decoded forward, also where they are tracked backward

export class Between {
  /** What is being done, as text; null when nothing is. */
  doing = null;
  #app;
  #frames = new Frames();

  constructor(app) {
    this.#app = app;
  }

  /** The chosen target's newest box up to the shown frame, and the one set before it, as marks; null where it has not both. */
  get ends() {
    const { run, chosen, source, shown } = this.#app;
    if (!run || chosen === null || !source?.times) return null;
    const set = run.marks.filter(({ target, time }) => target === chosen && time <= shown.time);
    const found = set.slice(-2);
    return found.length === 2 && this.#number(found[1]) - this.#number(found[0]) > 1 ? found : null;
  }

  /** Track between both ends and replace what is between them. Resolves to false if the source or the run is left. */
  async join() {
    const { run, source, player, follower } = this.#app;
    const [from, to] = this.ends;
    const id = from.target;
    const [first, last] = [this.#number(from), this.#number(to)];
    const between = [...Array(last - first - 1).keys()].map((i) => first + 1 + i);
    const known = new Map(between.map((n) => [n, run.record(source.times[n])?.rows.get(id)]).filter(([, row]) => row));
    const here = () => this.#app.run === run && this.#app.state === "starting";
    this.#app.halt();
    this.#say("Tracking back…");
    this.#app.to("starting");
    try {
      const back = await this.#pass(to.box, last, [...between].reverse(), here);
      const lastKnown = [first, ...known.keys()].at(-1);
      const missing = between.filter((n) => n > lastKnown);
      const start = known.get(lastKnown)?.box ?? from.box;
      const on = missing.length && back ? await this.#pass(start, lastKnown, missing, here) : new Map();
      if (!back || !on || !here()) return false;
      this.#put(run, id, between, { ahead: new Map([...known, ...on]), back, first, last });
    } finally {
      this.doing = null;
      if (this.#app.run === run && this.#app.state === "starting") {
        follower.reached = run.frontier ?? -Infinity;
        this.#app.to("ended");
        await player.move((one) => one.show(last));
      }
    }
    return true;
  }

  #number({ time }) {
    return at(this.#app.source.times, time);
  }

  /** Track from `box` on the frame `first` through the frames `numbers`. Resolves to the rows by number, or null if it is left. */
  async #pass(box, first, numbers, here) {
    const { player, settings, source } = this.#app;
    const size = this.#app.size();
    const rows = new Map();
    const grab = async (n) => {
      await player.move((one) => one.show(n));
      return here() ? this.#frames.grab(source, size) : null;
    };
    let answered = () => {};
    let failed;
    const broken = new Promise((_, reject) => (failed = reject));
    broken.catch(() => {}); // it is heard where it matters
    const tracking = new Tracking({
      onresult: ({ size: sent, targets: [target] }, _, frame) => {
        rows.set(frame.index, rowOf(target, sent));
        this.#say(`Tracking between… ${Math.round((100 * rows.size) / numbers.length)} %`);
        answered();
      },
      onstatus: () => {},
      onproblem: failed,
      onend: failed,
      onspare: (frame) => this.#frames.release(frame),
    });
    try {
      const start = await grab(first);
      if (!start) return null;
      const options = { ...settings.values, mode: "lossless", maps: false, regions: false, label: source.name };
      await tracking.start(start, [{ target: 1, box }], options);
      rows.clear(); // of the frame that is known
      for (let i = 0; i < numbers.length; i += BLOCK) {
        const block = numbers.slice(i, i + BLOCK);
        const decoded = new Map();
        for (const n of [...block].sort((a, b) => a - b)) decoded.set(n, await grab(n));
        for (const n of block) {
          if (!here()) return null;
          await Promise.race([tracking.send(decoded.get(n)), broken]);
        }
      }
      while (rows.size < numbers.length && here()) await Promise.race([new Promise((done) => (answered = done)), broken]);
      return here() ? rows : null;
    } finally {
      tracking.stop();
    }
  }

  #put(run, id, between, { ahead, back, first, last }) {
    const { times } = this.#app.source;
    const paired = between.filter((n) => ahead.has(n));
    const ways = join(paired.map((n) => ahead.get(n)), paired.map((n) => back.get(n)), paired.map((n) => (n - first) / (last - first)));
    const rows = new Map([...back, ...paired.map((n, i) => [n, ways[i]])]);
    let seq = run.nextSeq;
    for (const n of between) {
      const about = run.record(times[n]) ?? { time: times[n], frame: n, seq: seq++, size: this.#app.source.size };
      run.put({ ...about, rows: new Map([[id, rows.get(n)]]) });
    }
  }

  #say(text) {
    this.doing = text;
    this.#app.changed();
  }
}
