"""What README and the examples say to paste works as it stands, but for the address of the service."""

from __future__ import annotations

import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from mfcmt_core import MFCMT
from service.load.own import OwnServer
from tests.chromium import chromium
from tests.conftest import ROOT, require

README = (ROOT / "README.md").read_text(encoding="utf-8")
EXAMPLES_README = (ROOT / "docs" / "examples" / "README.md").read_text(encoding="utf-8")
FRAMES = ROOT / "docs" / "examples" / "frames"
ADDRESS = "http://127.0.0.1:8000"
BOX = (139, 92, 42, 56)
TIMEOUT_S = 180
# What a page has around the snippet: a video that plays, and somebody who looks at the boxes.
AROUND = """
const video = document.createElement("video");
Object.assign(video, {{ src: "/static/page/sample.webm", muted: true, loop: true }});
await video.play();
window.drawn = [];
const draw = (box, status) => window.drawn.push([box, status]);
{snippet}
"""


def block(language: str, says: str, text: str = README) -> str:
    """The block of code that has ``says`` in it."""
    found = [code for code in re.findall(rf"```{language}\n(.*?)```", text, re.S) if says in code]
    assert len(found) == 1, (language, says)
    return found[0]


def run(call: list[str], cwd: Path = ROOT, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        call, cwd=cwd, env=os.environ | environment, capture_output=True, text=True, timeout=TIMEOUT_S, check=False
    )


@pytest.fixture(scope="module")
def said() -> list[Any]:
    """What the library says of the frames, read as the service reads them."""
    from mfcmt_core.images.decode import decode
    from service.load.clips import LIMITS

    files = sorted(FRAMES.glob("*.jpg"))
    return list(MFCMT().track((decode(file.read_bytes(), LIMITS)[0] for file in files), BOX))


def test_the_curl_session_works_as_pasted(server: OwnServer, said: list[Any]) -> None:
    require(shutil.which("curl"), "no curl")
    code = block("sh", "curl -sS -F")
    assert ADDRESS in code
    done = run(["sh", "-euc", code.replace(ADDRESS, server.url)])
    assert (done.returncode, done.stderr) == (0, "")
    answer = json.loads(done.stdout)
    assert (answer["type"], answer["seq"]) == ("result", 1)
    assert answer["targets"][0]["box"] == pytest.approx(said[1].box, abs=1e-3)
    shown = json.loads("[" + re.findall(r'"box":\[([^]]*)\]', code)[0] + "]")
    assert shown == pytest.approx(said[1].box, abs=0.06)


def test_the_python_session_works_as_pasted(server: OwnServer, said: list[Any]) -> None:
    code = block("python", "from service.client")
    assert ADDRESS in code
    done = run([sys.executable, "-c", code.replace(ADDRESS, server.url)])
    assert (done.returncode, done.stderr) == (0, "")
    boxes = [[float(v) for v in re.findall(r"\(([^)]*)\)", line)[0].split(",")] for line in done.stdout.splitlines()]
    assert len(boxes) == len(said) - 1
    for box, one in zip(boxes, said[1:], strict=True):
        assert box == pytest.approx(one.box, abs=1e-3)


def test_the_python_snippet_takes_frames_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    for number in (1, 2, 10):
        (tmp_path / f"img{number}.jpg").touch()
    line = next(line for line in block("python", "from service.client").splitlines() if line.startswith("paths"))
    names: dict[str, Any] = {"re": re, "Path": Path}
    exec(line.replace("docs/examples/frames", str(tmp_path)), names)
    assert [path.name for path in names["paths"]] == ["img1.jpg", "img2.jpg", "img10.jpg"]


def test_the_library_snippet_works_as_pasted(capsys: pytest.CaptureFixture[str]) -> None:
    frames = [cv2.imread(str(file)) for file in sorted(FRAMES.glob("*.jpg"))]
    names = {"first_frame": frames[0], "frames": frames[1:]}
    exec(block("python", "tracker = MFCMT()"), names)
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == len(frames) - 1
    assert isinstance(names["data"], bytes)


