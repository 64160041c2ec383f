"""The Kubernetes manifests: linted, valid by the published schemas, and in agreement with each other and the image."""

from __future__ import annotations

import functools
import os
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
CLUSTER = DOCKER / "kubernetes-cluster"
AUTOSCALING = DOCKER / "kubernetes-autoscaling"
SCALER = DOCKER / "kubernetes-components/autoscaling"
OVERLAYS = sorted(path.parent for path in DOCKER.glob("kubernetes*/kustomization.yaml"))
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
    files = [*sorted(KUBERNETES.glob("*.yaml")), *sorted(SCALER.glob("*.yaml"))]
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
    for folder in (KUBERNETES, SCALER):
        listed = yaml.safe_load((folder / "kustomization.yaml").read_text())["resources"]
        assert {*listed} == {path.name for path in folder.glob("*.yaml")} - NO_MANIFESTS


@functools.cache
def built(folder: Path) -> dict[str, dict[str, Any]]:
    """What ``kubectl apply -k`` sends, by kind and name."""
    require(shutil.which("kubectl"), "no kubectl (Debian: kubernetes-client)")
    done = subprocess.run(["kubectl", "kustomize", folder], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    return {f"{one['kind']} {one['metadata']['name']}": one for one in yaml.safe_load_all(done.stdout)}


def container_of(folder: Path) -> dict[str, Any]:
    [workload] = [one for one in built(folder).values() if one["kind"] in ("StatefulSet", "Deployment")]
    [container] = workload["spec"]["template"]["spec"]["containers"]
    return {**container, "env": {one["name"]: one for one in container["env"]}}


@pytest.mark.parametrize("folder", OVERLAYS, ids=lambda folder: folder.name)
def test_kubectl_builds_everything_with_the_version_as_tag(folder: Path) -> None:
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert container_of(folder)["image"] == f"mfcmt:{version}"
    for one in built(folder).values():
        if "coreos.com" not in one["apiVersion"]:
            for schema in ("1.30", "1.37"):
                kubernetes_validate.validate(one, schema, strict=True)
    # what is applied without an operator has nothing that only an operator knows
    scaled = {"HorizontalPodAutoscaler mfcmt", "PodMonitor mfcmt"}
    assert built(folder).keys() & scaled == (scaled if "autoscaling" in folder.name else set())


def test_nodes_of_a_cluster_are_a_deployment_without_a_volume_of_their_own() -> None:
    made = built(CLUSTER)
    assert "StatefulSet mfcmt" not in made
    spec = made["Deployment mfcmt"]["spec"]
    assert {"volumeClaimTemplates", "serviceName", "podManagementPolicy"}.isdisjoint(spec)
    assert all("persistentVolumeClaim" not in volume for volume in spec["template"]["spec"]["volumes"])
    assert spec["strategy"]["rollingUpdate"] == {"maxSurge": 1, "maxUnavailable": 0}
    env = container_of(CLUSTER)["env"]
    assert env["MFCMT_STATE_DIR"]["value"] == ""
    assert env["MFCMT_STORE"]["valueFrom"]["secretKeyRef"] == {"name": "mfcmt", "key": "store"}
    assert list(env).index("POD_IP") < list(env).index("MFCMT_NODE_URL")
    assert "sessionAffinity" not in made["Service mfcmt"]["spec"]


def test_a_node_of_a_cluster_is_named_as_the_dns_of_its_service_names_it() -> None:
    shell, flag, script = container_of(CLUSTER)["command"]
    said = script.replace("exec mfcmt serve", 'echo "$MFCMT_NODE"')
    assert said != script
    for address, name in (("10.1.2.3", "10-1-2-3"), ("fd00::12", "fd00--12")):
        done = subprocess.run(
            [shell, flag, said], env={**os.environ, "POD_IP": address}, capture_output=True, text=True
        )
        assert done.stdout == f"{name}\n"


def test_a_cluster_may_reach_its_names_its_nodes_and_its_store_alone() -> None:
    rules = built(CLUSTER)["NetworkPolicy mfcmt"]["spec"]["egress"]
    assert [port["port"] for rule in rules for port in rule["ports"]] == [53, 53, 8000, 6379]
    assert built(KUBERNETES)["NetworkPolicy mfcmt"]["spec"].get("egress", []) == []


def test_overlays_without_keys_have_no_key_and_say_so() -> None:
    for folder in OVERLAYS:
        container = container_of(folder)
        without = folder.name.endswith("-without-keys")
        assert ("MFCMT_API_KEYS_FILE" not in container["env"]) == without
        assert ("MFCMT_ALLOW_UNAUTHENTICATED" in container["env"]) == without
        assert ("keys" not in {mount["name"] for mount in container["volumeMounts"]}) == without


def test_the_autoscaler_of_a_cluster_scales_its_deployment_by_the_mean_alone() -> None:
    scaler = built(DOCKER / "kubernetes-cluster-autoscaling")["HorizontalPodAutoscaler mfcmt"]["spec"]
    assert scaler["scaleTargetRef"] == {"apiVersion": "apps/v1", "kind": "Deployment", "name": "mfcmt"}
    assert [one["type"] for one in scaler["metrics"]] == ["Pods"]


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
