"""The feature stack: cues as planes of one grid, and the colour-name table."""

from __future__ import annotations

import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from mfcmt_core import MFCMT, BadConfig, MFCMTConfig
from mfcmt_core.config import CUES
from mfcmt_core.features import FeatureStack, hann_window
from mfcmt_core.features.color_names import LEVELS, NAMES, memberships, table

from ..conftest import OTB_ROOT, require

CONFIG = MFCMTConfig.default()


def patch(side=100, seed=0):
    return np.random.default_rng(seed).integers(0, 256, (side, side, 3), np.uint8)


def extract(stack, pixels):
    """Return a copy of the features of ``pixels``, (H, W) or (H, W, 3)."""
    gray = pixels if pixels.ndim == 2 else cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY)
    return stack.extract(pixels, gray).copy()


# --- the stack ---


def test_hann_window_has_no_border_of_zeros():
    window = hann_window(25)
    assert window.min() > 0
    assert window.max() == window[12, 12] == 1
    np.testing.assert_allclose(window, window.T)
    np.testing.assert_allclose(window, window[::-1])


def test_cues_are_blocks_in_order():
    stack = FeatureStack(CONFIG.replace(features=("fhog", "gray", "color_names")), is_gray=False)
    widths = {cue: block.stop - block.start for cue, block in stack.blocks.items()}
    assert list(widths.items()) == [("fhog", 31), ("gray", 1), ("color_names", 10)]
    assert stack.channels == 42
    everything = extract(stack, patch())
    for cue, block in stack.blocks.items():
        if cue != "color_names":  # alone it would leave a grey target nothing
            alone = FeatureStack(CONFIG.replace(features=(cue,)), is_gray=False)
            assert np.array_equal(extract(alone, patch()), everything[:, block])


def test_a_gray_target_has_no_color_names():
    stack = FeatureStack(CONFIG, is_gray=True)
    assert set(stack.blocks) == set(CUES) - {"color_names"}
    gray = patch()[..., 0].copy()
    three = np.repeat(gray[..., None], 3, axis=2)
    assert np.array_equal(extract(stack, gray), extract(stack, three))


