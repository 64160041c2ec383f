"""The compose file and the Kubernetes manifests: linted, valid by the published schemas, and in agreement."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import kubernetes_validate
import pytest
import yaml

from service.settings import Settings
from tests.conftest import ROOT, require

DOCKER = ROOT / "docker"
KUBERNETES = DOCKER / "kubernetes"
STYLE = (
    "{extends: default, rules: {line-length: {max: 120}, document-start: disable, braces: disable, brackets: disable}}"
)
NO_MANIFESTS = {"kustomization.yaml", "prometheus-adapter-values.yaml"}


def tool(name: str, *arguments: object) -> tuple[int, str]:
    path = Path(sys.executable).with_name(name)
    require(path.exists(), f"no {name}")
    done = subprocess.run([path, *map(str, arguments)], capture_output=True, text=True, check=False)
    return done.returncode, done.stdout + done.stderr


def manifests() -> list[dict[str, Any]]:
    files = [path for path in sorted(KUBERNETES.glob("*.yaml")) if path.name not in NO_MANIFESTS]
    return [one for path in files for one in yaml.safe_load_all(path.read_text())]


def of_kind(kind: str) -> dict[str, Any]:
    return next(one for one in manifests() if one["kind"] == kind)


def test_every_yaml_file_passes_its_lint() -> None:
    assert tool("yamllint", "-s", "-d", STYLE, DOCKER) == (0, "")


def test_the_compose_file_is_valid_by_the_published_schema() -> None:
    assert tool("check-jsonschema", "--builtin-schema", "vendor.compose-spec", DOCKER / "compose.yaml")[0] == 0


def test_what_the_compose_file_mounts_is_there() -> None:
    compose = yaml.safe_load((DOCKER / "compose.yaml").read_text())
    for service in compose["services"].values():
        assert service["read_only"]
        assert service["cap_drop"] == ["ALL"]
        for volume in service["volumes"]:
            source = volume.split(":")[0]
            assert (DOCKER / source).exists() if source.startswith(".") else source in compose["volumes"]
    grace = float(compose["services"]["mfcmt"]["stop_grace_period"].rstrip("s"))
    assert grace > Settings().drain_grace_s + 10


@pytest.mark.parametrize("manifest", manifests(), ids=lambda one: f"{one['kind']}-{one['metadata']['name']}")
def test_manifests_are_valid_by_the_published_schemas(manifest: dict[str, Any]) -> None:
    for version in ("1.30", "1.37"):
        kubernetes_validate.validate(manifest, version, strict=True)


def test_a_misspelt_manifest_is_not_valid() -> None:
    wrong = of_kind("StatefulSet")
    wrong["spec"]["template"]["spec"]["containers"][0]["securityContext"]["readOnlyRootFilesytem"] = True
    with pytest.raises(kubernetes_validate.ValidationError):
        kubernetes_validate.validate(wrong, "1.37", strict=True)


def test_the_kustomization_names_every_manifest() -> None:
    listed = yaml.safe_load((KUBERNETES / "kustomization.yaml").read_text())["resources"]
    assert {*listed, *NO_MANIFESTS} == {path.name for path in KUBERNETES.glob("*.yaml")}


def test_selectors_ports_and_the_metric_agree() -> None:
    stateful = of_kind("StatefulSet")
    labels = stateful["spec"]["template"]["metadata"]["labels"]
    [container] = stateful["spec"]["template"]["spec"]["containers"]
    ports = {port["name"]: port["containerPort"] for port in container["ports"]}
    services = [one for one in manifests() if one["kind"] == "Service"]
    assert stateful["spec"]["serviceName"] in {one["metadata"]["name"] for one in services}
    assert all(one["spec"]["selector"] == labels for one in services)
    assert all(port["targetPort"] in ports for one in services for port in one["spec"]["ports"])
    assert of_kind("PodDisruptionBudget")["spec"]["selector"]["matchLabels"] == labels
    assert of_kind("NetworkPolicy")["spec"]["podSelector"]["matchLabels"] == labels
    scaler = of_kind("HorizontalPodAutoscaler")["spec"]
    assert scaler["scaleTargetRef"]["name"] == stateful["metadata"]["name"]
    assert scaler["metrics"][0]["pods"]["metric"]["name"] in (KUBERNETES / "prometheus-adapter-values.yaml").read_text()


def test_the_pod_is_as_sealed_as_the_image_allows_and_has_time_to_drain() -> None:
    pod = of_kind("StatefulSet")["spec"]["template"]["spec"]
    [container] = pod["containers"]
    user = re.search(r"^USER (\d+):", (DOCKER / "Dockerfile").read_text(), re.M)
    assert user is not None
    assert pod["securityContext"]["runAsUser"] == int(user[1])
    assert container["securityContext"]["readOnlyRootFilesystem"]
    assert not container["securityContext"]["allowPrivilegeEscalation"]
    writable = {mount["mountPath"] for mount in container["volumeMounts"] if not mount.get("readOnly")}
    assert writable == {"/tmp", "/var/lib/mfcmt"}
    # a Service named mfcmt would otherwise put MFCMT_PORT=tcp://... into the environment
    assert pod["enableServiceLinks"] is False
    before = int(container["lifecycle"]["preStop"]["exec"]["command"][1])
    assert pod["terminationGracePeriodSeconds"] > before + Settings().drain_grace_s + 10


def test_what_is_set_are_settings() -> None:
    told = "".join(path.read_text() for path in DOCKER.rglob("*") if path.is_file() and ".py" not in path.suffix)
    known = {f"MFCMT_{name.upper()}" for name in Settings.model_fields}
    assert set(re.findall(r"MFCMT_[A-Z_]+", told)) <= known
