"""What a lane can still do once it has given up the rest: nothing that a stranger's image could make use of."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

from service.lanes.confine import MAX_OPEN_FILES
from service.load.clips import Clip
from service.load.own import OwnServer
from service.load.usage import server_processes
from tests.conftest import ROOT, require

from .conftest import Serve, Wire
from .test_lanes import until, until_ready

SECRETS = ("key-of-the-first-tenant", "secret-that-signs-snapshots", "key-of-the-operator")
# Each is tried in a process that has confined itself; what it prints is the name of the refusal.
ATTEMPTS = {
    "write a file": "open(HERE + '/new', 'w')",
    "append to a file": "open(HERE + '/there', 'a')",
    "remove a file": "os.remove(HERE + '/there')",
    "read a secret": "open(HERE + '/there').read()",
    "read its own environment": "open('/proc/self/environ').read()",
    "read the front's environment": "open(f'/proc/{os.getppid()}/environ').read()",
    "read the front's memory": "open(f'/proc/{os.getppid()}/mem', 'rb').read(1)",
    "connect": "socket.create_connection(('127.0.0.1', PORT), 5)",
    "send a datagram": "socket.socket(socket.AF_INET, socket.SOCK_DGRAM).sendto(b'x', ('127.0.0.1', 9))",
    "run a program": "os.execv('/bin/true', ['true'])",
    "signal the front": "os.kill(os.getppid(), 0)",
    "get the rights back": "os.setuid(0) if os.getuid() else os.setgroups([0])",
}
# What refuses it, where it is not Landlock; a container may have neither.
NEEDED = {"get the rights back": ["no-capabilities"], "send a datagram": ["no-network"]}
CODE = """
import json, os, socket, sys, encodings.idna
from service.lanes.confine import confine
HERE, PORT = sys.argv[1], int(sys.argv[2])
told = {"confined": confine()}
for name, attempt in json.loads(sys.argv[3]).items():
    try:
        exec(attempt)
        told[name] = "done"
    except OSError as refused:
        told[name] = type(refused).__name__
