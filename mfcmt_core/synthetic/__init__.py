"""Rendered clips whose true boxes are known exactly, for the tests, the demo and the benchmarks.

Code paints every pixel, so nobody else has rights in them, and everything follows from the seed.

Examples
--------
>>> from mfcmt_core import synthetic
>>> clip = synthetic.clip("sample")
>>> clip.frames[0].shape, clip.boxes.shape
((480, 640, 3), (300, 4))
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, overload

import cv2
import numpy as np
import numpy.typing as npt

from . import paint

Image = npt.NDArray[np.uint8]
Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Scene:
    """A scene: a target that moves along a closed path over a background, and what happens to it.

    Attributes
    ----------
    size : (int, int)
        Width and height of the frame in pixels.
    target : (float, float)
        Width and height of the target in the first frame, in pixels.
    length : int
        Number of frames.
    speed : float
        Largest motion per frame, as a fraction of the target's size. The path shrinks to the frame.
    zoom : float
        Largest scale of the target; the smallest is 1 / ``zoom``.
    hide : float
        Width of a post that the target passes behind, in target widths. 0: no post.
    light : float
        Amplitude of the brightness, 0 to 1.
    rivals : int
        Number of lookalikes in other colors.
    pan : float
        How far the camera turns, in frame widths.
    leaves : bool
        The target leaves the frame and comes back.
    gray : bool
        Frames have one channel.
    grain : float
        Standard deviation of the sensor noise in gray levels.
    balloons : bool
        The target is a balloon over a landscape instead of a plate over a texture.
    """

    size: tuple[int, int] = (320, 240)
    target: tuple[float, float] = (56.0, 44.0)
    length: int = 120
    speed: float = 0.07
    zoom: float = 1.0
    hide: float = 0.0
    light: float = 0.0
    rivals: int = 0
    pan: float = 0.0
    leaves: bool = False
    gray: bool = False
    grain: float = 3.0
    balloons: bool = False


SCENES = {
    "sample": Scene((640, 480), (84.0, 112.0), 300, zoom=1.3, hide=0.45, light=0.12, rivals=3, pan=0.35, balloons=True),
    "motion": Scene(),
    "scale": Scene(length=160, zoom=1.5),
    "occlusion": Scene(length=160, hide=0.6),
    "illumination": Scene(light=0.5),
    "leaves": Scene(length=160, leaves=True),
    "grey": Scene(gray=True),
    "small": Scene(target=(8.0, 8.0), speed=0.12),
    "large": Scene((1920, 1080), (1000.0, 640.0), 30, speed=0.03),
    "distractors": Scene(rivals=2),
}
"""The scenes that :func:`clip` knows by name."""


class Frames(Sequence[Image]):
    """The frames of a clip. Each is painted when it is read, in any order."""

    def __init__(self, length: int, draw: Callable[[int], Image]) -> None:
        self._indices = range(length)
        self._draw = draw

    def __len__(self) -> int:
        return len(self._indices)

    @overload
    def __getitem__(self, index: int) -> Image: ...
    @overload
    def __getitem__(self, index: slice) -> list[Image]: ...
    def __getitem__(self, index: int | slice) -> Image | list[Image]:
        chosen = self._indices[index]
        return self._draw(chosen) if isinstance(chosen, int) else [self._draw(i) for i in chosen]


@dataclass(frozen=True, eq=False)
class Clip:
    """A rendered clip: frames with their true boxes.

    Attributes
    ----------
    name : str
        The name of the scene.
    frames : Frames
        N images, uint8 of shape (H, W, 3) BGR or (H, W).
    boxes : ndarray of float64, shape (N, 4)
        The true [x, y, w, h], 0-based and with sub-pixel precision, also if the target is hidden or outside.
    shown : ndarray of float64, shape (N,)
        The fraction of the box that lies in the frame and is not hidden.
    """

    name: str
    frames: Frames
    boxes: Array
    shown: Array

    @property
    def visible(self) -> npt.NDArray[np.bool_]:
        """True for the frames that show at least half of the target, (N,)."""
        return self.shown >= 0.5

    def __len__(self) -> int:
        return len(self.frames)

    def write(self, folder: str | Path, suffix: str = ".jpg") -> None:
        """Write the clip in the layout of OTB: ``img/0001.jpg`` … and ``groundtruth_rect.txt``, 1-based."""
        images = Path(folder) / "img"
        images.mkdir(parents=True, exist_ok=True)
        for i, frame in enumerate(self.frames, 1):
            ok, data = cv2.imencode(suffix, frame)
            assert ok
            (images / f"{i:04d}{suffix}").write_bytes(data.tobytes())
        np.savetxt(
            Path(folder) / "groundtruth_rect.txt",
            self.boxes + np.array([1, 1, 0, 0]),
            fmt="%.3f",
            delimiter=",",
        )


def clip(name: str = "sample", *, seed: int = 0, **changes: Any) -> Clip:
    """Render a scene of :data:`SCENES`. ``changes`` are fields of :class:`Scene`, such as ``length=30``."""
    if name not in SCENES:
        raise ValueError(f"there is no scene {name!r}, only {', '.join(SCENES)}")
    return render(replace(SCENES[name], **changes), seed=seed, name=name)


def render(scene: Scene, *, seed: int = 0, name: str = "scene") -> Clip:
    """Render a scene. Raises ValueError if the target does not fit its frame or there is no frame."""
    (width, height), (tw, th) = scene.size, scene.target
    if scene.length < 1 or min(width, height) < 16 or not 4 <= min(tw, th) <= max(tw, th) < max(width, height):
        raise ValueError(f"cannot render a target of {tw}×{th} in {scene.length} frames of {width}×{height}")
    boxes = _boxes(scene)
    rng = np.random.default_rng(seed)
    margin = int(np.ceil(scene.pan * width))
    backdrop = (paint.landscape if scene.balloons else paint.ground)(rng, width + margin, height)
    swing = np.sin(_phase(scene))
    light, camera = 1 + scene.light * swing, 0.5 * margin * (1 + swing)
    target = _target(scene, rng)
    rivals = [(_rival(scene, rng, k), _rival_path(scene, boxes, k)) for k in range(scene.rivals)]
    post, post_boxes = _post(scene, rng, boxes, camera)
    grain = scene.grain * rng.standard_normal((height + 61, width + 67, 3), np.float32)

    def draw(i: int) -> Image:
        frame = backdrop.copy()
        if margin:
            center = ((width - 1) / 2 + camera[i], (height - 1) / 2)
            frame = paint.f32(cv2.getRectSubPix(backdrop, (width, height), center))
        for picture, path in rivals:
            paint.blend(frame, picture, path[i])
        paint.blend(frame, target(i), boxes[i])
        if post is not None:
            paint.blend(frame, post, post_boxes[i])
        frame = paint.f32(frame * np.float32(light[i]))
        top, left = np.random.default_rng((seed, i)).integers((61, 67))
        image = cv2.add(frame, grain[top : top + height, left : left + width], dtype=cv2.CV_8U)
        return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if scene.gray else image, np.uint8)

    return Clip(name, Frames(scene.length, draw), boxes, _shown(scene, boxes, post_boxes))


def _phase(scene: Scene) -> Array:
    """Return 0 to 2π over the clip. Everything ends where it began, so that the clip can be shown in a loop."""
    return 2 * np.pi * np.arange(scene.length) / scene.length


def _boxes(scene: Scene) -> Array:
    """Return the target's boxes: a figure of eight around the middle of the frame, or out to the right and back."""
    (width, height), (tw, th), phase = scene.size, scene.target, _phase(scene)
    scale = scene.zoom ** np.sin(phase)
    step = scene.speed * np.sqrt(tw * th) * scene.length / (2 * np.pi)
    room_x, room_y = max(0.0, width - 1.1 * scene.zoom * tw) / 2, max(0.0, height - 1.1 * scene.zoom * th) / 2
    x = width / 2 + min(room_x, step) * np.sin(phase)
    y = height / 2 + min(0.8 * room_y, step / 2) * np.sin(2 * phase)
    if scene.leaves:
        x = width / 2 + (width / 2 + tw) * (1 - np.cos(phase)) / 2
    return np.stack([x - tw * scale / 2, y - th * scale / 2, tw * scale, th * scale], axis=1)


