"""Cameras and screens: what a person sees of them while a box is drawn, in the mirror, between two fingers."""

from __future__ import annotations

import pytest

from .conftest import Open, loop
from .test_access import PHONE

pytestmark = loop
# Resolves when the camera has shown some more frames, also to the page.
MORE_FRAMES = """async () => {
    const video = document.createElement("video");
    video.srcObject = await navigator.mediaDevices.getUserMedia({video: true});
    await video.play();
    for (let i = 0; i < 8; i++) await new Promise((shown) => video.requestVideoFrameCallback(shown));
    video.srcObject.getTracks()[0].stop();
}"""
FRONT = """const settings = MediaStreamTrack.prototype.getSettings;
MediaStreamTrack.prototype.getSettings = function () { return {...settings.call(this), facingMode: "user"}; };"""


async def test_the_picture_of_a_camera_stands_still_while_a_box_is_drawn(open_page: Open) -> None:
    async with open_page() as user:
        await user.choose("camera")
        await user.until("document.getElementById('picture').width > 100")
        left, top, right, bottom = await user.corners((130, 80, 60, 70))
        await user.page.mouse.move(left, top)
        await user.page.mouse.down()
        await user.page.mouse.move(right, bottom, steps=3)
        still = await user.pixels()
        await user.page.evaluate(MORE_FRAMES)
        assert await user.pixels() == still
        await user.page.mouse.up()
        await user.frames(3)
        assert await user.pixels() != still


async def test_a_front_camera_is_a_mirror_and_its_boxes_are_true(open_page: Open) -> None:
    box = (30.0, 80.0, 60.0, 70.0)
    async with open_page() as user:
        await user.page.add_init_script(FRONT)
        await user.page.reload()
        await user.choose("camera")
        await user.until("document.getElementById('picture').width > 100")
        await user.until("document.getElementById('picture').style.transform === 'scaleX(-1)'")
        await user.page.keyboard.press("Space")
        await user.draw(box)
        await user.until("document.documentElement.dataset.state === 'tracking'")
        width = (await user.picture())["width"]
        first = (await user.boxes())["frames"][0]["targets"][0]["box"]
        assert first == pytest.approx((width - box[0] - box[2], *box[1:]), abs=2)
        # and its line is seen in the mirror, too
        await user.pause()
        x, y, w, h = (await user.boxes())["frames"][-1]["targets"][0]["box"]
        left, top, _, bottom = await user.corners((width - x - w, y, w, h))
        seen = """([x, y]) => {
            const overlay = document.getElementById("overlay"), {left, top} = overlay.getBoundingClientRect();
            return overlay.getContext("2d").getImageData(x - left - 3, y - top, 7, 1).data.some((value) => value > 0);
        }"""
        assert await user.page.evaluate(seen, [left, (top + bottom) / 2])


async def test_a_screen_is_a_source(open_page: Open) -> None:
    async with open_page() as user:
        await user.choose("screen")
        await user.until("document.getElementById('picture').width > 100")
        await user.draw((40, 40, 80, 80))
        await user.frames(3)
        assert (await user.boxes())["about"]["kind"] == "screen"


async def test_two_fingers_zoom_and_draw_no_box(open_page: Open) -> None:
    async with open_page(**PHONE) as user:
        await user.choose("sample")
        width = "document.getElementById('picture').getBoundingClientRect().width"
        before = await user.page.evaluate(width)
        at = await user.picture()
        x, y = at["x"] + at["width"] * at["scale"] / 2, at["y"] + at["height"] * at["scale"] / 2
        hand = await user.page.context.new_cdp_session(user.page)

        async def fingers(kind: str, *apart: float) -> None:
            points = [{"x": x + side * one, "y": y, "id": side} for one in apart for side in (-1, 1)]
            await hand.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

        await fingers("touchStart", 20)
        for apart in (30, 40, 50, 60):
            await fingers("touchMove", apart)
        await fingers("touchEnd")
        await user.until(f"{width} > {2 * before}")
        assert await user.page.evaluate("document.documentElement.dataset.state") == "open"
        await user.page.keyboard.press("0")
        await user.until(f"Math.abs({width} - {before}) < 1")
