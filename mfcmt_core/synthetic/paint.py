"""Procedural pictures for the synthetic clips: landscape, balloon, tower, tree, textured plates.

Pictures are ``float32`` BGR, 0 to 255. Sprites are BGRA with an alpha of 0 to 1 that the colors are already multiplied
by, so that they can be warped and laid over a frame.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

Picture = npt.NDArray[np.float32]


def f32(values: npt.ArrayLike) -> Picture:
    return np.asarray(values, np.float32)


SKY_TOP, SKY_LOW, SUN = (190, 128, 66), (228, 204, 178), (150, 205, 255)
FIELDS = (
    (58, 122, 92),
    (70, 150, 120),
    (88, 186, 205),
    (60, 104, 74),
    (96, 168, 178),
    (74, 138, 96),
    (126, 104, 122),
)
RANGES = (  # of mountains: height, haze, color, where the snow begins
    (0.24, 0.42, (166, 140, 116), 0.42),
    (0.15, 0.28, (128, 122, 92), 9.0),
    (0.07, 0.15, (92, 118, 84), 9.0),
)
LIVERIES = [
    [(38, 38, 205), (62, 200, 246), (238, 238, 240), (62, 200, 246)],
    [(190, 92, 40), (240, 232, 214)],
    [(70, 150, 50), (60, 205, 240), (70, 150, 50)],
    [(150, 60, 130), (80, 170, 245)],
]


def noise(
    rng: np.random.Generator, height: int, width: int, cell: float, octaves: int = 5, stretch: float = 1.0
) -> Picture:
    """Return fractal value noise (height, width) in [0, 1], with cells of up to ``cell`` × ``cell·stretch`` pixels."""
    total, weight, norm = np.zeros((height, width), np.float32), 1.0, 0.0
    for _ in range(octaves):
        rows, cols = int(height / cell) + 3, int(width / (cell * stretch)) + 3
        grid = rng.random((rows, cols), np.float32)
        total += weight * cv2.resize(grid, (width, height), interpolation=cv2.INTER_CUBIC)
        norm += weight
        cell, weight = max(cell / 2, 1.0), weight * 0.55
    return f32(np.clip((total / norm - 0.5) * 1.6 + 0.5, 0, 1))


def step(values: npt.ArrayLike, low: float, high: float) -> Picture:
    """Return 0 below ``low``, 1 above ``high``, and a smooth transition between them."""
    t = np.clip((np.asarray(values, np.float32) - low) / (high - low), 0, 1)
    return f32(t * t * (3 - 2 * t))


def lit(relief: Picture, right: int, down: int) -> Picture:
    """Return how much higher each pixel is than its neighbor towards the light, which comes from the left."""
    shifted = cv2.copyMakeBorder(relief, down, 0, right, 0, cv2.BORDER_REPLICATE)
    return f32(relief - shifted[: relief.shape[0], : relief.shape[1]])


def mix(under: npt.ArrayLike, over: npt.ArrayLike, share: npt.ArrayLike) -> Picture:
    """Blend ``over`` on ``under`` with the weights ``share``, 0 to 1."""
    a, b, s = (np.asarray(v, np.float32) for v in (under, over, share))
    return f32(a + (b - a) * s[..., None])


def sprite(color: npt.ArrayLike, alpha: npt.ArrayLike) -> Picture:
    """Return a sprite: BGRA, with the colors multiplied by alpha."""
    a = np.clip(np.asarray(alpha, np.float32), 0, 1)[..., None]
    return f32(np.concatenate([np.clip(color, 0, 255) * a, a], axis=2))


def blend(frame: Picture, picture: Picture, box: npt.ArrayLike, angle: float = 0.0) -> None:
    """Draw a sprite over ``frame`` so that it fills ``box`` (x, y, w, h; sub-pixel), rotated around its center.

    Pixel ``i`` covers ``[i, i + 1)``. A sprite larger than its box is averaged to whole pixels first, so that each edge
    pixel is weighted by the part that is covered.
    """
    x, y, w, h = (float(v) for v in np.asarray(box, float))
    small = max(1, min(int(w), picture.shape[1])), max(1, min(int(h), picture.shape[0]))
    if small != picture.shape[1::-1]:
        picture = f32(cv2.resize(picture, small, interpolation=cv2.INTER_AREA))
    sx, sy = w / picture.shape[1], h / picture.shape[0]
    cos, sin = np.cos(angle), np.sin(angle)
    reach_x, reach_y = (abs(w * cos) + abs(h * sin)) / 2 + 1, (abs(w * sin) + abs(h * cos)) / 2 + 1
    cx, cy = x + w / 2, y + h / 2
    left, top = max(0, int(np.floor(cx - reach_x))), max(0, int(np.floor(cy - reach_y)))
    right = min(frame.shape[1], int(np.ceil(cx + reach_x)))
    bottom = min(frame.shape[0], int(np.ceil(cy + reach_y)))
    if left >= right or top >= bottom:
        return
    turn = np.array([[cos * sx, -sin * sy], [sin * sx, cos * sy]])
    center = np.array([picture.shape[1], picture.shape[0]]) / 2 - 0.5
    shift = np.array([cx - 0.5 - left, cy - 0.5 - top]) - turn @ center
    warped = cv2.warpAffine(picture, np.c_[turn, shift], (right - left, bottom - top), flags=cv2.INTER_LINEAR)
    region = frame[top:bottom, left:right]
    region *= 1 - warped[..., 3:]
    region += warped[..., :3]


def plate(rng: np.random.Generator, width: int, height: int) -> Picture:
    """Return a textured rectangle that fills its box: warm marbled colors, a dark frame, a disc and bars."""
    grain = noise(rng, height, width, max(min(width, height) / 3, 2), 4)
    fine = noise(rng, height, width, max(min(width, height) / 12, 1.5), 2)
    picture = mix(np.full((height, width, 3), (40, 60, 190)), np.full((height, width, 3), (60, 205, 240)), grain)
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    u, v = (x + 0.5) / width, (y + 0.5) / height
    picture = mix(picture, (160, 60, 30), step(0.24 - np.hypot((u - 0.36), (v - 0.38)), -0.02, 0.02))
    picture = mix(picture, (235, 235, 225), step(np.sin(u * 21 + v * 9), 0.55, 0.75) * (v > 0.66))
    picture = mix(picture, (25, 25, 35), step(np.maximum(abs(u - 0.5), abs(v - 0.5)), 0.45, 0.47))
    return sprite(picture * (0.75 + 0.5 * fine[..., None]), np.ones((height, width)))


def ground(rng: np.random.Generator, width: int, height: int) -> Picture:
    """Return a mottled background of greens, grays and browns with some structure at every size."""
    a, b, c = (noise(rng, height, width, cell, 5) for cell in (90, 40, 14))
    picture = mix(
        np.full((height, width, 3), (70, 110, 84)),
        np.full((height, width, 3), (120, 136, 150)),
        step(a, 0.35, 0.65),
    )
    picture = mix(picture, (52, 72, 62), step(b, 0.55, 0.7))
    return f32(picture * (0.6 + 0.8 * c[..., None]))


def balloon(livery: int, turn: float, height: int = 176) -> Picture:
    """Return a hot-air balloon with a basket, its gores rotated by ``turn`` radians; (height, 0.75 height, 4)."""
    width, s = int(0.75 * height), np.float32(1.0 / height)
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    v, u = (y + 0.5) * s, (x + 0.5 - width / 2) * s
    palette = f32(LIVERIES[livery % len(LIVERIES)])
    # envelope: a half ellipse above, a narrowing skirt below
    mouth = 0.8
    t = np.clip((v - 0.375) / (mouth - 0.375), 0, 1)
    above = np.sqrt(np.clip(1 - ((0.375 - v) / 0.375) ** 2, 0, 1))
    radius = np.where(v < 0.375, 0.375 * above, 0.375 - 0.3 * t**1.75).astype(np.float32)
    across = np.clip(u / np.maximum(radius, 1e-3), -1, 1)
    longitude = np.arcsin(across) + turn
    gore = longitude * (16 / (2 * np.pi))
    picture = palette[np.floor(gore).astype(int) % len(palette)]
    band = abs(v - 0.42 - 0.035 * abs((gore * 2) % 2 - 1))
    picture = mix(picture, palette[0], step(0.055 - band, 0, 0.008))
    picture = mix(picture, (245, 245, 245), step(0.022 - band, 0, 0.008))
    seam = abs(gore - np.round(gore))
    shade = 0.52 + 0.55 * np.sqrt(np.clip(1 - (across + 0.45) ** 2 / 2.4, 0, 1)) - 0.18 * step(v, 0.45, 0.85)
    shade *= 1 - 0.22 * step(0.07 - seam, 0, 0.07)
    gleam = np.exp(-(((u + 0.15) / 0.09) ** 2 + ((v - 0.17) / 0.1) ** 2))
    picture = picture * shade[..., None] + 46 * gleam[..., None]
    alpha = step((radius - abs(u)) * height, -0.5, 0.7) * (v < mouth)
    # ropes and basket
    rope = step(0.011 - abs(abs(u) - (0.074 - 0.1 * (v - mouth))), 0, 0.008) * (v >= mouth) * (v < 0.9)
    basket = step((0.062 - abs(u)) * height, -0.5, 0.7) * (v >= 0.9)
    weave = 0.8 + 0.25 * np.sin(u * 210) * np.sin(v * 230)
    wicker = np.where(v[..., None] < 0.915, f32((40, 60, 90)), f32((70, 118, 165)))
    picture = mix(picture, (60, 70, 80), rope)
    picture = mix(picture, wicker * weave[..., None], basket)
    return sprite(picture, np.maximum.reduce([alpha, rope, basket]))


def tower(rng: np.random.Generator, width: int, height: int) -> Picture:
    """Return a stone watch-tower with a pitched roof."""
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    u, v = (x + 0.5) / width - 0.5, (y + 0.5) / width
    row = np.floor(v * 9)
    joint = np.maximum(abs((v * 9) % 1 - 0.5), abs((u * 5 + 0.5 * (row % 2)) % 1 - 0.5))
    stone = noise(rng, height, width, 7, 3)
    tint = noise(rng, int(row.max()) + 1, 8, 1, 1)[row.astype(int), np.clip((u * 5 + 2.5), 0, 7).astype(int)]
    picture = f32((128, 146, 160)) * (0.62 + 0.3 * stone + 0.35 * (tint - 0.5))[..., None]
    picture = mix(picture, (84, 92, 100), step(joint, 0.43, 0.48))
    picture = picture * (1.08 - 0.75 * step(u, -0.3, 0.55))[..., None]
    for center in (1.15, 2.1):
        slot = step(0.2 - np.hypot(u * 1.6, (v - center) * 0.75), 0, 0.03)
        picture = mix(picture, (38, 34, 36), slot)
    roof = v < 0.85
    tile = 0.75 + 0.3 * noise(rng, height, width, 4, 2) - 0.22 * (((v * 16) % 1) > 0.75)
    picture = np.where(roof[..., None], f32((62, 78, 158)) * (tile * (1.0 - 0.7 * u))[..., None], picture)
    eaves = np.where(roof, 0.5 * v / 0.85, 0.42)
    return sprite(picture, step((eaves - abs(u)) * width, -0.5, 0.7))


def tree(rng: np.random.Generator, size: int) -> Picture:
    """Return a square picture of a round broad-leaved tree, lit from the left."""
    y, x = np.mgrid[0:size, 0:size].astype(np.float32)
    u, v = (x + 0.5) / size - 0.5, (y + 0.5) / size
    leaves = noise(rng, size, size, size / 5, 4)
    reach = np.hypot(u * 1.15, (v - 0.45) * 1.05) + 0.22 * (leaves - 0.5)
    crown = step(0.4 - reach, 0, 0.03)
    trunk = step(0.035 - abs(u), 0, 0.012) * (v > 0.6) * (v < 0.99)
    light = 0.45 + 0.9 * np.clip(leaves - 0.55 * (u + v - 0.45), 0, 1)
    picture = mix(np.full((size, size, 3), (38, 52, 66)), f32((44, 98, 66)) * light[..., None], crown)
    return sprite(picture, np.maximum(crown, trunk))


def landscape(rng: np.random.Generator, width: int, height: int) -> Picture:
    """Return a valley from the air: clouds, mountains, fields with crop rows and hedges, a river, trees."""
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    horizon = 0.36 * height
    sun = np.exp(-(((x - 0.2 * width) / (0.35 * width)) ** 2 + ((y - horizon) / (0.5 * height)) ** 2))
    picture = mix(np.full((height, width, 3), SKY_TOP), SKY_LOW, np.clip(y / horizon, 0, 1))
    picture = mix(picture, SUN, 0.55 * sun)
    cloud = noise(rng, height, width, height / 4, 6, stretch=2.5)
    relief = np.clip(0.97 + 1.3 * lit(cloud, 14, 8), 0.8, 1.04)
    picture = mix(picture, f32((252, 248, 243)) * relief[..., None], 0.85 * step(cloud, 0.42, 0.85))
    rock = noise(rng, height, width, height / 8, 6)
    facet = np.clip(1 + 2.6 * lit(rock, 4, 0), 0.6, 1.5)
    for reach, haze, color, snow in RANGES:
        crest = noise(rng, 1, width, height * reach * 1.6, 6)[0]
        ridge = horizon - reach * height * (0.35 + 1.1 * (crest - 0.3))
        slope = np.full((height, width, 3), color) * facet[..., None]
        up = (horizon - y) / (reach * height)
        slope = mix(slope, (250, 244, 238), step(up + 1.1 * (rock - 0.5), snow, snow + 0.3))
        picture = mix(picture, mix(slope, SKY_LOW, np.full_like(y, haze)), step(y - ridge, -0.7, 0.7))
    near = np.clip((y - horizon) / (height - horizon), 0.004, 1)
    z = 1 / near
    across = (x - 0.45 * width) / height * z
    wander = cv2.remap(noise(rng, 256, 256, 48, 4), (across * 24) % 255, (z * 24) % 255, cv2.INTER_LINEAR)
    column = np.log(z) * 3.1 + 0.18 * np.sin(across * 1.3) + 0.12 * wander
    lane = (across + 0.35 * np.sin(np.floor(column) * 2.4)) * 1.05
    field = (np.floor(lane) * 5 + np.floor(column) * 3 + np.floor(lane * 0.37) * 2).astype(int) % len(FIELDS)
    land = f32(FIELDS)[field]
    rows = np.sin((np.where(field % 2, lane * 46, column * 38 + lane * 7)) * np.pi)
    land = land * (1 + 0.13 * rows * step(near, 0.06, 0.35))[..., None]
    land = land * (0.78 + 0.5 * noise(rng, height, width, 26, 5, stretch=2.0))[..., None]
    edge = np.maximum(abs(lane % 1 - 0.5), 0.06 + abs(column % 1 - 0.5))
    land = mix(land, f32((42, 78, 56)) * (0.6 + 0.8 * rock)[..., None], step(edge, 0.462, 0.478))
    bend = across - 0.7 * np.sin(z * 0.9 + 0.6) - 0.05 * z - 0.35
    land = mix(land, (150, 176, 170), step(0.21 - abs(bend), 0, 0.02))
    water = mix(
        np.full((height, width, 3), (150, 116, 72)),
        SKY_LOW,
        np.clip(0.25 + 0.5 * (rock - 0.4) + 0.3 * sun, 0, 1),
    )
    land = mix(land, water, step(0.17 - abs(bend), 0, 0.02))
    land = mix(land, SKY_LOW, 0.62 * np.exp(-near * 7))
    picture = mix(picture, land, step(y - horizon, -0.5, 1.0))
    forest = [tree(rng, 64) for _ in range(6)]
    depth = np.sort(0.03 + 0.97 * rng.random(int(width * 0.35)) ** 1.6)
    for d in depth:
        row = horizon + d * (height - horizon)
        place = rng.random() * width
        spot = min(int(row), height - 1), min(int(place), width - 1)
        if abs(bend[spot]) < 0.3 or (edge[spot] < 0.4 and rng.random() < 0.8):
            continue
        size = height * (0.012 + 0.085 * d)
        shadow = sprite(np.zeros((16, 32, 3)), 0.4 * step(1 - np.hypot(*np.mgrid[-1:1:16j, -1:1:32j]), 0, 0.5))
        blend(picture, shadow, (place - 0.2 * size, row - 0.13 * size, size * 1.1, size * 0.26))
        plant = forest[int(rng.integers(6))].copy()
        plant[..., :3] += (f32(SKY_LOW) * plant[..., 3:] - plant[..., :3]) * 0.5 * np.exp(-d * 7)
        blend(picture, plant, (place - size / 2, row - size, size, size))
    return picture
