"""docs/mobile.md: its Kotlin is compiled and run, its Swift compared with the schemas."""

from __future__ import annotations

import asyncio
import re
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import MISSING, fields
from pathlib import Path
from types import NoneType
from typing import Any, get_args, get_type_hints

import numpy as np
import pytest

from service.api.asyncapi import close_codes
from service.app import create_app
from service.auth import TICKET_PROTOCOL
from service.load.clips import Clip
from service.protocol import answers, requests
from service.protocol.answers import field_names
from service.protocol.codecs import CODECS
from service.protocol.problems import CATALOGUE
from service.protocol.schema import NAMES
from service.protocol.target import Target
from service.settings import Settings
from tests.conftest import ROOT, require
from tests.service.jsclient.test_browser import overlap
from tests.service.live.cable import Cable
from tests.service.live.conftest import Serve
from tests.service.live.test_main_job import in_process

PAGE = (ROOT / "docs" / "mobile.md").read_text()
HERE = Path(__file__).parent
KOTLIN_HOME = ROOT / ".cache" / "kotlin"
KEY = "a-key-for-the-phone-0123456789"
WAIT_S = 300
# What `POST /v1/sessions` reads.
CREATE = {"frame", "box", "boxes", "options"}


def block(language: str) -> str:
    """The page's one listing in this language."""
    (code,) = re.findall(rf"^```{language}\n(.*?)^```$", PAGE, re.M | re.S)
    return str(code)


