"""Prints how long the page takes for a film, and the Node client for the same frames: `python -m tests.browser.cost`.

Both follow the film's square through every frame, on the same server, in turns; each takes its best of some runs. The
page reads the file by itself, Node gets JPEG images from ffmpeg, whose time counts, too.
"""

from __future__ import annotations

import asyncio
import sys
import tempfile
import time
from pathlib import Path

from service.load.own import OwnServer

from .conftest import launched
from .driver import Tracker
from .films import BOX, even, film

FRAMES = 300
RUNS = 3
SCRIPT = Path(__file__).with_name("cost.mjs")
CLIENT = Path(__file__).parents[2] / "service/web/client/mfcmt.js"
RATIO = 1.5


async def by_page(url: str, path: Path) -> float:
    """Seconds from the box to the last result."""
    async with launched([]) as browser:
        page = await browser.new_page(viewport={"width": 1280, "height": 800})
        user = Tracker(page, url)
        await page.goto(url)
        await user.open_file(path)
        began = time.perf_counter()
        await user.draw(BOX)
        await user.until(f"Number(document.getElementById('stage').dataset.frames) === {FRAMES}", 300)
        return time.perf_counter() - began


async def by_node(url: str, path: Path) -> float:
    """Seconds from the first image to the last result."""
    arguments = ["node", str(SCRIPT), str(CLIENT), url, str(path), str(FRAMES), ",".join(map(str, BOX))]
    process = await asyncio.create_subprocess_exec(*arguments, stdout=asyncio.subprocess.PIPE)
    said, _ = await process.communicate()
    if process.returncode:
        raise SystemExit("the Node client failed")
    return float(said)


async def main() -> None:
    """Print a line for each and their ratio."""
    with tempfile.TemporaryDirectory() as folder, OwnServer(lanes=1) as server:
        path = Path(folder) / "film.mp4"
        film(path, even(FRAMES, 30))
        took = [(await by_page(server.url, path), await by_node(server.url, path)) for _ in range(RUNS)]
    page, node = (min(times) for times in zip(*took, strict=True))
    rates = f"page {page:.2f} s ({FRAMES / page:.0f}/s), Node client {node:.2f} s ({FRAMES / node:.0f}/s)"
    sys.stdout.write(f"{FRAMES} frames: {rates}; ratio {page / node:.2f}, wanted {RATIO} at most\n")


if __name__ == "__main__":
    asyncio.run(main())