def _target(scene: Scene, rng: np.random.Generator) -> Callable[[int], paint.Picture]:
    """Return a function from a frame's index to the target's picture: a plate, or a balloon that turns."""
    if scene.balloons:
        turn, height = 0.12 * np.sin(_phase(scene)), max(96, round(1.4 * scene.target[1]))
        return lambda i: paint.balloon(0, turn[i], height)
    picture = _plate(scene, rng)
    return lambda _: picture


def _plate(scene: Scene, rng: np.random.Generator) -> paint.Picture:
    width, height = (2 * max(24, round(scene.zoom * side / 2)) for side in scene.target)
    return paint.plate(rng, width, height)


def _rival(scene: Scene, rng: np.random.Generator, k: int) -> paint.Picture:
    """Return a lookalike: the same object in other colors."""
    if scene.balloons:
        return paint.balloon(1 + k, 0.4 * k)
    order = ((1, 2, 0, 3), (2, 0, 1, 3), (0, 2, 1, 3))[k % 3]
    return np.ascontiguousarray(_plate(scene, rng)[..., order])


def _rival_path(scene: Scene, boxes: Array, k: int) -> Array:
    """Return a lookalike's boxes: the target's path at another time. Balloons are farther away and hardly move."""
    if not scene.balloons:
        return np.roll(boxes, -round((k + 1) * scene.length / (scene.rivals + 1)), axis=0)
    drift = np.sin(_phase(scene) + 2 * k)
    w, h = np.array(scene.target) * (0.5, 0.4, 0.28)[k % 3]
    x = scene.size[0] * ((0.14, 0.8, 0.55)[k % 3] + (0.06, 0.05, 0.03)[k % 3] * drift) - w / 2
    y = scene.size[1] * ((0.2, 0.26, 0.12)[k % 3] + 0.02 * drift[::-1]) - h / 2
    return np.stack([x, y, np.full_like(x, w), np.full_like(x, h)], axis=1)


