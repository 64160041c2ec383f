"""``python -m tests.tools.chaos``."""

from ..command import start

start("chaos")
