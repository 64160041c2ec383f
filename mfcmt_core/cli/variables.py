"""Find ``MFCMT_*`` variables in the environment that nothing reads."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from difflib import get_close_matches

PREFIX = "MFCMT_"
OWN = ("MFCMT_OTB_ROOT", "MFCMT_NANOTRACK", "MFCMT_CI")
"""Variables of the command and the tests, which are no settings of the service."""
OF_CLUSTERS = re.compile(r"MFCMT_(\w+_)?(SERVICE_(HOST|PORT)(_\w+)?|PORT_\d+_(TCP|UDP)(_\w+)?)|MFCMT_VERSION")
"""Variables that Kubernetes and Docker set for a service whose name begins with ``mfcmt``, and compose's image tag."""


def unread_variables(settings: Iterable[str]) -> list[str]:
    """Return a line for each variable that is not in ``settings`` and not the command's, with the nearest name."""
    known = [*settings, *OWN]
    unread = (name for name in sorted(os.environ) if name.startswith(PREFIX) and name not in known)
    return [_describe(name, known) for name in unread if not _of_a_cluster(name)]


def misspelt_variables() -> list[str]:
    """Return the lines of :func:`unread_variables` for names near a variable of the command."""
    return [line for line in unread_variables(()) if "did you mean" in line]


def _of_a_cluster(name: str) -> bool:
    return bool(OF_CLUSTERS.fullmatch(name)) or os.environ[name].startswith(("tcp://", "udp://"))


def _describe(name: str, known: list[str]) -> str:
    nearest = get_close_matches(name, known, 1, cutoff=0.75)
    return f"{name} is not read by anything" + (f"; did you mean {nearest[0]}?" if nearest else "")
