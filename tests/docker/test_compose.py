"""The compose file: valid for the real program, complete, and without what it refuses only when it starts."""

from __future__ import annotations

import json
import os
import re
import subprocess
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml
from uvicorn.middleware.proxy_headers import _TrustedHosts

from service.settings import Settings
from tests.conftest import ROOT, require
from tests.docker.test_manifests import tool
from tests.docs.tables import NOT_PASSED_ON, VARIABLES, compose_variables

DOCKER = ROOT / "docker"
COMPOSE = DOCKER / "compose.yaml"
CACHE = Path(os.environ.get("XDG_CACHE_HOME", "/var/tmp")) / "mfcmt-compose"
KEYS = dict.fromkeys(("MFCMT_API_KEYS", "MFCMT_ADMIN_KEY", "GRAFANA_PASSWORD"), "0123456789abcdef")
MIB = 1024 * 1024
# the front, the fork server, and kept results
ALL_ELSE = 512 * MIB


@pytest.fixture(scope="module")
def program() -> str:
    """Docker's compose, which Debian has too."""
    done = subprocess.run([ROOT / ".ci/compose", CACHE], capture_output=True, text=True, check=False)
    require(done.returncode == 0, f"no docker-compose: {done.stderr[-200:]}")
    return done.stdout.strip()


