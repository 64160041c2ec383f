"""The Kubernetes manifests: linted, valid by the published schemas, and in agreement with each other and the image."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import kubernetes_validate
import pytest
import yaml

from service.settings import Settings
from tests.conftest import ROOT, require

DOCKER = ROOT / "docker"
KUBERNETES = DOCKER / "kubernetes"
AUTOSCALING = DOCKER / "kubernetes-autoscaling"
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
    files = [*sorted(KUBERNETES.glob("*.yaml")), *sorted(AUTOSCALING.glob("*.yaml"))]
    return [one for path in files if path.name not in NO_MANIFESTS for one in yaml.safe_load_all(path.read_text())]


def of_kubernetes() -> list[dict[str, Any]]:
    """Those whose schema is Kubernetes' own."""
    return [one for one in manifests() if "coreos.com" not in one["apiVersion"]]


def of_kind(kind: str) -> dict[str, Any]:
    return next(one for one in manifests() if one["kind"] == kind)


def test_every_yaml_file_passes_its_lint() -> None:
    assert tool("yamllint", "-s", "-d", STYLE, DOCKER) == (0, "")


@pytest.mark.parametrize("manifest", of_kubernetes(), ids=lambda one: f"{one['kind']}-{one['metadata']['name']}")
def test_manifests_are_valid_by_the_published_schemas(manifest: dict[str, Any]) -> None:
    for version in ("1.30", "1.37"):
        kubernetes_validate.validate(manifest, version, strict=True)


def test_a_misspelt_manifest_is_not_valid() -> None:
    wrong = of_kind("StatefulSet")
    wrong["spec"]["template"]["spec"]["containers"][0]["securityContext"]["readOnlyRootFilesytem"] = True
    with pytest.raises(kubernetes_validate.ValidationError):
        kubernetes_validate.validate(wrong, "1.37", strict=True)


def test_the_kustomizations_name_every_manifest() -> None:
    for folder in (KUBERNETES, AUTOSCALING):
        listed = yaml.safe_load((folder / "kustomization.yaml").read_text())["resources"]
        assert {*listed} - {"../kubernetes"} == {path.name for path in folder.glob("*.yaml")} - NO_MANIFESTS


def test_kubectl_builds_everything_with_the_version_as_tag() -> None:
    require(shutil.which("kubectl"), "no kubectl (Debian: kubernetes-client)")
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    kinds = {}
    for folder in (KUBERNETES, AUTOSCALING):
        done = subprocess.run(["kubectl", "kustomize", folder], capture_output=True, text=True, check=False)
        assert (done.returncode, done.stderr) == (0, "")
        made = list(yaml.safe_load_all(done.stdout))
        kinds[folder] = {one["kind"] for one in made}
        [stateful] = [one for one in made if one["kind"] == "StatefulSet"]
        [container] = stateful["spec"]["template"]["spec"]["containers"]
        assert container["image"] == f"mfcmt:{version}"
    # what is applied without an operator has nothing that only an operator knows
    assert kinds[AUTOSCALING] - kinds[KUBERNETES] == {"HorizontalPodAutoscaler", "PodMonitor"}


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
    adapter = yaml.safe_load((AUTOSCALING / "prometheus-adapter-values.yaml").read_text())["rules"]
    made = {(kind, rule["name"]["as"]) for kind, rules in adapter.items() for rule in rules}
    asked = {("custom", one["pods"]["metric"]["name"]) for one in scaler["metrics"] if one["type"] == "Pods"}
    asked |= {("external", one["external"]["metric"]["name"]) for one in scaler["metrics"] if one["type"] == "External"}
    assert made == asked


def test_prometheus_sends_the_key_that_the_pods_require() -> None:
    stateful, monitor = of_kind("StatefulSet"), of_kind("PodMonitor")["spec"]
    pod = stateful["spec"]["template"]
    [container] = pod["spec"]["containers"]
    [wanted] = [one["valueFrom"]["secretKeyRef"] for one in container["env"] if one["name"] == "MFCMT_ADMIN_KEY"]
    [endpoint] = monitor["podMetricsEndpoints"]
    assert endpoint["authorization"]["credentials"] == wanted
    assert endpoint["port"] in {port["name"] for port in container["ports"]}
    assert monitor["selector"]["matchLabels"] == pod["metadata"]["labels"]
    # the alerts ask for job="mfcmt"
    assert pod["metadata"]["labels"][monitor["jobLabel"]] == "mfcmt"
    # these would have Prometheus ask once more, without a key
    assert "annotations" not in pod["metadata"]


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


def test_every_variable_is_a_setting() -> None:
    everything = "".join(path.read_text() for path in DOCKER.rglob("*") if path.is_file() and ".py" not in path.suffix)
    known = {f"MFCMT_{name.upper()}" for name in Settings.model_fields} | {"MFCMT_VERSION"}
    assert set(re.findall(r"MFCMT_[A-Z_]+", everything)) <= known
