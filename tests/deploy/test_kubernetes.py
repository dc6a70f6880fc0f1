from pathlib import Path
from typing import Any

import pytest
import yaml
from tests.deploy.commands import DEPLOY, understood

from qdgrasp_protocol.session import parse_endpoints

FILES = sorted((DEPLOY / "kubernetes").glob("*.yaml"))
OBJECTS = [each for file in FILES for each in yaml.safe_load_all(file.read_text())]
DEPLOYMENTS = {each["metadata"]["name"]: each for each in OBJECTS if each["kind"] == "Deployment"}
SERVICES = {each["metadata"]["name"]: each for each in OBJECTS if each["kind"] == "Service"}
UNITS = {"Mi": 1, "Gi": 1024}


def pod(name: str) -> dict[str, Any]:
    found: dict[str, Any] = DEPLOYMENTS[name]["spec"]["template"]["spec"]
    return found


def container(name: str) -> dict[str, Any]:
    (found,) = pod(name)["containers"]
    return found


def options(name: str) -> dict[str, Any]:
    """What the command of a deployment makes of its arguments."""
    started = container(name)
    return understood([*started.get("command", ["qdgrasp-worker"]), *started["args"]])


def megabytes(quantity: str) -> float:
    return float(quantity[:-2]) * UNITS[quantity[-2:]] * 1.048576


def test_everything_is_named_and_of_a_kind() -> None:
    assert {each["kind"] for each in OBJECTS} == {"Deployment", "Service", "HorizontalPodAutoscaler"}
    assert set(DEPLOYMENTS) == {"qdgrasp-router", "qdgrasp-worker"}


@pytest.mark.parametrize("name", DEPLOYMENTS)
def test_a_pod_reads_its_certificates_where_its_command_looks_for_them(name: str) -> None:
    mounts = {mount["mountPath"]: mount["name"] for mount in container(name)["volumeMounts"]}
    volumes = {volume["name"]: volume for volume in pod(name)["volumes"]}
    secret = volumes[mounts[str(options(name)["security"])]]["secret"]
    assert secret["secretName"] == name
    assert secret["defaultMode"] & 0o037 == 0  # only its own group reads it


@pytest.mark.parametrize("name", DEPLOYMENTS)
def test_a_pod_has_no_rights_that_it_does_not_need(name: str) -> None:
    assert pod(name)["securityContext"]["runAsNonRoot"] is True
    assert pod(name)["automountServiceAccountToken"] is False
    context = container(name)["securityContext"]
    assert context["readOnlyRootFilesystem"] is True
    assert context["allowPrivilegeEscalation"] is False
    assert context["capabilities"] == {"drop": ["ALL"]}


@pytest.mark.parametrize("name", DEPLOYMENTS)
def test_labels_lead_to_the_pods(name: str) -> None:
    spec = DEPLOYMENTS[name]["spec"]
    assert spec["selector"]["matchLabels"].items() <= spec["template"]["metadata"]["labels"].items()


def test_workers_find_the_router_by_the_name_of_its_service() -> None:
    (endpoint,) = parse_endpoints(options("qdgrasp-worker")["connect"])
    service = SERVICES[endpoint.host]["spec"]
    assert service["selector"].items() <= (
        DEPLOYMENTS["qdgrasp-router"]["spec"]["template"]["metadata"]["labels"].items()
    )
    (port,) = service["ports"]
    (listens,) = container("qdgrasp-router")["ports"]
    (heard,) = parse_endpoints(options("qdgrasp-router")["listen"])
    assert endpoint.port == port["port"] == listens["containerPort"] == heard.port
    assert port["targetPort"] == listens["name"]


def test_a_worker_is_waited_for_longer_than_its_grace_and_nothing_runs_before_its_end() -> None:
    assert options("qdgrasp-worker")["grace"] + 3 <= pod("qdgrasp-worker")["terminationGracePeriodSeconds"]
    assert "lifecycle" not in container("qdgrasp-worker")


def test_a_worker_has_the_memory_that_its_simulator_may_keep() -> None:
    limit = container("qdgrasp-worker")["resources"]["limits"]["memory"]
    assert megabytes(limit) >= options("qdgrasp-worker")["memory"] * 1.2


def test_a_worker_writes_only_where_it_is_given_a_place() -> None:
    writable = {
        Path(m["mountPath"]) for m in container("qdgrasp-worker")["volumeMounts"] if not m.get("readOnly")
    }
    assert options("qdgrasp-worker")["cache"] in writable
    assert Path("/tmp") in writable  # noqa: S108 - the pod's own


def test_what_scales_is_what_there_is() -> None:
    (scaler,) = (each for each in OBJECTS if each["kind"] == "HorizontalPodAutoscaler")
    assert scaler["spec"]["scaleTargetRef"]["name"] in DEPLOYMENTS
