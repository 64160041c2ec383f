"""Where the published boxes and the annotations of all 100 targets are."""

from __future__ import annotations

from pathlib import Path

import pytest

from mfcmt_core.otb import Dataset, open_otb
from tests.conftest import OTB_ROOT, require


@pytest.fixture(scope="session")
def published() -> Path:
    """A folder of published boxes for each of some trackers."""
    folder = OTB_ROOT.parent / "published"
    require(folder.is_dir(), f"no published boxes at {folder}")
    return folder


@pytest.fixture(scope="session")
def annotations() -> Path:
    """The ground truth of all 100 targets."""
    folder = OTB_ROOT.parent / "otb_annotations"
    require(folder.is_dir(), f"no annotations at {folder}")
    return folder


@pytest.fixture(scope="session")
def otb2015(annotations: Path) -> Dataset:
    return open_otb(annotations)


@pytest.fixture(scope="session")
def otb2013(annotations: Path) -> Dataset:
    return open_otb(annotations, "OTB-2013")