async def test_the_page_snippet_works_as_pasted(server: OwnServer) -> None:
    playwright: Any = pytest.importorskip("playwright.async_api")
    path = chromium()
    async with playwright.async_playwright() as driver:
        browser = await driver.chromium.launch(
            executable_path=path, args=["--no-sandbox", "--autoplay-policy=no-user-gesture-required"]
        )
        try:
            page = await (await browser.new_context(bypass_csp=True)).new_page()
            errors: list[str] = []
            page.on("pageerror", lambda error: errors.append(str(error)))
            await page.goto(f"{server.url}/docs")  # a page of the service's own origin, and without scripts
            code = AROUND.format(snippet=block("js", "/static/client/mfcmt.js"))
            await page.add_script_tag(type="module", content=code)
            await page.wait_for_function("window.drawn?.length > 5", timeout=60_000)
            box, status = await page.evaluate("window.drawn.at(-1)")
            assert errors == []
        finally:
            await browser.close()
    assert len(box) == 4
    assert status in ("tracking", "uncertain", "lost")


@pytest.mark.parametrize("source", [f"{ADDRESS}/static/mfcmt-client.tgz", "--install-links /path/to/mfcmt"])
def test_the_javascript_client_installs_from_a_service_and_from_a_path(
    source: str, server: OwnServer, node: str, tmp_path: Path
) -> None:
    """In an empty folder, and then the example runs in it."""
    npm = shutil.which("npm")
    require(npm, "no npm")
    line = next(line for line in block("sh", "npm install", EXAMPLES_README).splitlines() if source in line)
    call = line.partition("#")[0].replace("/path/to/mfcmt", str(ROOT)).replace(ADDRESS, server.url).split()
    words = [word for word in call if word != "ws"]  # which would come from a registry
    assert len(words) < len(call)
    installed = run(
        [*words, "--no-audit", "--no-fund", "--registry", "http://127.0.0.1:9", "--fetch-retries", "0"], cwd=tmp_path
    )
    assert installed.returncode == 0, installed.stderr
    assert not (tmp_path / "node_modules" / "@mfcmt" / "client").is_symlink()
    (tmp_path / "node_modules" / "ws").symlink_to(ROOT / "tests" / "service" / "jsclient" / "node_modules" / "ws")
    example = shutil.copy(ROOT / "docs" / "examples" / "track.mjs", tmp_path)
    files = [str(file) for file in sorted(FRAMES.glob("*.jpg"))]
    done = run([node, str(example), "139,92,42,56", *files], cwd=tmp_path, SERVICE=server.url)
    assert done.returncode == 0, done.stderr
    assert len(done.stdout.splitlines()) == len(files) - 1


def test_both_readmes_install_the_clients_in_the_same_way() -> None:
    commands = block("sh", "pip install")
    lines = [line.partition("#")[0].strip() for line in commands.splitlines()]
    here = block("sh", "pip install", EXAMPLES_README)
    assert lines
    for line in lines:
        assert line in here
    assert "httpx2 websockets msgpack pydantic" in here
    assert set(client_needs()) - {"annotated-types"} == {"httpx2", "websockets", "msgpack", "pydantic"}  # pydantic's


def client_needs() -> list[str]:
    import tomllib

    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    return [re.split(r"[<>=]", need)[0] for need in project["optional-dependencies"]["client"]]


def test_the_frames_are_those_that_their_script_renders() -> None:
    spec = importlib.util.spec_from_file_location("example_frames", ROOT / ".ci" / "example_frames.py")
    assert spec is not None
    assert spec.loader is not None
    command: Any = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(command)
    clip, files = command.rendered(), sorted(FRAMES.iterdir())
    assert [file.name for file in files] == [f"{number:04d}.jpg" for number in range(1, command.COUNT + 1)]
    for number, file in enumerate(files):
        done, data = cv2.imencode(".jpg", clip.frames[command.EVERY * number], command.ENCODER)
        assert done
        rendered = cv2.imdecode(data, cv2.IMREAD_COLOR)
        assert np.abs(cv2.imread(str(file)).astype(float) - rendered).mean() < 1, file
    assert clip.boxes[0] == pytest.approx(BOX)
    assert sum(file.stat().st_size for file in files) < 200_000