import wsgiref.headers
told["use a library"] = "done"
print(json.dumps(told))
"""


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory: pytest.TempPathFactory, server: OwnServer) -> dict[str, object]:
    """What became of each attempt."""
    here = tmp_path_factory.mktemp("confined")
    (here / "there").write_text("secret")
    command = [sys.executable, "-c", CODE, str(here), str(server.port), json.dumps(ATTEMPTS)]
    run = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert run.returncode == 0, run.stderr
    answers: dict[str, object] = json.loads(run.stdout)
    assert (here / "there").read_text() == "secret"
    assert not (here / "new").exists()
    return answers


@pytest.mark.parametrize("attempt", ATTEMPTS)
def test_a_confined_process_is_refused_what_it_does_not_need(outcomes: dict[str, object], attempt: str) -> None:
    confined = outcomes["confined"]
    assert isinstance(confined, list)
    needed = NEEDED.get(attempt, [f"landlock-{version}" for version in range(6, 100)])
    require(sys.platform == "linux" and set(needed) & set(confined), f"this kernel gives {confined}")
    assert outcomes[attempt] in ("PermissionError", "OSError", "ConnectionRefusedError"), attempt


def test_what_a_lane_needs_stays(outcomes: dict[str, object]) -> None:
    assert outcomes["use a library"] == "done"


def test_a_kernel_that_was_forgotten_is_compiled_in_memory(tmp_path: Path) -> None:
    """What cannot be kept on disk is no fault."""
    (tmp_path / "forgotten.py").write_text(
        "from mfcmt_core.kernels._jit import kernel\n@kernel\ndef add(x, y):\n    return x + y\n"
    )
    code = "from forgotten import add; from service.lanes.confine import confine; confine(); print(add(20, 22))"
    path = os.pathsep.join((str(tmp_path), str(ROOT)))
    environment = os.environ | {"PYTHONPATH": path}
    run = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=120, check=False
    )
    assert (run.returncode, run.stdout.strip()) == (0, "42"), run.stderr
    assert not list(tmp_path.rglob("*.nbc"))


async def test_every_lane_is_confined(serve: Serve, clip: Clip) -> None:
    """As the system sees it; and no lane was ever told a secret."""
    require(sys.platform == "linux", "confinement is Linux's")
    key, signing, admin = SECRETS
    wire = serve({"X-API-Key": key}, lanes=2, api_keys=key, signing_keys=signing, admin_key=admin)
    roles = server_processes(wire.server.pid)
    lanes = [pid for role, pid in roles.items() if role.startswith("lane")]
    assert len(lanes) == 2
    for pid in lanes:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
        status = {name: value.strip() for name, _, value in (line.partition(":") for line in lines)}
        assert status["NoNewPrivs"] == "1"
        assert int(status["CapEff"], 16) == 0
        limits = Path(f"/proc/{pid}/limits").read_text()
        rows = {line[:26].strip(): line[26:].split()[:2] for line in limits.splitlines()[1:]}
        assert rows["Max open files"] == [str(MAX_OPEN_FILES)] * 2
        assert rows["Max processes"] == rows["Max core file size"] == ["0", "0"]
        assert not [file for file in psutil.Process(pid).open_files() if file.fd > 2]
        assert not psutil.Process(pid).net_connections("inet")
    for role, pid in roles.items():
        if role != "front":
            environment = Path(f"/proc/{pid}/environ").read_bytes().decode()
            assert "MFCMT_" not in environment
            assert not any(secret in environment for secret in SECRETS)
    outcomes = [json.loads(line) for line in wire.server.log.splitlines() if '"lane ready"' in line]
    assert len(outcomes) >= 2
    for record in outcomes:
        assert {"limits", "no-new-privileges"} <= set(record["confined"])
        if "no-network" in record["confined"]:
            spaces = {os.readlink(f"/proc/{pid}/ns/net") for pid in (*lanes, wire.server.pid)}
            assert len(spaces) == 3
    session = await wire.create(clip.frames[0], clip.box)
    assert (await wire.track(session["id"], clip.frames[1])).status_code == 200


async def test_no_process_that_starts_later_knows_a_key(serve: Serve, clip: Clip, tmp_path: Path) -> None:
    """After the fork server has died and with it all lanes, and after a lane has died alone."""
    require(sys.platform == "linux", "environments and memory are looked at in /proc")
    key, signing, admin = SECRETS
    filed, header = "key-that-is-in-the-file", "header-of-the-collector"
    keys = tmp_path / "keys"
    keys.write_text(f"tenant {filed}\n")
    wire = serve(
        {"X-API-Key": key},
        lanes=2,
        api_keys=key,
        api_keys_file=keys,
        signing_keys=signing,
        admin_key=admin,
        environment={"OTEL_EXPORTER_OTLP_HEADERS": f"authorization={header}"},
    )
    session = await wire.create(clip.frames[0], clip.box)
    for victim in ("fork server", "lane 0"):
        before = server_processes(wire.server.pid)
        os.kill(before[victim], signal.SIGKILL)
        await until(lambda before=before, victim=victim: replaced(wire, before, victim))  # type: ignore[misc]
        await until_ready(wire, 2)
        assert (await wire.track(session["id"], clip.frames[1])).status_code == 200
        for process in psutil.Process(wire.server.pid).children(recursive=True):
            outcomes = process.environ()
            held = memory(process.pid)
            for secret in (*SECRETS, filed, header):
                assert not [name for name, value in outcomes.items() if secret in value], process.cmdline()
                assert secret.encode() not in held, process.cmdline()
    # Nor can who may look into the front's environment, or a fork of it, read one there.
    environment = Path(f"/proc/{wire.server.pid}/environ").read_bytes()
    assert not [secret for secret in (*SECRETS, header) if secret.encode() in environment]


def replaced(wire: Wire, before: dict[str, int], role: str) -> bool:
    """Whether the process of this role is another one, and all roles are filled."""
    now = server_processes(wire.server.pid)
    return before[role] not in now.values() and now.keys() == before.keys()


def memory(pid: int) -> bytes:
    """All that the process can have written: its private writable pages."""
    held = []
    with open(f"/proc/{pid}/maps") as maps, open(f"/proc/{pid}/mem", "rb", 0) as pages:
        for line in maps:
            span, rights, *_ = line.split()
            if rights.startswith("rw") and rights.endswith("p"):
                start, end = (int(at, 16) for at in span.split("-"))
                pages.seek(start)
                with contextlib.suppress(OSError):  # reserved, or gone by now
                    held.append(pages.read(end - start))
    return b"".join(held)


async def test_a_lane_works_in_one_thread(serve: Serve, clip: Clip) -> None:
    """Also after it has decoded and tracked: a second one would double the time of the processor."""
    require(sys.platform == "linux", "threads are counted in /proc")
    wire = serve()
    session = await wire.create(clip.frames[0], clip.box)
    for frame in clip.frames[1:6]:
        assert (await wire.track(session["id"], frame)).status_code == 200
    (lane,) = (pid for role, pid in server_processes(wire.server.pid).items() if role.startswith("lane"))
    assert len(os.listdir(f"/proc/{lane}/task")) == 1
