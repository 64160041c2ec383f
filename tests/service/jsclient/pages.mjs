// What pages do with the client beside tracking: they are left, meet refusals, show and draw boxes. `await run(NAME, given)`.
import { Client, MFCMTError, fittedSize } from "/static/client/mfcmt.js";
import { drawBoxes, letterboxOf, overlay } from "/static/client/view.js";

const image = async (url) => (await fetch(url)).blob();
const asData = (error) => {
  if (!(error instanceof MFCMTError)) throw error;
  const { code, status, reason, retryAfter, detail } = error;
  return { code, status, reason, retryAfter, detail };
};

const scenarios = {
  /** A session that is not closed. */
  async begun(given) {
    const client = new Client({ url: given.url });
    const session = await client.createSession({ frame: await image(given.frames[0]), box: given.box, ...given.create });
    window.stream = session.stream();
    await window.stream.ready;
    window.stream.closed.catch((error) => (window.ended = asData(error)));
    return session.id;
  },

  /** The refusal of a creation. */
  async refused(given) {
    const client = new Client({ url: given.url });
    const create = { frame: await image(given.frames[0]), box: given.box, waitMs: 0 };
    return client.createSession(create).then(() => null, asData);
  },

  /** Frames that are sent smaller than they are, with boxes in pixels of the source everywhere. */
  async source(given) {
    const { url, maxSide } = given;
    const pictures = await Promise.all(given.frames.map(async (each) => createImageBitmap(await image(each))));
    const client = new Client({ url, boxesIn: "source" });
    const session = await client.createSession({ frame: pictures[0], box: given.box, maxSide });
    const told = { info: [session.info.size, session.info.targets[0].box] };
    const http = await session.track(pictures[1], { maxSide });
    told.http = [http.size, http.targets[0].box];
    const stream = session.stream({ mode: "lossless", maxSide, regions: given.regions });
    const results = stream.results;
    const boxes = [http.targets[0].box];
    const next = async (index) => {
      await stream.send(pictures[index]);
      const { value } = await results.next();
      boxes.push(value.targets[0].box);
      return value;
    };
    for (let index = 2; index < pictures.length; index += 1) told.size = (await next(index)).size;
    told.boxes = boxes;
    told.stream = [stream.size, stream.targets[0].box];
    stream.regions = false; // a correction of a frame that was sent in part would wait for the next one
    await next(0);
    const corrected = await stream.correct(0, given.box);
    told.corrected = corrected.targets[0].box;
    const added = stream.add(given.box, { onNext: true });
    await next(0);
    told.added = (await added).targets[1].box;
    const moved = await client.getSession(session.id);
    told.sent = [moved.info.size, fittedSize(pictures[0].width, pictures[0].height, maxSide)];
    stream.close();
    told.past = (await session.trajectory()).at(-1).size;
    await session.close();
    return told;
  },

  /** A picture in a box of another shape, with an overlay, ready to be drawn on. */
  async shown(given) {
    const picture = document.querySelector("#picture");
    picture.style.objectFit = given.fit;
    picture.style.objectPosition = given.position ?? "";
    picture.src = given.frames[0];
    await picture.decode();
    window.drafts = 0;
    window.layer = overlay(picture, { label: ({ id }) => `target ${id}` });
    window.layer.draw([{ id: 7, box: given.box, status: "uncertain" }]);
    const stop = drawBoxes(picture, (box) => (window.drawn = box), { onDraft: (box) => ((window.drafts += 1), window.layer.draft(box)) });
    window.stopDrawing = stop;
    const rectangle = window.layer.svg.querySelector("rect").getBoundingClientRect();
    const { left, top } = picture.getBoundingClientRect();
    const label = window.layer.svg.querySelector("text").textContent;
    const { area } = letterboxOf(picture);
    return { rectangle: [rectangle.x - left, rectangle.y - top, rectangle.width, rectangle.height], area, label, corner: [left, top] };
  },
};

window.run = (name, given) => scenarios[name](given);
window.up = true;
