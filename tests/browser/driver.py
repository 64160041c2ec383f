"""Somebody who uses the page, and what they see."""

from __future__ import annotations

import asyncio
import base64
import json
import time
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

Box = tuple[float, float, float, float]
PATIENCE_MS = 30_000


class Tracker:
    """One page. ``expected`` are texts that the console may say, because the test provokes them."""

    def __init__(self, page: Any, url: str) -> None:
        self.page, self.url = page, url
        self.said: list[str] = []
        self.asked: list[str] = []
        self.expected: list[str] = []
        page.set_default_timeout(PATIENCE_MS)
        page.on("console", lambda message: message.type in ("error", "warning") and self.said.append(message.text))
        page.on("pageerror", lambda error: self.said.append(f"uncaught {error}"))
        page.on("request", lambda request: self.asked.append(request.url))

    def check(self) -> None:
        """A clean console, and nobody else was asked anything."""
        said = [text for text in self.said if not any(part in text for part in self.expected)]
        assert not said, said
        here = urlsplit(self.url).netloc
        asked = [urlsplit(url) for url in self.asked]
        others = [one.geturl() for one in asked if one.scheme not in ("blob", "data") and one.netloc != here]
        assert not others, others

    async def leave(self) -> None:
        """Away from the page, as if its tab were closed."""
        await self.page.goto("about:blank")
        self.asked = [url for url in self.asked if url != "about:blank"]

    async def choose(self, source: str) -> None:
        """Open ``sample`` or ``camera``."""
        await self.page.click(f"#choose-{source}")
        await self.until("document.documentElement.dataset.state === 'open'")

    async def follow_sample(self, frames: int) -> None:
        """Follow what is suggested in the sample video, for that many frames."""
        await self.choose("sample")
        await self.page.click("#follow-suggestion")
        await self.frames(frames)

    async def until(self, condition: str, patience_s: float = PATIENCE_MS / 1e3) -> None:
        """Wait until a JavaScript expression is true."""
        give_up = time.monotonic() + patience_s
        while not await self.page.evaluate(condition):
            assert time.monotonic() < give_up, f"never: {condition}; {await self.notice()!r} {self.said}"
            await asyncio.sleep(0.05)

    async def frames(self, more: int = 0) -> int:
        """Results so far, once there are ``more`` than now."""
        count = "Number(document.getElementById('stage').dataset.frames)"
        wanted = int(await self.page.evaluate(count)) + more
        await self.until(f"{count} >= {wanted}")
        return int(await self.page.evaluate(count))

    async def picture(self) -> dict[str, float]:
        """Where the picture lies in the window, CSS px, and its own size (``width``, ``height``), once it lies still.

        It moves while panels come and go, and a mouse that was sent to its old place would miss.
        """
        code = """() => {
            const canvas = document.getElementById('picture'), b = canvas.getBoundingClientRect();
            const s = Math.min(b.width / canvas.width, b.height / canvas.height);
            return {x: b.x + (b.width - canvas.width * s) / 2, y: b.y + (b.height - canvas.height * s) / 2,
                    scale: s, width: canvas.width, height: canvas.height};
        }"""
        before: dict[str, float] = {}
        while (found := await self.page.evaluate(code)) != before:
            before = found
            await asyncio.sleep(0.3)  # it follows the panels a few turns later
        return before

    async def pixels(self) -> bytes:
        """The picture that is shown, without box and trail, as PNG."""
        code = "document.getElementById('picture').toDataURL('image/png').split(',')[1]"
        return base64.b64decode(await self.page.evaluate(code))

    async def corners(self, box: Box) -> tuple[float, float, float, float]:
        """Two corners of ``box`` (pixels of the picture) in the window."""
        at = await self.picture()
        x, y, w, h = box
        left, top = at["x"] + x * at["scale"], at["y"] + y * at["scale"]
        return left, top, left + w * at["scale"], top + h * at["scale"]

    async def draw(self, box: Box) -> None:
        """Drag a box with the mouse; pixels of the picture."""
        left, top, right, bottom = await self.corners(box)
        await self.page.mouse.move(left, top)
        await self.page.mouse.down()
        await self.page.mouse.move((left + right) / 2, (top + bottom) / 2, steps=3)
        await self.page.mouse.move(right, bottom, steps=3)
        await self.page.mouse.up()

    async def drag(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        """Drag the mouse from one point of the picture to another, in its pixels."""
        at = await self.picture()
        (x, y), (to_x, to_y) = ((at["x"] + px * at["scale"], at["y"] + py * at["scale"]) for px, py in (start, end))
        await self.page.mouse.move(x, y)
        await self.page.mouse.down()
        await self.page.mouse.move((x + to_x) / 2, (y + to_y) / 2, steps=3)
        await self.page.mouse.move(to_x, to_y, steps=3)
        await self.page.mouse.up()

    async def open_file(self, *paths: Path) -> None:
        """Open files of this machine."""
        await self.page.set_input_files("#file", list(paths))
        await self.until("document.documentElement.dataset.state === 'open'")

    async def end(self, patience_s: float = PATIENCE_MS / 1e3) -> None:
        """Wait until the whole video was sent and answered."""
        await self.until("document.getElementById('hint').innerText.includes('End of the video')", patience_s)
        await self._answered()

    async def pause(self) -> None:
        """Pause, and wait for the answers that are due."""
        if await self.page.get_attribute("#play", "aria-label") == "Pause":
            await self.page.click("#play")
        await self.until("document.getElementById('connection-text').innerText !== 'Tracking'")
        await self._answered()

    async def _answered(self) -> None:
        """Wait for the answers that are due."""
        count = -1
        while (now := await self.frames()) != count:
            count = now
            await asyncio.sleep(0.3)

    async def go_to(self, frame: int) -> None:
        """Move a file to one of its frames, from 0."""
        await self.page.locator("#seek").fill(str(frame))
        await self.until(
            f"document.getElementById('seek').getAttribute('aria-valuetext').includes('frame {frame + 1} ')"
        )

    async def status(self, target: int = 1) -> str | None:
        """Of a target in the list; None where it is not there."""
        row = self.page.locator(f"#targets li[data-target='{target}']")
        return await row.get_attribute("data-status") if await row.count() else None

    async def boxes(self) -> dict[str, Any]:
        """All boxes so far, as the page exports them."""
        return json.loads((await self.export("json")).read_text())

    async def export(self, kind: str) -> Path:
        """Use the export menu; the file that was saved."""
        await self.page.click("#open-export")
        async with self.page.expect_download() as saved:
            await self.page.click(f"#export [data-format={kind}]")
        return Path(await (await saved.value).path())

    async def set(self, name: str, value: str | bool) -> None:
        """Change a setting."""
        await self.page.click("#open-settings")
        field = self.page.locator(f"#settings [name={name}]")
        if isinstance(value, bool):
            await field.set_checked(value)
        elif name == "mode":
            await self.page.locator(f"#settings [name=mode][value={value}]").check()
        else:
            await field.select_option(value)
        await self.page.keyboard.press("Escape")

    async def notice(self) -> str:
        """What the page complains about; empty where it does not."""
        if not await self.page.is_visible("#notice"):
            return ""
        return " ".join((await self.page.inner_text("#notice")).split())

    async def log(self) -> str:
        """The log, newest first."""
        return " | ".join((await self.page.inner_text("#log")).split("\n"))
