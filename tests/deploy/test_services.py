"""Services (systemd, Slurm, containers, Kubernetes) run commands with options that exist."""

import re
import shlex
import subprocess
from pathlib import Path
from string import Template
from typing import Any

import pytest
import yaml
from tests.deploy.commands import DEPLOY, understood

UNITS = sorted((DEPLOY / "systemd").glob("*.service"))
SCRIPTS = sorted((DEPLOY / "slurm").glob("*.sbatch"))
COMPOSE = yaml.safe_load((DEPLOY / "container" / "compose.yaml").read_text())
KUBERNETES = [
    each
    for file in sorted((DEPLOY / "kubernetes").glob("*.yaml"))
    for each in yaml.safe_load_all(file.read_text())
]
ENTRY_POINTS = {"worker": ["qdgrasp-worker"], "head": ["qdgrasp"]}  # of the images
SLURM_VALUES = {"campaign": "many.toml", "folder": "/scratch/many", "port": "7447"}
SLURM_VALUES |= {"QDGRASP_CONNECT": "tls/head:7447", "TMPDIR": "/tmp", "USER": "x"}  # noqa: S108
END_SECONDS = 3.0  # that a worker may take beyond its grace


def unit_settings(unit: Path) -> dict[str, str]:
    """Settings of all sections; no key that is read here is in two of them."""
    return dict(line.split("=", 1) for line in unit.read_text().splitlines() if line and line[0] not in "#[")


def unit_command(unit: Path) -> list[str]:
    text = unit.read_text()
    environment = dict(re.findall(r"^Environment=(\w+)=(.*)$", text, re.M))
    environment |= dict(
        pair.split("=", 1) for line in re.findall(r"^Environment=(.*)$", text, re.M) for pair in line.split()
    )
    line = re.sub(r"%[idCS]", "/var/lib", unit_settings(unit)["ExecStart"])
    line = re.sub(r"\$(?!\{)\w+", "", line)  # variables of any number of words
    return [Template(word).substitute(environment) for word in shlex.split(line)]


def slurm_command(script: Path) -> list[str]:
    """The command behind `srun` and its options."""
    (line,) = re.findall(r"^srun (.*)$", script.read_text().replace("\\\n", " "), re.M)
    words = shlex.split(re.sub(r"\$\{(\w+):-([^}]*)\}", r"\2", line))
    first = next(place for place, word in enumerate(words) if not word.startswith("-"))
    return [Template(word).substitute(SLURM_VALUES) for word in words[first:]]


def container(name: str) -> dict[str, Any]:
    """The only container of a deployment on Kubernetes."""
    (found,) = (
        each for each in KUBERNETES if each["kind"] == "Deployment" and each["metadata"]["name"] == name
    )
    (only,) = found["spec"]["template"]["spec"]["containers"]
    return only | {"pod": found["spec"]["template"]["spec"]}


def pod_options(name: str) -> dict[str, Any]:
    found = container(name)
    return understood([*found.get("command", ["qdgrasp-worker"]), *found["args"]])


@pytest.mark.parametrize("unit", UNITS, ids=lambda unit: unit.stem)
def test_a_unit_runs_its_command_with_the_certificates_of_its_role(unit: Path) -> None:
    name = unit.stem.rstrip("@")
    words = unit_command(unit)
    assert words[0] == f"/opt/qdgrasp/bin/{name}"
    assert understood(words)
    role = name.removeprefix("qdgrasp-")
    loaded = set(re.findall(r"^LoadCredential=([\w.]+)", unit.read_text(), re.M))
    assert {"ca.pem", f"{role}.pem", f"{role}.key"} <= loaded


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.stem)
def test_a_script_of_slurm_is_valid_and_runs_its_command(script: Path) -> None:
    subprocess.run(["/bin/bash", "-n", str(script)], check=True)
    assert understood(slurm_command(script))


@pytest.mark.parametrize("name", [name for name in COMPOSE["services"] if name != "init"])
def test_a_service_of_compose_runs_its_command_with_the_certificates_of_its_role(name: str) -> None:
    service = COMPOSE["services"][name]
    started = service.get("entrypoint") or ENTRY_POINTS[service["build"]["target"]]
    assert understood([*started, *service["command"]])
    assert {"ca.pem", f"{name}.pem", f"{name}.key"} <= set(service["secrets"])
    assert (DEPLOY / "container" / service["build"]["context"]).resolve() == DEPLOY.parent


def test_workers_are_waited_for_longer_than_their_grace() -> None:
    unit = DEPLOY / "systemd" / "qdgrasp-worker@.service"
    script = DEPLOY / "slurm" / "workers.sbatch"
    slurm = dict(re.findall(r"^#SBATCH --([\w-]+)=?(.*)$", script.read_text(), re.M))
    compose, pod = COMPOSE["services"]["worker"], container("qdgrasp-worker")
    graces = [
        (understood(unit_command(unit))["grace"], unit_settings(unit)["TimeoutStopSec"]),
        (understood(slurm_command(script))["grace"], slurm["signal"].partition("@")[2]),
        (
            understood(["qdgrasp-worker", *compose["command"]])["grace"],
            compose["stop_grace_period"].removesuffix("s"),
        ),
        (pod_options("qdgrasp-worker")["grace"], pod["pod"]["terminationGracePeriodSeconds"]),
    ]
    for grace, waited in graces:
        assert grace + END_SECONDS <= float(waited)
