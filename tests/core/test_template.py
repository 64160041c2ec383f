"""Equations 1–3 and 11 of the template models against regressions solved densely."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy import fft

from mfcmt_core import MFCMT, MFCMTConfig, synthetic
from mfcmt_core.geometry import Frame, SearchWindow
from mfcmt_core.search import detect
from mfcmt_core.template import TemplateModel

from .helpers import filters_of

CONFIG = MFCMTConfig.default().replace(patch_size=32, regularization=0.01, background_interval=0)
"""Cells of 8×8: small enough to write every shift of the samples down."""
N = 8
RIDGE = ("template", "gray", "fhog", "color_names")


def model(**changes) -> TemplateModel:
    config = CONFIG.replace(**changes)
    window = SearchWindow(config, (60.0, 40.0))
    window.reach = (N // 2 - 1, N // 2 - 1)
    return TemplateModel(config, window, is_gray=False)


def spectra_of(features):
    return fft.rfft2(features.astype(np.float32))


def noise(seed, channels):
    return np.random.default_rng(seed).standard_normal((channels, N, N))


def label_of(m: TemplateModel):
    """Return the label in space, with its peak of 1 at zero displacement, which comes first."""
    label = np.fft.irfft2(m.label_f, s=(N, N))
    assert label[0, 0] == pytest.approx(label.max()) == pytest.approx(1)
    return label


def correlation_matrix(features):
    """A with A · w the circular cross-correlation of equation 1: a row for each displacement, (N², L·N²).

    (w ⋆ x)[d] = Σ_c w[c] x[c + d], summed over channels.
    """
    rows = [np.roll(features, (-dy, -dx), (1, 2)).ravel() for dy in range(N) for dx in range(N)]
    return np.stack(rows)


def filter_in_space(m: TemplateModel, block):
    return np.fft.irfft2(filters_of(m)[slice(*block)], s=(N, N)).ravel()


def respond(m: TemplateModel, spectra):
    """Return the whole response, with zero displacement in the middle."""
    out = np.empty((len(m.names), N - 1, N - 1), np.float32)
    m.respond(spectra, out)
    return out


@pytest.mark.parametrize("average", ["filter", "spectra"])
@pytest.mark.parametrize("features", [("gray",), ("gray", "color_names")])
def test_equation_2_solves_the_regression_of_equation_1(average, features):
    """Solve min ‖A w - y‖² + λ ‖w‖² over all channels, with λ scaled for unnormalized transforms."""
    m = model(features=features, average=average)
    x = noise(0, m.features.channels)
    m.learn(spectra_of(x))
    a, y = correlation_matrix(x), label_of(m).ravel()
    penalty = CONFIG.regularization * N * N
    w = np.linalg.solve(a.T @ a + penalty * np.eye(a.shape[1]), a.T @ y)
    np.testing.assert_allclose(filter_in_space(m, (0, m.features.channels)), w, atol=1e-5)

    # nothing does better
    def loss(v):
        return ((a @ v - y) ** 2).sum() + penalty * (v**2).sum()

    rng = np.random.default_rng(1)
    assert all(loss(w) <= loss(w + 1e-2 * rng.standard_normal(w.shape)) for _ in range(20))


def test_equation_3_is_the_dense_correlation():
    m = model()
    m.learn(spectra_of(noise(0, m.features.channels)))
    z = noise(1, m.features.channels)
    expected = (correlation_matrix(z) @ filter_in_space(m, (0, m.features.channels))).reshape(N, N)
    out = respond(m, spectra_of(z))
    np.testing.assert_allclose(out[0], np.roll(expected, (3, 3), (0, 1))[:7, :7], atol=1e-5)


@pytest.mark.parametrize("shift", [(0, 0), (2, -1), (-3, 3)])
def test_equation_3_needs_the_conjugate_that_the_paper_omits(shift):
    m = model()
    x = noise(2, m.features.channels)
    m.learn(spectra_of(x))
    z = spectra_of(np.roll(x, shift, (1, 2)))
    out = respond(m, z)
    assert np.unravel_index(out[0].argmax(), (7, 7)) == (3 + shift[0], 3 + shift[1])
    assert out.max() > 0.9
    as_printed = np.fft.irfft2((filters_of(m) * z).sum(0), s=(N, N))
    assert as_printed.max() < 0.5


def test_separate_filters_are_independent_regressions():
    """Each of the three models regresses on its own channels and has its own response."""
    m = model(joint_filter=False)
    assert m.names == ("gray", "fhog", "color_names")
    x, z = noise(3, m.features.channels), noise(4, m.features.channels)
    m.learn(spectra_of(x))
    out = respond(m, spectra_of(z))
    for k, (name, block) in enumerate(m.features.blocks.items()):
        alone = model(features=(name,) if name != "color_names" else ("gray", name), joint_filter=False)
        channels = x[block] if name != "color_names" else np.concatenate([x[:1], x[block]])
        alone.learn(spectra_of(channels))
        np.testing.assert_allclose(filters_of(m)[block], filters_of(alone)[-x[block].shape[0] :], atol=1e-5)
        response_f = (np.conj(filters_of(m)[block]) * spectra_of(z)[block]).sum(0)
        np.testing.assert_allclose(
            out[k], np.roll(np.fft.irfft2(response_f, s=(N, N)), (3, 3), (0, 1))[:7, :7], atol=1e-5
        )


def test_equation_11_averages_filters():
    m = model(average="filter", template_learning_rate=0.1)
    one, two = spectra_of(noise(5, 42)), spectra_of(noise(6, 42))
    m.learn(two)
    second = filters_of(m)
    m.learn(one)  # the first frame has a rate of 1: nothing of what was is left
    first = filters_of(m)
    m.learn(two, learned=0)
    np.testing.assert_allclose(filters_of(m), 0.9 * first + 0.1 * second, atol=1e-6)


def test_equation_11_on_spectra_minimizes_the_weighted_sum_of_all_losses():
    """With one channel this is exact: frames have the weights (1-η)², (1-η)η and η."""
    m = model(features=("gray",), average="spectra", template_learning_rate=0.2)
    samples = [noise(seed, 1) for seed in (7, 8, 9)]
    for i, x in enumerate(samples):
        m.learn(spectra_of(x), learned=i - 1 if i else None)
    y, penalty = label_of(m).ravel(), CONFIG.regularization * N * N
    normal, right = penalty * np.eye(N * N), np.zeros(N * N)
    for weight, x in zip((0.64, 0.16, 0.2), samples, strict=True):
        a = correlation_matrix(x)
        normal += weight * a.T @ a
        right += weight * a.T @ y
    np.testing.assert_allclose(filter_in_space(m, (0, 1)), np.linalg.solve(normal, right), atol=1e-5)


@pytest.mark.parametrize(("target", "window"), [((60, 40), "context"), ((30, 90), "target"), ((50, 50), "square")])
def test_label_is_a_gaussian_of_the_target_s_size(target, window):
    """Its standard deviation is 1/16 of √(wh) in cells, and its peak is 1 at zero displacement."""
    config = MFCMTConfig.default().replace(window=window)
    search = SearchWindow(config, target)
    m = TemplateModel(config, search, is_gray=False)
    label = np.fft.irfft2(m.label_f, s=(search.cells, search.cells))
    assert label[0, 0] == pytest.approx(label.max(), abs=1e-6)
    assert label[0, 0] == pytest.approx(1, abs=1e-5)
    sigma = np.sqrt(search.target[0] * search.target[1]) / 16
    for dy, dx in ((0, 1), (1, 0), (-1, 1), (2, -2)):
        assert label[dy, dx] == pytest.approx(np.exp(-(dx**2 + dy**2) / (2 * sigma**2)), abs=1e-4)


@pytest.fixture(scope="module")
def pixels_at():
    """Return a function of (dx, dy): the patch of 100×100 with the target that many pixels from its middle."""
    image = synthetic.clip("motion").frames[0]

    def cut(dx, dy):
        return np.ascontiguousarray(image[60 - dy : 160 - dy, 100 - dx : 200 - dx])

    return cut


def spectra_at(m, patch):
    return m.spectra(patch, cv2.cvtColor(patch, cv2.COLOR_BGR2GRAY))


def displacement(m, reach, patch):
    """Return where the response to ``patch`` peaks, (x, y) in cells."""
    out = np.empty((len(m.names), 2 * reach[1] + 1, 2 * reach[0] + 1), np.float32)
    m.respond(spectra_at(m, patch), out)
    row, column = np.unravel_index(out[0].argmax(), out[0].shape)
    return column - reach[0], row - reach[1]


PLACES = [(0, 0), (12, 0), (-8, 8), (4, -12)]


def test_a_moved_patch_is_found_at_its_new_place(pixels_at):
    """12 pixels of the patch are a displacement of 3 cells."""
    config = MFCMTConfig.default().replace(background_interval=0)
    search = SearchWindow(config, (56.0, 44.0))
    m = TemplateModel(config, search, is_gray=False)
    m.learn(spectra_at(m, pixels_at(0, 0)))
    for dx, dy in PLACES:
        assert displacement(m, search.reach, pixels_at(dx, dy)) == (dx / 4, dy / 4)


@pytest.mark.parametrize("average", ["filter", "spectra"])
@pytest.mark.parametrize("place", PLACES)
def test_a_target_off_the_middle_is_learned_as_if_it_were_there(pixels_at, place, average):
    config = MFCMTConfig.default().replace(background_interval=0, average=average)
    search = SearchWindow(config, (56.0, 44.0))
    m = TemplateModel(config, search, is_gray=False)
    m.learn(spectra_at(m, pixels_at(*place)), (place[0] / 4, place[1] / 4))
    for dx, dy in PLACES:
        if abs(dx - place[0]) <= 12 and abs(dy - place[1]) <= 12:  # further apart the windows share too little
            assert displacement(m, search.reach, pixels_at(dx, dy)) == (dx / 4, dy / 4)


@pytest.mark.parametrize("offset", [(1, 0), (-2, 3), (0.4, -0.7)])
def test_an_offset_counts_from_the_middle_to_the_target(offset):
    """Features rolled by whole cells, or waves between them, give the mean of the features in the middle."""
    m, other = model(), model()
    x = spectra_of(noise(3, m.features.channels))
    rows, columns = np.fft.fftfreq(N)[:, None], np.arange(N // 2 + 1) / N
    moved = (x * np.exp(-2j * np.pi * (columns * offset[0] + rows * offset[1]))).astype(np.complex64)
    if offset == (1, 0):
        np.testing.assert_allclose(moved, spectra_of(np.roll(noise(3, m.features.channels), 1, 2)), atol=1e-4)
    m.learn(moved, offset)
    other.learn(x.copy())
    np.testing.assert_allclose(m.numerator, other.numerator, atol=1e-4)
    np.testing.assert_allclose(m.denominator, other.denominator, rtol=1e-4)


def test_the_parts_of_a_joint_response_are_its_cues() -> None:
    """Filters are linear in the channels, so the parts add up to the response; computing them changes no bit."""
    frames = synthetic.clip("motion", length=4)
    watched, plain = MFCMT(), MFCMT()
    for tracker in (watched, plain):
        tracker.init(frames.frames[0], frames.boxes[0])
    for frame in frames.frames[1:]:
        seen = watched.update(frame, maps=True)
        assert replace(seen, maps=None) == plain.update(frame)
        assert seen.maps is not None
        assert set(seen.maps) == {"fused", "template", "background", "statistical", "gray", "fhog", "color_names"}
        assert all(one.shape == seen.maps["fused"].shape for one in seen.maps.values())
        assert all(one.sum() == pytest.approx(1, abs=1e-3) for one in seen.maps.values())
    joint = model()
    spectra = spectra_of(noise(1, joint.features.channels))
    joint.learn(spectra)
    whole = respond(joint, spectra)
    parts = joint.respond_by_cue(spectra)
    assert sum(parts.values()) == pytest.approx(whole[0], abs=1e-4)


@pytest.mark.parametrize(
    "changes", [{}, {"joint_filter": False}, {"features": ()}, {"color_histogram": False}], ids=repr
)
def test_the_template_peak_is_the_mean_of_the_ridge_filters_highest_responses(changes):
    """The background-aware filter's peak does not count. Without a model the peak is 1."""
    clip = synthetic.clip("motion", length=2)
    tracker = MFCMT(MFCMTConfig.default().replace(**changes))
    tracker.init(clip.frames[0], clip.boxes[0])
    target, frame = tracker._target, Frame.of(clip.frames[1])
    seen = target.observe(frame, tracker.needed_region(), target.center)
    peaks = detect(tracker.config, target, frame, seen).peaks
    responses = np.empty_like(target.maps()[0])
    if target.template:
        target.template.respond(seen.spectra, responses[: len(target.template.names)])
        ridge = [r.max() for r, name in zip(responses, target.map_names, strict=True) if name in RIDGE]
        assert peaks.template == pytest.approx(np.mean(ridge))
    else:
        assert peaks.template == 1
    if target.color:
        target.color.respond(seen.bins, responses[-1])
        assert peaks.statistical == pytest.approx(responses[-1].max())
    else:
        assert peaks.statistical == 1
