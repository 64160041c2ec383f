// Says how a program would do what the page does: curl, Python and JavaScript for this source, box and settings.

import { HOME } from "./tracking.js";
import { pixels } from "./exports/rows.js";

/** `{curl, python, javascript}` for a run: its first boxes, on the video of its name, with its options. */
export function codeFor(run) {
  const { source, options, marks } = run;
  const [first] = marks;
  const boxes = marks.filter(({ time }) => time === first.time).map(({ box }) => pixels(box, source.size).map((value) => Math.round(value * 10) / 10));
  const told = { source, boxes, preset: options.preset, frame: run.record(first.time)?.frame ?? 0 };
  return { curl: curl(told), python: python(told), javascript: javascript(told) };
}

const quoted = (text) => `'${String(text).replaceAll("'", "'\\''")}'`;

function curl({ boxes, preset }) {
  return `# frame.jpg: the frame on which the boxes were drawn; next.jpg: the one after it
ID=$(curl -s ${HOME}/v1/sessions -F frame=@frame.jpg \\
  -F boxes=${quoted(JSON.stringify(boxes))} -F options=${quoted(JSON.stringify({ preset }))} |
  python3 -c 'import json, sys; print(json.load(sys.stdin)["id"])')
curl -s ${HOME}/v1/sessions/$ID/frames -H 'Content-Type: image/jpeg' --data-binary @next.jpg
curl -s "${HOME}/v1/sessions/$ID/trajectory?format=csv"
curl -s -X DELETE ${HOME}/v1/sessions/$ID
`;
}

function python({ source, boxes, preset, frame }) {
  return `import itertools

import cv2  # pip install opencv-python-headless
from service.client import Client


def frames(path, first):
    film = cv2.VideoCapture(path)
    for _ in range(first):
        film.grab()
    while (read := film.read())[0]:
        yield cv2.imencode(".jpg", read[1])[1].tobytes()


film = frames(${JSON.stringify(source.name)}, ${frame})
with Client(${JSON.stringify(HOME)}) as client:
    first = next(film)
    with client.create(first, boxes=${JSON.stringify(boxes)}, preset=${JSON.stringify(preset)}) as session:
        for number, image in enumerate(film, ${frame + 1}):
            for target in session.track(image).targets:
                print(number, target.id, target.box, target.status, target.confidence)
`;
}

function javascript({ source, boxes, preset }) {
  return `import { Client } from ${JSON.stringify(`${HOME}/static/client/mfcmt.js`)};

const video = Object.assign(document.createElement("video"), { src: ${JSON.stringify(source.name)}, muted: true });
await new Promise((done) => video.addEventListener("loadeddata", done, { once: true }));
const client = new Client({ url: ${JSON.stringify(HOME)} });
const session = await client.createSession({ frame: video, boxes: ${JSON.stringify(boxes)}, options: { preset: ${JSON.stringify(preset)} } });
const stream = session.stream({ mode: "latest" });
stream.follow(video);
await video.play();
for await (const { seq, targets } of stream) console.log(seq, targets);
`;
}
