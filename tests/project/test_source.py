"""What no line of the project may do, found by walking its syntax trees."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.conftest import ROOT

VIDEOS = "service/bridges/videos.py"
SOURCES = sorted(path for name in ("mfcmt_core", "service") for path in (ROOT / name).rglob("*.py"))
# They run what they read, or read what may run.
BANNED_MODULES = {
    "pickle", "_pickle", "cPickle", "cloudpickle", "dill", "jsonpickle", "joblib", "marshal", "shelve", "dbm",
    "copyreg", "yaml", "code", "codeop", "telnetlib", "xmlrpc",
}  # fmt: skip
# joblib pickles for the batches of the command line alone, whose workers the user starts: never what somebody sent.
BATCHES = "mfcmt_core/otb/batch.py"
BANNED_CALLS = {"eval", "exec", "compile", "__import__"}
BANNED_METHODS = {"allow_pickle", "system", "popen"}
# Of pickles, multiprocessing makes one for each lane's start, by itself; its pipes and queues would make more.
ALLOWED_FROM_MULTIPROCESSING = {"forkserver", "ForkServerContext", "ForkServerProcess", "get_context"}


def trees() -> Iterator[tuple[Path, ast.AST]]:
    for path in SOURCES:
        yield path.relative_to(ROOT), ast.parse(path.read_text(encoding="utf-8"))


def imported(node: ast.AST) -> set[str]:
    """The top-level modules and the names that a statement imports."""
    if isinstance(node, ast.Import):
        return {alias.name.split(".")[0] for alias in node.names}
    if isinstance(node, ast.ImportFrom) and not node.level:
        return {(node.module or "").split(".")[0]}
    return set()


def test_the_walk_finds_source_files() -> None:
    assert len(SOURCES) > 100


def test_no_code_is_pickled_or_run_from_data() -> None:
    for path, tree in trees():
        for node in ast.walk(tree):
            banned = BANNED_MODULES - ({"joblib"} if str(path) == BATCHES else set())
            assert not imported(node) & banned, f"{path}:{getattr(node, 'lineno', 0)}"
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                assert node.func.id not in BANNED_CALLS, f"{path}:{node.lineno}"
            if isinstance(node, ast.Attribute):
                assert node.attr not in BANNED_METHODS, f"{path}:{node.lineno}"
            if isinstance(node, ast.keyword):
                assert node.arg != "allow_pickle" or _is(node.value, False), f"{path}:{node.value.lineno}"
                assert node.arg != "shell" or _is(node.value, False), f"{path}:{node.value.lineno}"


def test_the_front_and_its_lanes_exchange_bytes_only() -> None:
    """Whatever a lane becomes, the front reads MessagePack from it and nothing else."""
    for path, tree in trees():
        if path.parts[0] != "service":
            continue
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("multiprocessing"):
                assert {alias.name for alias in node.names} <= ALLOWED_FROM_MULTIPROCESSING, f"{path}:{node.lineno}"
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
                allowed = node.value.id != "multiprocessing" or node.attr in ALLOWED_FROM_MULTIPROCESSING
                assert allowed, f"{path}:{node.lineno}"


def test_numpy_arrays_are_read_without_objects() -> None:
    """``np.load`` says so each time, because its default has changed before."""
    for path, tree in trees():
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "load":
                owner = node.func.value
                if isinstance(owner, ast.Name) and owner.id in ("np", "numpy"):
                    keywords = {keyword.arg: keyword.value for keyword in node.keywords}
                    assert "allow_pickle" in keywords, f"{path}:{node.lineno}"
                    assert _is(keywords["allow_pickle"], False), f"{path}:{node.lineno}"


def test_secrets_come_from_the_system_s_generator() -> None:
    """``random`` decides over nothing that must not be guessed."""
    allowed = {"service/server.py", "service/client", "service/load", "service/cluster/node.py"}
    for path, tree in trees():
        if path.parts[0] == "service" and not any(str(path).startswith(name) for name in allowed):
            for node in ast.walk(tree):
                assert "random" not in imported(node), path


def test_the_service_makes_no_outgoing_calls() -> None:
    """No client is imported where calls are served: there is no URL that could be made to be fetched.

    The bridge to Label Studio fetches videos, from hosts that the operator has listed and in one module.
    The Python client, what measures with it, and the exporter of spans to the collector that a setting names
    are no part of that.
    """
    callers = {"httpx2", "httpx", "requests", "urllib3", "aiohttp", "ftplib", "smtplib", "http"}
    elsewhere = ("service/client", "service/load", "service/cli", "service/observability/tracing.py", VIDEOS)
    for path, tree in trees():
        if path.parts[0] == "service" and not str(path).startswith(elsewhere):
            for node in ast.walk(tree):
                assert not imported(node) & callers, f"{path}:{getattr(node, 'lineno', 0)}"
                if isinstance(node, ast.Attribute | ast.Name):
                    assert getattr(node, "attr", getattr(node, "id", "")) not in ("urlopen", "create_connection"), path


@pytest.mark.parametrize("call", ["eval('1')", "import pickle", "from pickle import loads", "import dill as x"])
def test_the_walk_detects_what_it_forbids(call: str) -> None:
    nodes = list(ast.walk(ast.parse(call)))
    calls = {n.func.id for n in nodes if isinstance(n, ast.Call) and isinstance(n.func, ast.Name)}
    assert calls & BANNED_CALLS or any(imported(node) & BANNED_MODULES for node in nodes)


def _is(node: ast.AST, value: object) -> bool:
    return isinstance(node, ast.Constant) and node.value is value
