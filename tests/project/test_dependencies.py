"""The dependency audit, as far as it can be made offline: all pinned, all hashed, installed as locked, whole."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from importlib import metadata

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.conftest import ROOT

SERVING, DEVELOPMENT = ROOT / "requirements.lock", ROOT / "requirements-dev.lock"
LOCKS = [SERVING, DEVELOPMENT, *(ROOT / ".ci" / name for name in ("peers.lock", "bridges.lock", "clusters.lock"))]
CLUSTERS = ROOT / ".ci" / "clusters.lock"
HASH = re.compile(r"--hash=sha256:[0-9a-f]{64}")
Entry = tuple[Requirement, list[str]]


def entries(lock: str) -> list[Entry]:
    """Every requirement of a lock file and its hashes."""
    logical = re.sub(r"\\\n", " ", lock)
    lines = [line.strip() for line in logical.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    return [(Requirement(line.split(" --hash")[0]), HASH.findall(line)) for line in lines]


@pytest.mark.parametrize("path", LOCKS, ids=lambda path: path.name)
def test_every_dependency_is_pinned_and_hashed(path: object) -> None:
    """One version, from an index (no URL, no path), with at least one SHA-256; nothing else is in the file."""
    found = entries(path.read_text())  # type: ignore[attr-defined]
    assert len(found) > 10
    for requirement, hashes in found:
        assert re.fullmatch(r"==[0-9][0-9A-Za-z.+!]*", str(requirement.specifier)), requirement
        assert requirement.url is None, requirement
        assert hashes, f"{requirement.name} has no hash"


def test_every_dependency_of_the_project_is_locked() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    locked: dict[str, list[Requirement]] = {}
    # Ray and Dask are in an environment of their own.
    for requirement, _ in [one for path in (DEVELOPMENT, CLUSTERS) for one in entries(path.read_text())]:
        locked.setdefault(canonicalize_name(requirement.name), []).append(requirement)
    wanted = [*project["dependencies"], *(one for extra in project["optional-dependencies"].values() for one in extra)]
    for text in wanted:
        requirement = Requirement(text)
        if canonicalize_name(requirement.name) == "mfcmt":
            continue
        versions = [str(pin.specifier)[2:] for pin in locked.get(canonicalize_name(requirement.name), [])]
        assert versions, f"{requirement.name} is not locked"
        assert all(requirement.specifier.contains(version, prereleases=True) for version in versions), text


def test_the_packages_for_serving_are_a_subset_of_those_for_development() -> None:
    """`make serve` installs no tools of the tests, and the tests run with the very packages that serve."""
    serving, development = (
        {str(requirement): hashes for requirement, hashes in entries(path.read_text())}
        for path in (SERVING, DEVELOPMENT)
    )
    assert serving.items() <= development.items()
    video = {str(requirement): hashes for requirement, hashes in entries((ROOT / ".ci" / "video.lock").read_text())}
    assert video.items() <= development.items()
    names = {canonicalize_name(Requirement(pin).name) for pin in serving}
    assert not names & {"pytest", "hypothesis", "playwright", "ruff", "mypy", "scipy", "matplotlib", "schemathesis"}
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    extras = project["project"]["optional-dependencies"]
    needed = [*project["project"]["dependencies"], *extras["service"], *extras["client"], *extras["otel"]]
    needed += project["dependency-groups"]["editable"]
    assert {canonicalize_name(Requirement(text).name) for text in needed} - {"mfcmt"} <= names


def test_installed_packages_are_the_locked_ones() -> None:
    for requirement, _ in entries(DEVELOPMENT.read_text()):
        if requirement.marker is None or requirement.marker.evaluate():
            try:
                installed = metadata.version(requirement.name)
            except metadata.PackageNotFoundError:
                pytest.fail(f"{requirement.name} is locked and not installed: make setup")
            assert requirement.specifier.contains(installed, prereleases=True), f"{requirement} is {installed} here"


def test_installed_packages_are_compatible() -> None:
    run = subprocess.run([sys.executable, "-m", "pip", "check"], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stdout