@pytest.fixture(scope="module")
def kotlin(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """The listing and ``Main.kt``, compiled: the call that runs them."""
    java = shutil.which("java")
    require(java is not None, "no java")
    assert java is not None
    if not KOTLIN_HOME.is_dir():
        require(shutil.which("apt-get") is not None, "no Kotlin compiler, and no apt-get to have one from")
        KOTLIN_HOME.parent.mkdir(exist_ok=True)
        call = ["sh", str(HERE / "kotlin" / "fetch.sh"), str(KOTLIN_HOME)]
        fetched = subprocess.run(call, capture_output=True, text=True, timeout=WAIT_S, check=False)
        require(fetched.returncode == 0, f"no Kotlin compiler: {fetched.stderr[-300:]}")
    compiler = KOTLIN_HOME / "usr/share/kotlin/kotlinc/lib"
    jars = KOTLIN_HOME / "usr/share/java"
    used = [next(iter(jars.glob(name))) for name in ("okhttp-3*.jar", "okio-1*.jar", "com.android.json.jar")]
    libraries = [str(jar.resolve()) for jar in used]
    folder = tmp_path_factory.mktemp("kotlin")
    (folder / "Tracking.kt").write_text(block("kotlin"))
    main = "org.jetbrains.kotlin.cli.jvm.K2JVMCompiler"
    preloader = ["-cp", str(compiler / "kotlin-preloader.jar"), "org.jetbrains.kotlin.preloading.Preloader"]
    everything = ":".join(str(jar) for jar in sorted(compiler.glob("*.jar")))
    sources = [str(folder / "Tracking.kt"), str(HERE / "kotlin" / "Main.kt")]
    options = ["-jvm-target", "1.8", "-no-stdlib", "-no-reflect", "-Werror", "-d", str(folder / "app.jar")]
    path = ":".join([*libraries, str(compiler / "kotlin-stdlib.jar")])
    call = [java, *preloader, "-cp", everything, main, *sources, "-cp", path, *options]
    done = subprocess.run(call, capture_output=True, text=True, timeout=WAIT_S, check=False)
    assert done.returncode == 0, done.stderr
    return [java, "-cp", f"{folder / 'app.jar'}:{path}", "MainKt"]


async def lines_of(call: list[str], on_line: Callable[[int], None] = lambda count: None) -> list[str]:
    """The lines that it prints."""
    pipe = asyncio.subprocess.PIPE
    process = await asyncio.create_subprocess_exec(*call, stdout=pipe, stderr=pipe)
    assert process.stdout is not None
    assert process.stderr is not None
    lines = []
    try:
        async with asyncio.timeout(WAIT_S):
            async for line in process.stdout:
                lines.append(line.decode().strip())
                on_line(len(lines))
            assert await process.wait() == 0, (await process.stderr.read()).decode()
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
    return lines


def boxes_of(lines: list[str]) -> list[list[float]]:
    return [[float(v) for v in line.split()[2].split(",")] for line in lines]


async def test_kotlin_tracks_like_the_library(
    kotlin: list[str], own_server: Serve, clip: Clip, files: list[str]
) -> None:
    """Through a cable that is cut twice, with a ticket for each handshake."""
    server = own_server(api_keys=KEY)
    async with Cable(server.port) as cable:
        box = ",".join(map(str, clip.box))

        def cut(count: int) -> None:
            if count in (10, 30):
                cable.cut()

        *lines, cuts, ended = await lines_of([*kotlin, cable.url, KEY, box, "whole", *files], cut)
        assert cable.connections >= 4
    assert (cuts, ended) == ("cuts 0", "ended session ended: closed")
    assert boxes_of(lines)[:9] == [list(one[0].box) for one in in_process(clip, [clip.box])][:9]
    overlaps = [
        overlap(box, one[0].box) for box, one in zip(boxes_of(lines), in_process(clip, [clip.box]), strict=True)
    ]
    assert np.mean(overlaps) > 0.95


async def test_kotlin_sends_regions(kotlin: list[str], own_server: Serve, clip: Clip, files: list[str]) -> None:
    server = own_server()
    box = ",".join(map(str, clip.box))
    *lines, cuts, _ = await lines_of([*kotlin, server.url, "", box, "regions", *files])
    assert int(cuts.split()[1]) > len(lines) // 2
    overlaps = [
        overlap(box, one[0].box) for box, one in zip(boxes_of(lines), in_process(clip, [clip.box]), strict=True)
    ]
    assert np.mean(overlaps) > 0.85


def test_swift_reads_what_the_server_says() -> None:
    """Every structure is one of the schemas', every field is there, and what may be null is optional."""
    types = {"id": r"Int|String", "box": r"\[Double\]", "region": r"\[Int\]", "targets": r"\[Target\]", "seq": "Int"}
    structures = re.findall(r"struct (\w+): Decodable \{\n(.*?)\n    \}", block("swift"), re.S)
    assert len(structures) == 9
    classes = {schema: name for name, schema in NAMES.items()}
    for name, body in structures:
        if name == "Kind":
            continue
        model: Any = getattr(answers, classes.get(name, name), Target)
        said = re.findall(r"let (\w+): ([\w\[\]]+)(\?)?$", body, re.M)
        assert len(said) == len(body.splitlines())
        hints = get_type_hints(model)
        defaults = {one.name: one.default is not MISSING for one in fields(model)}
        for field, kind, optional in said:
            may_lack = defaults[field] or NoneType in get_args(hints[field])
            assert bool(optional) == may_lack, (name, field)
            assert re.fullmatch(types.get(field, r"\w+"), kind), (name, field, kind)


@pytest.mark.parametrize("language", ["kotlin", "swift"])
def test_swift_sends_fields_that_the_server_reads(language: str) -> None:
    code = block(language)
    meta, create = set(field_names(requests.Meta)) | {"type"}, CREATE
    if language == "swift":
        for literal in re.findall(r": \[String: Any\] = \[(.*?)\]\n", code):
            keys = set(re.findall(r'"(\w+)":', literal))
            assert keys <= (meta if '"type": "meta"' in literal else create), literal
        assert set(re.findall(r'meta\["(\w+)"\]', code)) <= meta
    else:
        put = set(re.findall(r'\.put\("(\w+)"', code))
        assert put <= meta | create
        messages = [*answers.STREAM_MESSAGES, answers.SessionInfo, Target, answers.ProblemDocument]
        heard = {"type"} | {field for model in messages for field in field_names(model)}
        read = set(re.findall(r'\.(?:get|opt|has)\w*\("(\w+)"\)', code))
        assert read <= heard
    kinds = re.findall(r'case "(\w+)":' if language == "swift" else r'^ +"(\w+)" ->', code, re.M)
    assert set(kinds) == {model.TYPE for model in answers.STREAM_MESSAGES}


@pytest.mark.parametrize("language", ["kotlin", "swift"])
def test_swift_calls_paths_that_the_server_has(language: str) -> None:
    code = block(language)
    document = create_app(Settings()).openapi()
    there = {*document["paths"], "/v1/sessions/{session_id}/stream"}
    asked = re.findall(r'"(?:\$service)?/?(v1/[^"?]*)', code)
    assert {f"/{path}".replace("\\(id)", "{session_id}").replace("$id", "{session_id}") for path in asked} == {
        "/v1/sessions",
        "/v1/sessions/{session_id}/stream",
    }
    assert "/v1/sessions" in there
    protocols = re.findall(r'"(mfcmt\.[^"\\$]*)', code)
    assert set(protocols) == {next(iter(CODECS)), TICKET_PROTOCOL}
    assert set(re.findall(r'[?&](\w+)=|URLQueryItem\(name: "(\w+)"', code)) <= {
        ("mode", ""),
        ("resume", ""),
        ("", "mode"),
        ("", "resume"),
    }
    assert set(re.findall(r'"(bad-[a-z-]+)"', code)) <= set(CATALOGUE)
    final = {code for code in close_codes() if code == 1000 or code >= 4000}
    assert final == {code for code in close_codes() if code not in (1001, 1009, 1011, 1012, 1013)}
