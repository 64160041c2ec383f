"""A cut that covers the region gives the very results of the whole frame."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
import pytest

from mfcmt_core import synthetic
from mfcmt_core.images.decode import Image, decode
from service.client import AsyncClient, AsyncSession, Frame, Problem, Region, Result
from service.load.clips import LIMITS, Box, Clip
from service.load.own import OwnServer

from .conftest import watch

# Lossless and quick, so that a cut has the very pixels of its part of the frame.
PNG = [cv2.IMWRITE_PNG_COMPRESSION, 1]


def whole(image: Image) -> bytes:
    return cv2.imencode(".png", image, PNG)[1].tobytes()


def cut(image: Image, region: Region) -> Frame:
    x, y, w, h = region
    return Frame(whole(np.ascontiguousarray(image[y : y + h, x : x + w])), region=region)


def blackened(image: Image, region: Region) -> bytes:
    """The whole frame, with nothing to be seen outside the region."""
    x, y, w, h = region
    dark = np.zeros_like(image)
    dark[y : y + h, x : x + w] = image[y : y + h, x : x + w]
    return whole(dark)


def images_of(clip: Clip) -> list[Image]:
    return [decode(frame, LIMITS)[0] for frame in clip.frames]


async def pair(client: AsyncClient, image: Image, boxes: Sequence[Box]) -> tuple[AsyncSession, AsyncSession]:
    """Two sessions that begin alike."""
    return await client.create(whole(image), boxes=boxes), await client.create(whole(image), boxes=boxes)


def assert_alike(one: Result, other: Result) -> None:
    assert one.targets == other.targets
    assert one.region == other.region
    assert one.size == other.size


async def follow(images: Sequence[Image], by_whole: AsyncSession, by_cut: AsyncSession, lag: int = 0) -> list[Result]:
    """Both sessions through the frames, one of them by cuts; each is made ``lag`` frames before its turn."""
    known = [by_cut.info.region] * (lag + 1)
    results = []
    for image in images:
        expected = await by_whole.track(whole(image))
        region = known.pop(0)
        assert region is not None
        got = await by_cut.track(cut(image, region))
        assert_alike(expected, got)
        known.append(got.region)
        results.append(got)
    return results


def boxes_of(clip: Clip) -> dict[str, list[Box]]:
    """Targets in all kinds of places."""
    x, y, w, h = clip.box
    width, height = clip.size
    return {
        "one": [clip.box],
        "several": [clip.box, (x + w, y + h / 2, w / 2, h), (5, 5, 30, 30)],
        "corners": [(0, 0, 30, 24), (width - 30, height - 24, 30, 24)],
        "half outside": [(-15, height / 2, 30, 24), (width - 15, 10, 30, 24)],
        "as large as the frame": [(4, 4, width - 8, height - 8)],
        "tiny": [(x, y, 6, 6)],
        "a stripe": [(10, y, width - 20, 8)],
    }


@pytest.mark.parametrize(
    "place", ["one", "several", "corners", "half outside", "as large as the frame", "tiny", "a stripe"]
)
async def test_cuts_give_the_results_of_whole_frames_bit_for_bit(
    server: OwnServer, client: AsyncClient, clip: Clip, place: str
) -> None:
    images = images_of(clip)[:25]
    with watch(server):
        sessions = await pair(client, images[0], boxes_of(clip)[place])
        results = await follow(images[1:], *sessions)
        assert len(results) == 24


async def test_a_region_leaves_room_for_one_frame_in_flight(client: AsyncClient, clip: Clip) -> None:
    """The region leaves room for a frame that is not answered yet (``region_lag`` is 1)."""
    images = images_of(clip)
    results = await follow(images[1:], *await pair(client, images[0], [clip.box]), lag=1)
    assert [result.seq for result in results] == list(range(1, len(images)))


async def test_what_is_outside_does_not_matter(client: AsyncClient, clip: Clip) -> None:
    images = images_of(clip)[:25]
    bright, dark = await pair(client, images[0], [clip.box])
    region = dark.info.region
    for image in images[1:]:
        assert region is not None
        expected, got = await bright.track(whole(image)), await dark.track(blackened(image, region))
        assert_alike(expected, got)
        region = got.region


async def test_cuts_and_whole_frames_may_be_mixed(client: AsyncClient, clip: Clip) -> None:
    images = images_of(clip)[:25]
    by_whole, mixed = await pair(client, images[0], [clip.box])
    region = mixed.info.region
    for index, image in enumerate(images[1:]):
        assert region is not None
        got = await mixed.track(cut(image, region) if index % 3 else whole(image))
        assert_alike(await by_whole.track(whole(image)), got)
        region = got.region


async def test_the_region_follows_a_correction_at_once(client: AsyncClient, clip: Clip) -> None:
    """On a cut that shows what the new box needs; the region follows it at once."""
    images = images_of(clip)[:25]
    sessions = await pair(client, images[0], [clip.box])
    results = await follow(images[1:10], *sessions)
    x, y, w, h = results[-1].target.box
    moved = (x + 2, y - 2, w * 0.9, h * 0.9)
    changes = [await session.correct_target(0, moved) for session in sessions]
    assert changes[0] == changes[1]
    sessions[1].info = await sessions[1].refresh()
    await follow(images[10:], *sessions)


async def test_a_box_that_the_newest_cut_does_not_show_needs_the_whole_frame(client: AsyncClient) -> None:
    """``full-frame-needed``; the next region is the whole frame, and then the box is taken."""
    sequence = synthetic.clip("motion", length=12)
    box = tuple(map(float, sequence.boxes[0]))
    session = await client.create(whole(sequence.frames[0]), box)
    width, height = session.info.size
    far: Box = (width - 40.0, height - 40.0, 30.0, 30.0)
    region = session.info.region
    assert region is not None
    if far[0] < region[0] + region[2] and far[1] < region[1] + region[3]:
        far = (5.0, 5.0, 30.0, 30.0)
    before = await session.track(cut(sequence.frames[1], region))
    for change in (session.add_target(far), session.correct_target(0, far)):
        with pytest.raises(Problem) as refused:
            await change
        assert (refused.value.code, refused.value.status) == ("full-frame-needed", 409)
        assert refused.value.region == (0, 0, width, height)
    info = await session.refresh()
    assert info.targets == before.targets
    assert info.region == (0, 0, width, height)
    after = await session.track(whole(sequence.frames[2]))
    assert after.region != (0, 0, width, height)
    assert (await session.add_target(far)).target.box == pytest.approx(far)


async def test_the_region_is_the_whole_frame_while_the_target_is_lost(server: OwnServer, client: AsyncClient) -> None:
    """While a target is lost the region is the whole frame; afterwards it is a part again."""
    sequence = synthetic.clip("motion", length=60)
    box: Any = tuple(map(float, sequence.boxes[0]))
    seen = list(sequence.frames[:20])
    noise = np.random.default_rng(0).integers(0, 255, (60, *seen[0].shape)).astype(np.float32)
    share = np.clip(1 - np.arange(60) / 25, 0, 1)
    fading = [(a * seen[-1] + (1 - a) * one).astype(np.uint8) for a, one in zip(share, noise, strict=True)]
    with watch(server):
        sessions = await pair(client, seen[0], [box])
        results = await follow([*seen[1:], *fading, *[seen[-1]] * 20], *sessions)
    lost = [index for index, result in enumerate(results) if result.target.status == "lost"]
    assert lost
    assert all(results[index].region == (0, 0, 320, 240) for index in lost)
    back = [result for result in results[lost[-1] + 1 :] if result.target.status == "tracking"]
    assert back
    assert any(result.region != (0, 0, 320, 240) for result in back)
