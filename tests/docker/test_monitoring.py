"""Dashboard, alert rules and autoscaler against a live service, with a real Prometheus between them."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx2
import pytest
import yaml

from service.client import Client, Problem
from service.load.clips import sample
from service.load.own import OwnServer, free_port
from tests.conftest import ROOT, require

ADMIN = "an-admin-key-for-prometheus"
PROMETHEUS = ROOT / "docker/prometheus"
DASHBOARD = json.loads((ROOT / "docker/grafana/dashboards/mfcmt.json").read_text())
START_S = 60


def queries() -> list[tuple[str, str]]:
    """The title and expression of everything that the dashboard shows, with its variables filled in."""
    found = [(panel["title"], target["expr"]) for panel in DASHBOARD["panels"] for target in panel.get("targets", [])]
    return [(t, e.replace("$__rate_interval", "10s").replace("$instance", ".+")) for t, e in found]


def alerts() -> list[dict[str, Any]]:
    groups = yaml.safe_load((PROMETHEUS / "alerts.yml").read_text())["groups"]
    return [rule for group in groups for rule in group["rules"]]


def adapter_rules() -> list[dict[str, Any]]:
    """What the autoscaler goes by."""
    path = ROOT / "docker/kubernetes-autoscaling/prometheus-adapter-values.yaml"
    return [rule for rules in yaml.safe_load(path.read_text())["rules"].values() for rule in rules]


def names(text: str) -> set[str]:
    return set(re.findall(r"\b(?:mfcmt|process|python)_\w+", text))


@dataclass
class Watched:
    """A service with a little of everything in its counters, and the Prometheus that scrapes it."""

    server: OwnServer
    prometheus: str

    def ask(self, expression: str) -> list[dict[str, Any]]:
        answer = httpx2.get(f"{self.prometheus}/api/v1/query", params={"query": expression}, timeout=30).json()
        assert answer["status"] == "success", (expression, answer)
        result: list[dict[str, Any]] = answer["data"]["result"]
        return result


def exercise(url: str) -> None:
    clip = sample(20)
    with Client(url) as client:
        session = client.create(clip.frames[0], box=clip.box)
        session.track(clip.frames[1])
        with pytest.raises(Problem):
            session.track(b"no image")
        list(session.stream(clip.frames[2:12], mode="lossless"))
        list(session.stream(clip.frames[12:], mode="latest"))
        session.snapshot()
        session.close()
        client.create(clip.frames[0], box=clip.box)


@pytest.fixture(scope="module")
def watched(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Watched]:
    require(shutil.which("prometheus"), "no prometheus")
    folder = tmp_path_factory.mktemp("prometheus")
    config = yaml.safe_load((PROMETHEUS / "prometheus.yml").read_text())
    (folder / "key").write_text(ADMIN)
    shutil.copy(PROMETHEUS / "alerts.yml", folder)
    with OwnServer(lanes=1, admin_key=ADMIN) as server:
        config["global"] = dict.fromkeys(config["global"], "1s")
        [job] = config["scrape_configs"]
        job["authorization"]["credentials_file"] = str(folder / "key")
        job["static_configs"][0]["targets"] = [f"127.0.0.1:{server.port}"]
        (folder / "prometheus.yml").write_text(yaml.safe_dump(config))
        port = free_port()
        words = [
            "prometheus",
            f"--config.file={folder}/prometheus.yml",
            f"--storage.tsdb.path={folder}/data",
            f"--web.listen-address=127.0.0.1:{port}",
        ]
        with (folder / "log").open("wb") as log:
            process = subprocess.Popen(words, stdout=log, stderr=log)
        try:
            watched = Watched(server, f"http://127.0.0.1:{port}")
            wait(lambda: up(watched), process, folder / "log")
            # A rate needs two values: work before, between and after scrapes.
            seen = 0
            while not seen or watched.ask("rate(mfcmt_frame_total_seconds_count[10s]) > 0") == []:
                exercise(server.url)
                seen += 1
                assert seen < 100
            yield watched
        finally:
            process.terminate()
            process.wait(20)


def up(watched: Watched) -> bool:
    try:
        return any(one["value"][1] == "1" for one in watched.ask('up{job="mfcmt"}'))
    except (httpx2.TransportError, json.JSONDecodeError):
        return False


def wait(condition: Any, process: subprocess.Popen[bytes], log: Path) -> None:
    give_up = time.monotonic() + START_S
    while not condition():
        assert process.poll() is None, log.read_text()
        assert time.monotonic() < give_up, log.read_text()
        time.sleep(0.1)


def test_rules_and_configuration_are_valid_and_pass_their_tests() -> None:
    require(shutil.which("promtool"), "no promtool (Debian: prometheus)")
    for check in (
        ["check", "rules", "alerts.yml"],
        ["check", "config", "--syntax-only", "prometheus.yml"],
        ["test", "rules", "alerts.test.yml"],
    ):
        done = subprocess.run(["promtool", *check], cwd=PROMETHEUS, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr


def test_every_alert_is_explained_in_the_guide() -> None:
    guide = (ROOT / "docs/operations.md").read_text()
    assert [rule["alert"] for rule in alerts() if f"`{rule['alert']}`" not in guide] == []


def test_every_metric_name_is_one_of_the_service(watched: Watched) -> None:
    text = httpx2.get(f"{watched.server.url}/metrics", headers={"Authorization": f"Bearer {ADMIN}"}).text
    exported = {re.split(r"[{ ]", line)[0] for line in text.splitlines() if not line.startswith("#")}
    asked = set()
    for _, expression in queries():
        asked |= names(expression)
    for rule in alerts():
        asked |= names(rule["expr"])
    for rule in adapter_rules():
        asked |= names(rule["seriesQuery"] + rule["metricsQuery"])
    assert len(asked) > 25
    assert asked - exported == set()


def test_codes_and_reasons_that_alerts_look_for_exist() -> None:
    from service.protocol.problems import CATALOGUE

    for rule in alerts():
        for values in re.findall(r'(?:code|reason)=~?"([^"]+)"', rule["expr"]):
            assert set(values.split("|")) <= {*CATALOGUE, "superseded"}


def test_every_panel_shows_something(watched: Watched) -> None:
    assert [title for title, expression in queries() if not watched.ask(expression)] == []


def test_the_autoscaler_uses_the_fraction_of_occupied_places(watched: Watched) -> None:
    [part] = watched.ask("mfcmt_sessions_active / mfcmt_sessions_capacity")
    for rule in adapter_rules():
        query = rule["metricsQuery"].replace("<<.LabelMatchers>>", 'job="mfcmt"').replace("<<.GroupBy>>", "job")
        [found] = watched.ask(query)
        assert float(found["value"][1]) == pytest.approx(float(part["value"][1]), abs=0.2)


def test_no_alert_fires_on_a_healthy_service(watched: Watched) -> None:
    rules = httpx2.get(f"{watched.prometheus}/api/v1/rules", timeout=30).json()["data"]["groups"][0]["rules"]
    assert len(rules) == len(alerts())
    assert [rule["name"] for rule in rules if rule["health"] == "err"] == []
    assert watched.ask('ALERTS{severity="critical"}') == []
