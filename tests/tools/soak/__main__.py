"""``python -m tests.tools.soak``."""

from ..command import start

start("soak")
