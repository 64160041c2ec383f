"""Interfaces of other tools to the tracker: KServe v2, CVAT, Label Studio.

Those that open an interface of the service are off unless ``MFCMT_BRIDGES`` names them. They use sessions as the calls
of the public API do, under the same keys, limits, metrics and problems. This module is small: settings read it, and
:mod:`.cvat_function` is used where no service is.
"""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, cast

if TYPE_CHECKING:
    from fastapi import APIRouter

    from ..service import Service


@dataclass(frozen=True, slots=True)
class Bridge:
    """An interface that a service can open: its module, and a pattern of the paths that need a key."""

    module: str
    guarded: str

    def load(self, service: Service) -> APIRouter:
        """Return the router of the interface, whose calls work on ``service``."""
        module = importlib.import_module(f".{self.module}", __name__)
        return cast("APIRouter", module.router(service))


BRIDGES = {
    "cvat": Bridge("cvat", r"/api/function"),
    "labelstudio": Bridge("labelstudio", r"/labelstudio/"),
    "kserve": Bridge("kserve", r"/v2(?!/health/)"),
}
"""The bridges by the names that ``MFCMT_BRIDGES`` has for them."""
