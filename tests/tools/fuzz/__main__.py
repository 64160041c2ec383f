"""``python -m tests.tools.fuzz``."""

from ..command import start

start("fuzz")
