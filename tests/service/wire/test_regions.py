"""Only the part that is needed: the same results, bit for bit, for a fraction of the bytes."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from mfcmt_core.images.decode import decode
from service.load.clips import LIMITS, Clip
from tests.conftest import require

from .conftest import Stream, Wire

Image = npt.NDArray[np.uint8]
SAME = ("seq", "size", "region", "targets")


def png(image: Image) -> bytes:
    """Without coding noise, so that results can be compared bit for bit."""
    return bytes(cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1])


def cut(image: Image, region: list[int]) -> bytes:
    x, y, w, h = region
    return png(image[y : y + h, x : x + w])


@pytest.fixture(scope="module")
def images(clip: Clip) -> list[Image]:
    return [decode(frame, LIMITS)[0] for frame in clip.frames]


class Twins:
    """One session gets whole frames, the other what its last answer asked for."""

    def __init__(self, whole: Stream, cuts: Stream, region: list[int] | None, size: list[int]) -> None:
        self.whole, self.cuts, self.region = whole, cuts, region
        self.frame = [0, 0, *size]
        self.saved: list[float] = []

    async def track(self, image: Image) -> dict[str, Any]:
        region = self.region or self.frame
        await self.whole.frame(png(image))
        await self.cuts.frame(cut(image, region), region=region)
        one, two = await self.whole.hear("result"), await self.cuts.hear("result")
        assert [one[name] for name in SAME] == [two[name] for name in SAME]
        self.region = two["region"]
        self.saved.append(region[2] * region[3] / (self.frame[2] * self.frame[3]))
        return two

    async def control(self, **control: Any) -> None:
        for stream in (self.whole, self.cuts):
            await stream.say(**control)
        one, two = await self.whole.hear("targets"), await self.cuts.hear("targets")
        assert one == two
        self.region = two["region"]


async def both(wire: Wire, images: list[Image], *boxes: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    return await wire.create(png(images[0]), *boxes), await wire.create(png(images[0]), *boxes)


@pytest.mark.parametrize("several", [False, True])
async def test_cuts_give_what_whole_frames_give(wire: Wire, clip: Clip, images: list[Image], several: bool) -> None:
    x, y, w, h = clip.box
    boxes = [clip.box, (x, y + h / 2, w / 3, h / 3), (1, 1, w / 2, h / 2)] if several else [clip.box]
    one, two = await both(wire, images, *boxes)
    async with (
        wire.stream(one["id"], mode="lossless") as whole,
        wire.stream(two["id"], mode="lossless", protocols=["mfcmt.v1.msgpack"]) as cuts,
    ):
        twins = Twins(whole, cuts, two["region"], list(clip.size))
        for image in images[1:15]:
            await twins.track(image)
        twins.region = None  # a correction may look further than the cut did
        await twins.track(images[15])
        await twins.control(type="correct", target=0, box=[x + 3, y - 2, w, h])
        for image in images[16:25]:
            await twins.track(image)
        if several:
            await twins.control(type="remove", target=2)
            for image in images[25:30]:
                await twins.track(image)
        else:
            assert np.mean(twins.saved) < 1


async def test_cuts_at_the_border_give_what_whole_frames_give(wire: Wire, clip: Clip, images: list[Image]) -> None:
    width, height = clip.size
    boxes = [(-10, -10, 40, 40), (width - 25, height - 30, 40, 40)]
    one, two = await both(wire, images, *boxes)
    async with (
        wire.stream(one["id"], mode="lossless") as whole,
        wire.stream(two["id"], mode="lossless") as cuts,
    ):
        twins = Twins(whole, cuts, two["region"], list(clip.size))
        for image in images[1:10]:
            await twins.track(image)


async def test_cuts_give_the_same_while_the_target_is_lost_and_back(
    wire: Wire, clip: Clip, images: list[Image]
) -> None:
    require(clip.name == "David", "the rendered clip does not lose its target")
    noise = np.random.default_rng(1).integers(0, 255, images[0].shape, dtype=np.uint8)
    one, two = await both(wire, images, clip.box)
    async with (
        wire.stream(one["id"], mode="lossless") as whole,
        wire.stream(two["id"], mode="lossless") as cuts,
    ):
        twins = Twins(whole, cuts, two["region"], list(clip.size))
        for image in images[1:25]:
            result = await twins.track(image)
        for n in range(1, 80):
            fading = cv2.addWeighted(images[25], 0.9**n, noise, 1 - 0.9**n, 0)
            result = await twins.track(fading)
            if result["targets"][0]["status"] == "lost":
                break
        assert result["targets"][0]["status"] == "lost"
        assert result["region"] == twins.frame
        assert result["targets"][0]["box"]
        for image in images[25:]:
            result = await twins.track(image)
            if result["targets"][0]["status"] == "tracking":
                break
        assert result["targets"][0]["status"] == "tracking"
        assert result["region"] != twins.frame


async def test_a_region_that_does_not_fit_is_refused_and_says_what_does(
    wire: Wire, clip: Clip, images: list[Image]
) -> None:
    session = await wire.create(png(images[0]), clip.box)
    width = clip.size[0]
    x, y, w, h = session["region"]
    async with wire.stream(session["id"], mode="lossless") as stream:
        wrong: list[tuple[list[int], bytes]] = [
            ([x, y, w, h], cut(images[1], [x, y, w - 1, h])),
            ([width - 10, 0, 20, 20], png(images[1][:20, :20])),
            ([0, 0, 16, 16], png(images[1][:16, :16])),
        ]
        for region, data in wrong:
            await stream.frame(data, region=region)
            refusal = (await stream.hear("error"))["problem"]
            assert (refusal["code"], refusal["status"]) == ("bad-region", 422)
        nx, ny, nw, nh = refusal["region"]
        assert x <= nx
        assert y <= ny
        assert nw <= w
        assert nh <= h
        await stream.frame(cut(images[1], refusal["region"]), region=refusal["region"])
        await stream.hear("result")


async def test_a_box_outside_the_cut_needs_the_whole_frame(wire: Wire, clip: Clip, images: list[Image]) -> None:
    session = await wire.create(png(images[0]), (4, 4, 20, 20))
    width, height = clip.size
    corner = [width - 30, height - 30, 24, 24]
    async with wire.stream(session["id"], mode="lossless") as stream:
        region = session["region"]
        assert region[0] + region[2] < corner[0]
        await stream.frame(cut(images[1], region), region=region)
        region = (await stream.hear("result"))["region"]
        await stream.say(type="add", box=corner, ref="a")
        refused = await stream.hear("error")
        assert (refused["ref"], refused["problem"]["code"]) == ("a", "full-frame-needed")
        await stream.frame(cut(images[2], region), region=region)
        assert (await stream.hear("result"))["region"] == [0, 0, width, height]
        await stream.frame(png(images[3]))
        after = (await stream.hear("result"))["region"]
        assert after != [0, 0, width, height]
        await stream.say(type="add", box=corner)
        added = await stream.hear("targets")
        assert [t["id"] for t in added["targets"]] == [0, 1]
        over_http = await wire.track(session["id"], png(images[3]), region=",".join(map(str, after)))
        assert over_http.json()["code"] == "attached-elsewhere"
