"""The fork server's own state; imported by nothing but the fork server, before it makes the first lane."""

from __future__ import annotations

import gc
import signal

from . import preload as preload
from .confine import die_with_parent

# The front drains and then ends its lanes by itself; a signal to the whole process group must not end them before.
signal.signal(signal.SIGTERM, signal.SIG_IGN)
signal.signal(signal.SIGINT, signal.SIG_IGN)
die_with_parent()
# Objects that exist now are never freed: keep the collector from touching, and so copying, their pages in every lane.
gc.collect()
gc.freeze()