def understood(program: str, *words: str, **variables: str) -> dict[str, Any]:
    """The file as the program understands it with these variables and no others."""
    command = [program, "-f", COMPOSE, "--env-file", "/dev/null", *words, "config", "--format", "json"]
    env = {"PATH": os.environ["PATH"]} | variables
    done = subprocess.run(command, env=env, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    printed: dict[str, Any] = json.loads(done.stdout)
    return printed


def refused_at_the_start(compose: dict[str, Any]) -> list[str]:
    """What compose accepts as a file, and refuses when it makes the containers."""
    wrong = []
    for name, service in compose["services"].items():
        for kind in ("secrets", "configs"):
            for one in service.get(kind, []):
                source = compose[kind][one["source"] if isinstance(one, dict) else one]
                if service.get("read_only") and "file" not in source:
                    wrong.append(f"{name}: {kind} of a container that is read-only come from files alone")
        ports = service.get("ports", [])
        if ports and service.get("network_mode") == "host":
            wrong.append(f"{name}: ports with the host's network")
        if service.get("container_name") and service.get("deploy", {}).get("replicas", 1) > 1:
            wrong.append(f"{name}: replicas under one name")
    return wrong


def test_the_file_is_valid_by_the_published_schema() -> None:
    assert tool("check-jsonschema", "--builtin-schema", "vendor.compose-spec", COMPOSE)[0] == 0


def test_docker_compose_accepts_the_file(program: str) -> None:
    assert set(understood(program, **KEYS)["services"]) == {"mfcmt", "prometheus", "grafana"}
    assert set(understood(program, "--profile", "https", **KEYS)["services"]) == {
        "mfcmt",
        "prometheus",
        "grafana",
        "caddy",
    }


def test_a_missing_key_is_named_with_the_script_that_makes_it(program: str) -> None:
    for name in KEYS:
        some = {one: key for one, key in KEYS.items() if one != name}
        command = [program, "-f", COMPOSE, "--env-file", "/dev/null", "config", "--quiet"]
        env = {"PATH": os.environ["PATH"]} | some
        done = subprocess.run(command, env=env, capture_output=True, text=True, check=False)
        assert done.returncode != 0
        assert name in done.stderr
        assert "docker/env.sh" in done.stderr


def test_nothing_is_refused_when_the_containers_are_made() -> None:
    assert refused_at_the_start(yaml.safe_load(COMPOSE.read_text())) == []


def test_a_secret_in_the_environment_of_a_sealed_container_is_detected() -> None:
    compose = yaml.safe_load(COMPOSE.read_text())
    compose["secrets"]["admin_key"] = {"environment": "MFCMT_ADMIN_KEY"}
    assert len(refused_at_the_start(compose)) == 1


def test_every_setting_reaches_the_service(program: str) -> None:
    given = {f"MFCMT_{name.upper()}": f"value of {name}" for name in Settings.model_fields} | {"MFCMT_PORT": "9001"}
    service = understood(program, **(given | KEYS | {"MFCMT_VERSION": "7.8.9"}))["services"]["mfcmt"]
    inside = service["environment"]
    # Where it listens and keeps its state is the image's, and HTTPS is Caddy's.
    fixed = {f"MFCMT_{name.upper()}" for name in ("host", "port", "state_dir", "tls_certificate", "tls_key")}
    assert {name: inside.get(name) for name in given if name not in fixed} == {
        name: value for name, value in (given | KEYS).items() if name.startswith("MFCMT_") and name not in fixed
    }
    # the image says these; MFCMT_PORT is the one on this machine
    assert fixed & set(inside) == set()
    assert service["ports"][0]["published"] == "9001"
    assert service["image"] == "mfcmt:7.8.9"
    assert service["build"]["args"]["VERSION"] == "7.8.9"


def test_unset_variables_leave_the_service_its_defaults(program: str) -> None:
    inside = understood(program, **KEYS)["services"]["mfcmt"]["environment"]
    printed = {name for name, value in inside.items() if value is not None and name.startswith("MFCMT_")}
    assert printed == {"MFCMT_API_KEYS", "MFCMT_ADMIN_KEY", "MFCMT_MAX_LANE_RSS_BYTES"}


def test_the_list_of_variables_is_that_of_the_settings() -> None:
    found = VARIABLES.search(COMPOSE.read_text())
    assert found is not None
    assert found[2] == compose_variables(), "run: make guide"
    assert set(Settings.model_fields) >= NOT_PASSED_ON


def test_the_example_file_names_existing_variables(program: str) -> None:
    lines = re.findall(r"^(?:# )?([A-Z_]+)=(.*)$", (DOCKER / ".env.example").read_text(), re.M)
    read = set(re.findall(r"\$\{([A-Z_]+)", COMPOSE.read_text()))
    settings = {f"MFCMT_{name.upper()}" for name in Settings.model_fields}
    assert {name for name, _ in lines} <= read | settings
    assert set(KEYS) <= {name for name, value in lines if value == ""}
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    printed = dict(lines)
    assert printed["MFCMT_VERSION"] == version
    # the comments give the defaults where there are any
    plain = understood(program, **KEYS)["services"]["mfcmt"]
    assert plain["image"] == f"mfcmt:{version}"
    assert plain["environment"]["MFCMT_MAX_LANE_RSS_BYTES"] == printed["MFCMT_MAX_LANE_RSS_BYTES"]
    Settings(
        **{
            name.removeprefix("MFCMT_").lower(): value
            for name, value in lines
            if value and name in settings and name != "MFCMT_API_KEYS"
        }
    )


def test_the_script_makes_valid_keys_and_keeps_existing_ones(tmp_path: Path, program: str) -> None:
    for name in ("env.sh", ".env.example", "compose.yaml"):
        (tmp_path / name).write_bytes((DOCKER / name).read_bytes())
    printed = []
    for _ in range(2):
        subprocess.run(["sh", tmp_path / "env.sh"], check=True, capture_output=True)
        printed.append((tmp_path / ".env").read_text())
    assert printed[0] == printed[1]
    assert (tmp_path / ".env").stat().st_mode & 0o077 == 0
    made = dict(re.findall(r"^([A-Z_]+)=(.+)$", printed[0], re.M))
    assert len({made[name] for name in (*KEYS, "MFCMT_SIGNING_KEYS")}) == 4
    assert (tmp_path / "admin-key").read_text() == made["MFCMT_ADMIN_KEY"]
    Settings(host="0.0.0.0", api_keys=made["MFCMT_API_KEYS"], signing_keys=made["MFCMT_SIGNING_KEYS"])
    command = [program, "-f", tmp_path / "compose.yaml", "config", "--quiet"]
    done = subprocess.run(command, env={"PATH": os.environ["PATH"]}, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_only_a_proxy_in_docker_s_networks_is_trusted(program: str) -> None:
    inside = understood(program, **KEYS)["services"]["mfcmt"]["environment"]
    believed = _TrustedHosts(inside["FORWARDED_ALLOW_IPS"])
    assert all(address in believed for address in ("127.0.0.1", "172.18.0.3", "192.168.16.1", "10.88.0.1"))
    assert "203.0.113.9" not in believed


def test_keys_are_never_committed() -> None:
    ignored = (ROOT / ".gitignore").read_text().splitlines()
    assert {"/docker/.env", "/docker/admin-key"} <= set(ignored)


def test_mounted_files_exist_and_containers_are_sealed() -> None:
    compose = yaml.safe_load(COMPOSE.read_text())
    for service in compose["services"].values():
        assert service["read_only"]
        assert service["cap_drop"] == ["ALL"]
        for volume in service["volumes"]:
            source = volume.split(":")[0]
            assert (DOCKER / source).exists() if source.startswith(".") else source in compose["volumes"]
    grace = float(compose["services"]["mfcmt"]["stop_grace_period"].rstrip("s"))
    assert grace > Settings().drain_grace_s + 10


def test_lanes_and_front_stay_below_the_memory_limit(program: str) -> None:
    service = understood(program, **KEYS)["services"]["mfcmt"]
    lane = int(service["environment"]["MFCMT_MAX_LANE_RSS_BYTES"])
    settings = Settings()
    rest = settings.max_recovery_bytes + settings.max_upload_bytes + ALL_ELSE
    assert float(service["cpus"]) * lane + rest <= int(service["mem_limit"])
