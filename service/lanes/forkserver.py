"""The fork server's state; only the fork server imports it, before it makes the first lane."""

from __future__ import annotations

import gc
import signal

from . import preload as preload
from .orphans import die_with_parent

# The front ends its lanes itself, after it has drained; a signal to the whole group must not come first.
signal.signal(signal.SIGTERM, signal.SIG_IGN)
signal.signal(signal.SIGINT, signal.SIG_IGN)
die_with_parent()
# What is here now never dies: keep the collector from touching (and so copying) its pages in every lane.
gc.collect()
gc.freeze()