def _post(scene: Scene, rng: np.random.Generator, boxes: Array, camera: Array) -> tuple[paint.Picture | None, Array]:
    """Return the picture and the boxes of what the target passes behind: a tower in the landscape, else a post."""
    (width, height), w = scene.size, scene.hide * scene.target[0]
    left = boxes[:, 0].min() + boxes[0, 2] / 2
    middle = min(left + 0.3 * (width / 2 - left), boxes[0, 0] - w / 2 - 2)
    top = 0.3 * height if scene.balloons else -1.0
    box = np.array([middle - w / 2, top, w, height + 1 - top])
    path = box - 1.15 * camera[:, None] * (1, 0, 0, 0)
    if not scene.hide:
        return None, path
    rows = round(box[3] * 64 / w)
    if scene.balloons:
        return paint.tower(rng, 64, rows), path
    return paint.sprite(0.6 * paint.ground(rng, 64, rows), np.ones((rows, 64))), path


def _shown(scene: Scene, boxes: Array, posts: Array) -> Array:
    """Return the fraction of each box that lies inside the frame and beside the post."""

    def clipped(low: Array, high: Array, a: npt.ArrayLike, b: npt.ArrayLike) -> Array:
        return np.asarray(np.maximum(np.minimum(high, b) - np.maximum(low, a), 0.0), np.float64)

    near, far = boxes[:, :2], boxes[:, :2] + boxes[:, 2:]
    inside = clipped(near, far, 0, scene.size).prod(axis=1)
    hidden = clipped(np.maximum(near, 0), np.minimum(far, scene.size), posts[:, :2], posts[:, :2] + posts[:, 2:]).prod(
        axis=1
    )
    return np.asarray((inside - hidden) / boxes[:, 2:].prod(axis=1), np.float64)