@pytest.mark.parametrize("side", [32, 99, 100, 101, 102, 103, 148, 150])
def test_any_patch_size_gives_whole_cells(side):
    """Pixels beyond whole cells are left out on both sides."""
    stack = FeatureStack(CONFIG.replace(patch_size=side), is_gray=False)
    features = extract(stack, patch(side))
    cells, rest = divmod(side, 4)
    assert features.shape == (cells, 42, cells)
    assert np.isfinite(features).all()
    inner = np.ascontiguousarray(patch(side)[rest // 2 :, rest // 2 :][: 4 * cells, : 4 * cells])
    whole = FeatureStack(CONFIG.replace(patch_size=4 * cells), is_gray=False)
    assert np.array_equal(features, extract(whole, inner))


def test_the_memory_layout_of_the_patch_does_not_matter():
    stack = FeatureStack(CONFIG, is_gray=False)
    expected = extract(stack, patch())
    fortran = np.asfortranarray(patch())
    assert np.array_equal(extract(stack, np.ascontiguousarray(fortran)), expected)


# --- colour names ---

COLORS = {
    "red": (200, 20, 20),
    "orange": (240, 130, 20),
    "brown": (100, 55, 20),
    "yellow": (240, 230, 30),
    "green": (30, 150, 40),
    "blue": (30, 50, 200),
    "purple": (120, 30, 140),
    "pink": (250, 130, 190),
    "black": (5, 5, 5),
    "grey": (128, 128, 128),
    "white": (252, 252, 252),
}


@pytest.mark.parametrize("name", NAMES)
def test_colors_get_their_names(name):
    weights = memberships([COLORS[name]])[0]
    assert NAMES[weights.argmax()] == name
    assert weights.max() > 0.5


def test_memberships_are_positive_and_sum_to_one():
    rgb = np.random.default_rng(0).integers(0, 256, (5000, 3))
    weights = memberships(rgb)
    assert weights.shape == (5000, 11)
    assert weights.min() >= 0
    np.testing.assert_allclose(weights.sum(1), 1, atol=1e-9)


def test_table_carries_the_memberships():
    """It has ten numbers per color with mean zero and unchanged distances, in the published order of bins."""
    names = table()
    assert names.shape == (LEVELS**3, 10)
    assert names.dtype == np.float32
    assert not names.flags.writeable
    np.testing.assert_allclose(names.mean(0, np.float64), 0, atol=1e-7)
    rng = np.random.default_rng(1)
    levels = rng.integers(0, 32, (2, 300, 3))
    bins = levels @ (1, 32, 1024)
    full = [memberships(rgb * 8 + 4) for rgb in levels]
    expected = np.linalg.norm(full[0] - full[1], axis=1)
    np.testing.assert_allclose(np.linalg.norm(names[bins[0]] - names[bins[1]], axis=1), expected, atol=1e-5)


def test_table_agrees_with_the_published_one():
    """A linear map of our table explains the variance of the published one, and the other way round."""
    file = OTB_ROOT.parent / "color_names" / "w2crs.npy"
    require(file.is_file(), f"no published colour-name table at {file}")
    ours, published = table().astype(float), table(str(file)).astype(float)
    for source, goal in ((ours, published), (published, ours)):
        design = np.column_stack([source, np.ones(len(source))])
        solution, *_ = np.linalg.lstsq(design, goal, rcond=None)
        left = ((goal - design @ solution) ** 2).sum() / ((goal - goal.mean(0)) ** 2).sum()
        assert 1 - left > 0.6


def test_a_table_file_is_used_instead(tmp_path, frames, clip):
    file = tmp_path / "names.npy"
    np.save(file, table() @ np.linalg.qr(np.random.default_rng(0).standard_normal((10, 10)))[0])
    config = CONFIG.replace(color_name_table=str(file))
    rotated = [r.box for r in MFCMT(config).track(frames[:8], clip.boxes[0])]
    # a rotation of channels changes no response of a joint filter
    assert np.array(rotated) == pytest.approx(
        np.array([r.box for r in MFCMT(CONFIG).track(frames[:8], clip.boxes[0])]), abs=1e-2
    )
    np.save(tmp_path / "three.npy", np.random.default_rng(0).random((32768, 3)))
    narrow = FeatureStack(CONFIG.replace(color_name_table=str(tmp_path / "three.npy")), is_gray=False)
    assert narrow.channels == 35
    np.testing.assert_allclose(narrow.names.mean(0, np.float64), 0, atol=1e-7)


@pytest.mark.parametrize(
    "content",
    [
        None,
        b"",
        b"not a table",
        np.zeros((32768, 0)),
        np.zeros((32768, 17)),
        np.zeros((100, 10)),
        np.zeros(32768),
        np.full((32768, 2), np.nan),
        np.full((32768, 2), 1e300),
        np.zeros((32768, 2), complex),
        np.zeros((32768, 2), "U2"),
        np.zeros((32768, 2), [("a", float)]),
        np.full((32768, 2), None),
        {"a": np.zeros((32768, 3))},
    ],
    ids=str,
)
def test_a_table_that_cannot_be_used_is_refused(tmp_path, content):
    file = tmp_path / "names.npy"
    if isinstance(content, bytes):
        file.write_bytes(content)
    elif isinstance(content, dict):
        with file.open("wb") as stream:
            np.savez(stream, **content)
    elif content is not None:
        np.save(file, content, allow_pickle=True)
    with pytest.raises(BadConfig, match="color_name_table"):
        table(str(file))


def test_a_truncated_table_and_a_pipe_are_refused(tmp_path):
    np.save(tmp_path / "whole.npy", np.zeros((32768, 3)))
    data = (tmp_path / "whole.npy").read_bytes()
    (tmp_path / "half.npy").write_bytes(data[: len(data) // 2])
    os.mkfifo(tmp_path / "pipe.npy")
    for name in ("half.npy", "pipe.npy"):
        with pytest.raises(BadConfig):
            table(str(tmp_path / name))
    with pytest.raises(BadConfig):
        table(str(Path(tmp_path)))


def test_a_refused_table_leaves_a_running_tracker_alone(tmp_path, frames, clip):
    with pytest.raises(BadConfig):
        MFCMT(CONFIG.replace(color_name_table=str(tmp_path / "none.npy"))).init(frames[0], clip.boxes[0])
