"""``python -m tests.tools.siege``."""

from ..command import start

start("siege")
