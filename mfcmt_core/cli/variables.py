"""The ``MFCMT_*`` variables of the environment, and those among them that nothing reads."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from difflib import get_close_matches

PREFIX = "MFCMT_"
OWN = ("MFCMT_OTB_ROOT", "MFCMT_CI")
"""Read by the command and by the tests, beside the settings of the service."""
OF_CLUSTERS = re.compile(r"MFCMT_(\w+_)?(SERVICE_(HOST|PORT)(_\w+)?|PORT_\d+_(TCP|UDP)(_\w+)?)|MFCMT_VERSION")
"""What Kubernetes and Docker set where a service's name begins with ``mfcmt``, and the image's tag (compose)."""


def unread_variables(settings: Iterable[str]) -> list[str]:
    """A line for each variable that is neither one of ``settings`` nor ours, with the nearest name that is."""
    known = [*settings, *OWN]
    unread = (name for name in sorted(os.environ) if name.startswith(PREFIX) and name not in known)
    return [_told(name, known) for name in unread if not _of_a_cluster(name)]


def misspelt_variables() -> list[str]:
    """Those lines of :func:`unread_variables` that are near a variable of the command's own."""
    return [line for line in unread_variables(()) if "did you mean" in line]


def _of_a_cluster(name: str) -> bool:
    return bool(OF_CLUSTERS.fullmatch(name)) or os.environ[name].startswith(("tcp://", "udp://"))


def _told(name: str, known: list[str]) -> str:
    nearest = get_close_matches(name, known, 1, cutoff=0.75)
    return f"{name} is not read by anything" + (f"; did you mean {nearest[0]}?" if nearest else "")
