"""Node running the JavaScript client against a real server."""

from __future__ import annotations

import asyncio
import json
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from service.load.clips import Clip
from tests.conftest import ROOT, require

HERE = Path(__file__).parent
PACKAGE = ROOT / "service" / "web" / "client"
TIMEOUT_S = 240


def node_with(folder: Path) -> str:
    """Node, where what the lock file in a folder names is installed: `make npm` does that."""
    found = shutil.which("node")
    require(found is not None, "no node")
    assert found is not None
    needed = json.loads((PACKAGE / "package.json").read_text())["engines"]["node"].removeprefix(">=")
    version = subprocess.run([found, "--version"], capture_output=True, text=True, check=True).stdout.strip()
    require(int(version.removeprefix("v").split(".")[0]) >= int(needed), f"Node {version}, the client needs {needed}")
    lock, installed = folder / "package-lock.json", folder / "node_modules" / ".package-lock.json"
    fresh = installed.is_file() and installed.stat().st_mtime >= lock.stat().st_mtime
    require(fresh, f"the npm packages of {folder.relative_to(ROOT)} are not installed: make npm")
    return found


@pytest.fixture(scope="session")
def node() -> str:
    """Node with what the tests need from npm."""
    return node_with(HERE)


@pytest.fixture
def files(clip: Clip, tmp_path: Path) -> list[str]:
    """The clip's frames as files."""
    paths = [tmp_path / f"{index:04d}.jpg" for index in range(len(clip.frames))]
    for path, frame in zip(paths, clip.frames, strict=True):
        path.write_bytes(frame)
    return [str(path) for path in paths]


class Scenario:
    """One run of ``scenarios.mjs``."""

    def __init__(self, node: str, clip: Clip, files: list[str]) -> None:
        self._node, self._clip, self._files = node, clip, files

    async def __call__(
        self, name: str, url: str, on_line: Callable[[dict[str, Any]], None] = lambda line: None, **given: object
    ) -> Any:
        """What it told at its end; ``on_line`` hears what it tells meanwhile."""
        process = await asyncio.create_subprocess_exec(
            self._node,
            HERE / "scenarios.mjs",
            name,
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
            limit=64 * 1024 * 1024,
        )
        assert process.stdin is not None
        assert process.stdout is not None
        assert process.stderr is not None
        task = {"url": url, "frames": self._files, "box": self._clip.box} | given
        done = None
        try:
            async with asyncio.timeout(TIMEOUT_S):
                process.stdin.write(json.dumps(task).encode())
                process.stdin.close()
                async for line in process.stdout:
                    message = json.loads(line)
                    if "done" in message:
                        done = message["done"]
                    else:
                        on_line(message)
                errors = (await process.stderr.read()).decode()
                assert await process.wait() == 0, errors
        finally:
            if process.returncode is None:
                process.kill()
                await process.wait()
        assert not errors
        return done


@pytest.fixture
def scenario(node: str, clip: Clip, files: list[str]) -> Scenario:
    return Scenario(node, clip, files)
