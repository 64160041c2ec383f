// Draws the box and sends it; the address's token is spent at once and taken out of the address.
const $ = (id) => document.getElementById(id);
const stage = $("stage"), frame = $("frame"), mark = $("box"), status = $("status"), go = $("go");
const fields = ["x", "y", "w", "h"].map($);
let box = null, key = null, scale = 1, drag = null;

const say = (text) => { status.value = text; };
const size = () => [frame.naturalWidth, frame.naturalHeight];
const clamp = (v, low, high) => Math.min(Math.max(v, low), Math.max(low, high));
const tenth = (v) => Math.round(v * 10) / 10;

async function enter() {
  const token = location.hash.slice(1);
  if (token) {
    history.replaceState(null, "", location.pathname);
    const answer = await fetch("/claim", {
      method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify({ token }),
    });
    if (answer.ok) sessionStorage.setItem("key", (await answer.json()).key);
  }
  key = sessionStorage.getItem("key");
  const answer = await fetch("/frame", { headers: { Authorization: `Bearer ${key}` } });
  if (!answer.ok) {
    say("This address has been used already. Run the command again for a new one.");
    return;
  }
  frame.src = URL.createObjectURL(await answer.blob());
  await frame.decode();
  fit();
  say(`${size().join(" × ")} pixels. Draw the box.`);
  stage.focus();
}

function fit() {
  const [w, h] = size();
  if (!w) return;
  const room = document.querySelector("main").getBoundingClientRect();
  const above = room.top + scrollY, below = $("form").offsetHeight + 40;
  const high = Math.max(200, innerHeight - above - below);
  scale = Math.min((document.body.clientWidth - 32) / w, high / h, 4);
  frame.style.width = `${w * scale}px`;
  frame.style.height = `${h * scale}px`;
  frame.classList.toggle("large", scale >= 2);
  paint();
}

function set(x, y, w, h) {
  const [W, H] = size();
  w = clamp(w, 1, W);
  h = clamp(h, 1, H);
  box = [clamp(x, 0, W - w), clamp(y, 0, H - h), w, h].map(tenth);
  if (box[0] + box[2] > W) box[0] = W - box[2];
  if (box[1] + box[3] > H) box[1] = H - box[3];
  fields.forEach((field, i) => { if (field !== document.activeElement) field.value = box[i]; });
  go.disabled = false;
  paint();
}

function paint() {
  mark.hidden = !box;
  if (!box) return;
  const [x, y, w, h] = box.map((v) => v * scale);
  Object.assign(mark.style, { left: `${x}px`, top: `${y}px`, width: `${w}px`, height: `${h}px` });
}

function point(event) {
  const at = frame.getBoundingClientRect(), [W, H] = size();
  return [clamp((event.clientX - at.left) / scale, 0, W), clamp((event.clientY - at.top) / scale, 0, H)];
}

stage.addEventListener("pointerdown", (event) => {
  if (!size()[0] || !event.isPrimary || event.button > 0) return;
  event.preventDefault();
  stage.focus();
  stage.setPointerCapture(event.pointerId);
  const [x, y] = point(event);
  const inside = box && x > box[0] && y > box[1] && x < box[0] + box[2] && y < box[1] + box[3];
  drag = { x, y, from: inside ? [...box] : null };
});

// The browser may take the end of a quick drag for a fling, and then swallows the tap that comes next.
stage.addEventListener("touchstart", (event) => event.preventDefault(), { passive: false });

stage.addEventListener("pointermove", (event) => {
  if (!drag || !event.isPrimary) return;
  const [x, y] = point(event);
  if (drag.from) set(drag.from[0] + x - drag.x, drag.from[1] + y - drag.y, drag.from[2], drag.from[3]);
  else if (Math.abs(x - drag.x) >= 1 && Math.abs(y - drag.y) >= 1) {
    set(Math.min(x, drag.x), Math.min(y, drag.y), Math.abs(x - drag.x), Math.abs(y - drag.y));
  }
});

for (const end of ["pointerup", "pointercancel"]) stage.addEventListener(end, () => { drag = null; });

const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
stage.addEventListener("keydown", (event) => {
  const [W, H] = size();
  if (event.key === "Enter" && box) $("form").requestSubmit();
  const arrow = ARROWS[event.key];
  if (!arrow || !W) return;
  event.preventDefault();
  const by = event.ctrlKey || event.metaKey ? 10 : 1, [dx, dy] = arrow.map((v) => v * by);
  const [x, y, w, h] = box ?? [W * 0.4, H * 0.4, W * 0.2, H * 0.2];
  if (!box) set(x, y, w, h);
  else if (event.shiftKey) set(x, y, w + dx, h + dy);
  else set(x + dx, y + dy, w, h);
});

for (const field of fields) {
  field.addEventListener("input", () => {
    const values = fields.map((f) => f.valueAsNumber);
    if (values.every(Number.isFinite) && values[2] >= 1 && values[3] >= 1) set(...values);
  });
  field.addEventListener("change", () => { if (box) fields.forEach((f, i) => { f.value = box[i]; }); });
}

$("form").addEventListener("submit", async (event) => {
  event.preventDefault();
  if (!box) return;
  go.disabled = true;
  try {
    const answer = await fetch("/box", {
      method: "POST",
      headers: { "Content-Type": "application/json", Authorization: `Bearer ${key}` },
      body: JSON.stringify({ box }),
    });
    if (!answer.ok) throw new Error(String(answer.status));
    document.body.classList.add("done");
    say("Tracking has started. You can close this page.");
  } catch {
    go.disabled = false;
    say("The command could not be reached, or refused the box.");
  }
});

addEventListener("resize", fit);
enter().catch(() => say("The command has ended. Run it again."));
