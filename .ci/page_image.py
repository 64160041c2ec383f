"""Takes docs/images/page.png, the page with two targets, from a running service; give its address."""

import sys
from pathlib import Path

from PIL import Image
from playwright.sync_api import sync_playwright

IMAGE = Path(__file__).resolve().parents[1] / "docs" / "images" / "page.png"
FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-background-networking"]
SIZE = {"width": 1280, "height": 800}
GREEN = (519, 106, 41, 56)  # the small balloon at the clip's beginning, pixels of its 640×480
FRAMES = 205


def main() -> None:
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path="/usr/bin/chromium", args=FLAGS)
        page = browser.new_page(viewport=SIZE, color_scheme="dark")
        page.goto(sys.argv[1])
        page.click("#choose-sample")
        page.click("#follow-suggestion")
        page.wait_for_selector("#targets li")
        page.keyboard.press("Space")
        page.wait_for_function("document.getElementById('connection-text').innerText === 'Paused'")
        page.keyboard.press("a")
        before, stage = None, page.locator("#picture").bounding_box()
        while stage != before:  # it moves while panels come
            page.wait_for_timeout(500)
            before, stage = stage, page.locator("#picture").bounding_box()
        assert stage
        scale = min(stage["width"] / 640, stage["height"] / 480)
        left, top = stage["x"] + (stage["width"] - 640 * scale) / 2, stage["y"]
        x, y, w, h = (scale * value for value in GREEN)
        page.mouse.move(left + x, top + y)
        page.mouse.down()
        page.mouse.move(left + x + w, top + y + h, steps=4)
        page.mouse.up()
        page.wait_for_selector("#targets li + li")
        page.keyboard.press("Space")
        page.keyboard.press("1")
        while page.evaluate("Number(document.getElementById('stage').dataset.frames)") < FRAMES:
            page.wait_for_timeout(50)
        page.evaluate("document.activeElement.blur()")
        page.screenshot(path=IMAGE)
        browser.close()
    with Image.open(IMAGE) as shot:
        few = shot.convert("RGB").quantize(256, Image.Quantize.MEDIANCUT, kmeans=4)
    few.save(IMAGE, optimize=True)
    sys.stdout.write(f"{IMAGE.stat().st_size / 1e3:.0f} kB\n")


if __name__ == "__main__":
    main()
