"""Turn a stored picture to the way it is shown, as phones ask for with a matrix beside the picture."""

from __future__ import annotations

import struct

FIXED = 1 << 16
"""1 in the fixed-point numbers of a display matrix."""

_FILTERS: dict[tuple[int, int, int, int], tuple[tuple[str, str | None], ...]] = {
    (1, 0, 0, 1): (),
    (-1, 0, 0, 1): (("hflip", None),),
    (1, 0, 0, -1): (("vflip", None),),
    (-1, 0, 0, -1): (("hflip", None), ("vflip", None)),
    (0, 1, -1, 0): (("transpose", "clock"),),
    (0, -1, 1, 0): (("transpose", "cclock"),),
    (0, 1, 1, 0): (("transpose", "cclock_flip"),),
    (0, -1, -1, 0): (("transpose", "clock_flip"),),
}
"""FFmpeg's filters by the signs of the four numbers of a matrix that turn and mirror."""


def filters(matrix: bytes | None) -> tuple[tuple[str, str | None], ...] | None:
    """Return names and arguments of the filters that turn a picture by its display matrix.

    ``matrix`` has nine 32-bit integers, row by row, or is None. Returns None if the turn is no multiple of 90 degrees.
    """
    if matrix is None or len(matrix) < 36:
        return ()
    numbers = struct.unpack("=9i", matrix[:36])
    a, b, c, d = (numbers[i] / FIXED for i in (0, 1, 3, 4))
    if any(abs(number - round(number)) > 1e-3 for number in (a, b, c, d)):
        return None
    return _FILTERS.get((round(a), round(b), round(c), round(d)))
