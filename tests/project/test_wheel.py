"""The wheel: what it carries, and what its commands say of what it does not carry."""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from service.cli import TOOLS
from tests.conftest import ROOT

# Packages that are imported by another name.
MODULES = {"opencv-python-headless": "cv2", "python-multipart": "multipart"}
BUILD = "import sys; from hatchling.build import build_wheel; print(build_wheel(sys.argv[1]))"


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel, unpacked."""
    folder = tmp_path_factory.mktemp("wheel")
    done = subprocess.run([sys.executable, "-c", BUILD, folder], cwd=ROOT, capture_output=True, text=True, check=True)
    with zipfile.ZipFile(folder / done.stdout.split()[-1]) as packed:
        packed.extractall(folder / "unpacked")
    return folder / "unpacked"


def run(wheel: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run ``mfcmt`` from the wheel."""
    program = "import sys; from mfcmt_core.cli import main; sys.exit(main(sys.argv[1:]))"
    return subprocess.run(
        [sys.executable, "-c", program, *arguments],
        cwd=wheel,
        env=os.environ | {"PYTHONPATH": str(wheel)},
        capture_output=True,
        text=True,
        check=False,
    )


def test_the_wheel_has_no_tools_that_attack_a_service(wheel: Path) -> None:
    names = [path.relative_to(wheel).as_posix() for path in wheel.rglob("*") if path.is_file()]
    assert {name.split("/")[0] for name in names} == {"mfcmt_core", "service", "mfcmt-0.1.0.dist-info"}
    tools = ("siege", "chaos", "fuzz", "soak", "mutate", "slope")
    assert [name for name in names if any(tool in name.rsplit("/")[-1] for tool in tools)] == []
    assert {"service/load/drive.py", "service/cli/load.py", "service/cli/demo.py"} <= set(names)


@pytest.mark.parametrize("name", TOOLS)
def test_a_tool_that_is_not_there_says_where_it_is(wheel: Path, name: str) -> None:
    done = run(wheel, name)
    said = f"mfcmt {name}: not in the installed package; in a clone of the project run python -m tests.tools.{name}\n"
    assert (done.returncode, done.stdout, done.stderr) == (2, "", said)


def test_all_other_commands_are_there(wheel: Path) -> None:
    listed = run(wheel, "--help").stdout
    for name in ("track", "eval", "bench", "trax", "warmup", "serve", "health", "load", "demo"):
        assert f"    {name} " in listed
        assert run(wheel, name, "--help").returncode == 0


def test_the_client_needs_its_own_packages_alone(wheel: Path) -> None:
    """As README installs it: without the packages of the tracker and of the service."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    names = {Requirement(text).name for text in [*project["dependencies"], *extras["service"]]}
    names -= {Requirement(text).name for text in extras["client"]} | {"mfcmt"}
    absent = {MODULES.get(name, name.replace("-", "_")) for name in names}
    assert {"numpy", "cv2", "fastapi"} <= absent
    code = f"import sys; sys.modules.update(dict.fromkeys({sorted(absent)})); from service.client import Client"
    subprocess.run([sys.executable, "-c", code], cwd=wheel, check=True)
