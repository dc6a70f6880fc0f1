"""Container images and their lock files."""

import json
import re
import subprocess
import sys
import tomllib
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import pytest
import yaml
from msgspec import structs
from packaging.requirements import Requirement
from packaging.version import Version
from tests.deploy.commands import COMMANDS, DEPLOY, understood
from tests.tools.monitor.sample_jobs import values, views

from qdgrasp_protocol.extras import EXTRAS
from qdgrasp_protocol.session import parse_endpoints
from qdgrasp_tools.monitor.prometheus import exposition
from qdgrasp_worker.device import DEVICE_MODULE

ROOT = DEPLOY.parent
CONTAINER = DEPLOY / "container"
IMAGES = {"worker": ["qdgrasp-worker"], "head": ["qdgrasp"]}
"""The command that each image starts."""
SERVICES = ("router", "coordinator", "recorder", "worker")
SECRETS = "/run/secrets"


def instructions() -> list[tuple[str, str]]:
    """The instructions of the Containerfile with their arguments."""
    text = re.sub(r"^#.*\n", "", (CONTAINER / "Containerfile").read_text(), flags=re.MULTILINE)
    lines = text.replace("\\\n", " ").splitlines()
    return [(verb, rest.strip()) for verb, _, rest in (line.partition(" ") for line in lines if line)]


def commands() -> list[str]:
    return [part.strip() for verb, rest in instructions() if verb == "RUN" for part in rest.split("&&")]


def stages() -> dict[str, list[tuple[str, str]]]:
    found: dict[str, list[tuple[str, str]]] = {}
    for verb, rest in instructions():
        if verb == "FROM":
            found[rest.split()[2]] = []
        if found:
            list(found.values())[-1].append((verb, rest))
    return found


def lineage(stage: str) -> list[tuple[str, str]]:
    """The instructions of a stage and of those that it stands on."""
    own = stages()[stage]
    base = own[0][1].split()[0]
    return [*(lineage(base) if base in stages() else []), *own]


def is_sent(path: str) -> bool:
    """True if an image may be built of a file."""
    lines = (ROOT / ".containerignore").read_text().splitlines()
    kept = [line[1:] for line in lines if line.startswith("!")]
    return any(path == each or path.startswith(f"{each}/") or fnmatch(path, each) for each in kept)


def compose() -> Any:
    return yaml.safe_load((CONTAINER / "compose.yaml").read_text())


def test_what_is_copied_is_there_and_sent_to_the_builder_and_every_room_of_the_wheel_is() -> None:
    lines = [rest.split() for verb, rest in instructions() if verb == "COPY" and "--from" not in rest]
    copied = [source for words in lines for source in words[:-1]]
    assert len(copied) > 8
    assert [source for source in copied if not (ROOT / source).exists() or not is_sent(source)] == []
    assert {"assets", "coordinator", "protocol", "worker", "pyproject.toml"} <= set(copied)


def test_nothing_is_installed_that_is_not_locked() -> None:
    installs = [part for part in commands() if "pip" in part and "install" in part]
    assert len(installs) == 5
    assert all("--require-hashes" in each or "--no-index" in each for each in installs)


@pytest.mark.parametrize("image", IMAGES)
def test_an_image_starts_a_command_as_nobody_in_particular(image: str) -> None:
    steps = dict(lineage(image))
    assert json.loads(steps["ENTRYPOINT"]) == IMAGES[image]
    assert set(IMAGES[image]) <= set(COMMANDS)
    assert int(steps["USER"].partition(":")[0]) > 0
    assert steps["STOPSIGNAL"] == "SIGTERM"


def test_an_image_is_tried_where_it_is_built() -> None:
    tried = [part.split() for part in commands() if part.startswith("/opt/qdgrasp/bin/")]
    assert [Path(words[0]).name for words in tried] == ["qdgrasp-worker", "qdgrasp"]
    assert all(understood(words) is not None for words in tried)


def test_builders_of_both_kinds_leave_the_same_out() -> None:
    assert (ROOT / ".dockerignore").read_text() == (ROOT / ".containerignore").read_text()


@pytest.mark.parametrize("name", SERVICES)
def test_a_service_starts_a_command_with_options_that_it_has(name: str) -> None:
    service = compose()["services"][name]
    started = service.get("entrypoint") or IMAGES[service["build"]["target"]]
    assert str(understood([*started, *service["command"]])["security"]) == SECRETS


@pytest.mark.parametrize("name", SERVICES)
def test_a_service_has_the_certificates_of_its_role_and_no_others(name: str) -> None:
    whole = compose()
    needed = {"ca.pem", f"{name}.pem", f"{name}.key"} | ({"router.json5"} if name == "router" else set())
    assert set(whole["services"][name]["secrets"]) == needed
    assert all(whole["secrets"][each]["file"].endswith(f"}}/{each}") for each in needed)


@pytest.mark.parametrize("name", SERVICES)
def test_a_service_may_write_only_where_it_is_given_a_place(name: str) -> None:
    service = compose()["services"][name]
    assert service["read_only"] is True
    assert service["cap_drop"] == ["ALL"]
    assert service["security_opt"] == ["no-new-privileges:true"]
    assert service["build"]["target"] in stages()
    assert (CONTAINER / service["build"]["context"]).resolve() == ROOT


def test_coordinator_and_recorder_are_of_one_job_and_an_impossible_one_is_not_started_for_ever() -> None:
    services = compose()["services"]
    jobs = {understood([f"qdgrasp-{name}", *services[name]["command"]])["job"] for name in SERVICES[1:3]}
    assert len(jobs) == 1
    kind, _, most = services["coordinator"]["restart"].partition(":")
    assert (kind, int(most) > 0) == ("on-failure", True)


def test_workers_are_waited_for_longer_than_their_grace() -> None:
    worker = compose()["services"]["worker"]
    grace = understood(["qdgrasp-worker", *worker["command"]])["grace"]
    assert grace + 3 <= float(worker["stop_grace_period"].removesuffix("s"))


def test_records_outlive_their_containers() -> None:
    whole = compose()
    (volume,) = whole["services"]["recorder"]["volumes"]
    name, _, place = volume.partition(":")
    assert name in whole["volumes"]
    recorder = understood(["qdgrasp-recorder", *whole["services"]["recorder"]["command"]])
    assert Path(place) in recorder["out"].parents


PROJECT = tomllib.loads((DEPLOY.parent / "pyproject.toml").read_text())
EVERY = [
    *PROJECT["project"]["dependencies"],
    *(each for name in EXTRAS if name != "gpu" for each in PROJECT["project"]["optional-dependencies"][name]),
]
"""Requirement of the head's image: the package with its extra `all`."""
LOCKS = ("requirements.txt", "worker.txt", "build.txt")
ENTRY = re.compile(
    r"^([A-Za-z0-9_.-]+)==(\S+) \\\n((?:    --hash=sha256:[0-9a-f]{64}(?: \\)?\n)+)", re.MULTILINE
)


def pins(name: str) -> dict[str, Version]:
    """The packages of a lock file, by their names."""
    return {package: Version(version) for package, version, _ in ENTRY.findall(read(name))}


def read(name: str) -> str:
    return (CONTAINER / name).read_text()


def asked(name: str) -> list[Requirement]:
    lines = (line for line in read(name).splitlines() if line and not line.startswith("#"))
    return [Requirement(line) for line in lines]


@pytest.mark.parametrize("name", LOCKS)
def test_every_line_of_a_lock_is_one_version_with_its_hashes(name: str) -> None:
    rest = re.sub(r"^ *#.*\n", "", ENTRY.sub("", read(name)), flags=re.MULTILINE)
    assert rest.strip() == ""
    assert pins(name)


@pytest.mark.parametrize(
    ("name", "needed"),
    [
        ("requirements.txt", [Requirement(text) for text in EVERY]),
        ("worker.txt", asked("worker.in")),
        ("build.txt", asked("build.in")),
    ],
    ids=LOCKS,
)
def test_a_lock_satisfies_what_is_needed(name: str, needed: list[Requirement]) -> None:
    locked = pins(name)
    assert [
        each for each in needed if each.name not in locked or locked[each.name] not in each.specifier
    ] == []


def test_what_builds_an_image_is_what_builds_the_package() -> None:
    assert asked("build.in") == [Requirement(text) for text in PROJECT["build-system"]["requires"]]


def test_a_worker_has_the_versions_of_everybody_else() -> None:
    assert pins("worker.txt").items() <= pins("requirements.txt").items()
    assert len(pins("worker.txt")) < len(pins("requirements.txt")) / 2


def test_a_worker_does_without_what_its_lock_leaves_out(tmp_path: Path) -> None:
    called = {"eclipse-zenoh": "zenoh", "pyyaml": "yaml"}  # where it is imported
    left_out = pins("requirements.txt").keys() - pins("worker.txt").keys()
    missing = {called.get(name, name.replace("-", "_")) for name in left_out}
    assert {"ribs", "coacd", "matplotlib", "trimesh"} <= missing
    program = f"""
import sys
class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {missing!r}:
            raise ModuleNotFoundError(name)
sys.meta_path.insert(0, Absent())
import pkgutil, importlib, qdgrasp_worker
for module in pkgutil.walk_packages(qdgrasp_worker.__path__, "qdgrasp_worker."):
    if module.name != {DEVICE_MODULE!r}:  # of an extra
        importlib.import_module(module.name)
import qdgrasp_protocol.zenoh_bus
from qdgrasp_worker.platform import platform

from qdgrasp_worker.device import DEVICE_MODULE
print(platform()["probes"])
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert re.fullmatch(r"[0-9a-f]{64}\n", done.stdout)


FILES = sorted((DEPLOY / "kubernetes").glob("*.yaml"))
OBJECTS = [each for file in FILES for each in yaml.safe_load_all(file.read_text())]
DEPLOYMENTS = {each["metadata"]["name"]: each for each in OBJECTS if each["kind"] == "Deployment"}
KUBERNETES_SERVICES = {each["metadata"]["name"]: each for each in OBJECTS if each["kind"] == "Service"}
UNITS = {"Mi": 1, "Gi": 1024}


def pod(name: str) -> Any:
    return DEPLOYMENTS[name]["spec"]["template"]["spec"]


def labels(name: str) -> dict[str, str]:
    return DEPLOYMENTS[name]["spec"]["template"]["metadata"]["labels"]


def container(name: str) -> dict[str, Any]:
    (found,) = pod(name)["containers"]
    return found


def options(name: str) -> dict[str, Any]:
    """The arguments of a deployment as its command reads them."""
    started = container(name)
    return understood([*started.get("command", ["qdgrasp-worker"]), *started["args"]])


def megabytes(quantity: str) -> float:
    return float(quantity[:-2]) * UNITS[quantity[-2:]] * 1.048576


def test_everything_is_named_and_of_a_kind() -> None:
    assert {each["kind"] for each in OBJECTS} == {
        *("Deployment", "Service"),
        *("HorizontalPodAutoscaler", "ScaledObject"),
    }
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
    assert DEPLOYMENTS[name]["spec"]["selector"]["matchLabels"].items() <= labels(name).items()


def test_workers_find_the_router_by_the_name_of_its_service() -> None:
    (endpoint,) = parse_endpoints(options("qdgrasp-worker")["connect"])
    service = KUBERNETES_SERVICES[endpoint.host]["spec"]
    assert service["selector"].items() <= labels("qdgrasp-router").items()
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
    mounts = container("qdgrasp-worker")["volumeMounts"]
    writable = {Path(mount["mountPath"]) for mount in mounts if not mount.get("readOnly")}
    assert options("qdgrasp-worker")["cache"] in writable
    assert Path("/tmp") in writable  # noqa: S108 - the pod's own


def test_what_scales_is_what_there_is() -> None:
    scalers = [each for each in OBJECTS if each["kind"] in ("HorizontalPodAutoscaler", "ScaledObject")]
    assert len(scalers) == 2
    assert all(each["spec"]["scaleTargetRef"]["name"] in DEPLOYMENTS for each in scalers)


def test_without_work_there_are_no_workers_and_what_is_asked_for_is_told() -> None:
    (scaler,) = (each["spec"] for each in OBJECTS if each["kind"] == "ScaledObject")
    assert scaler["minReplicaCount"] == 0
    (trigger,) = scaler["triggers"]
    query = trigger["metadata"]["query"]
    (view,) = views(values())
    shown = structs.replace(view, figures=structs.replace(view.figures, wanted_workers=7))
    (name,) = re.findall(r"qdgrasp_\w+", query)
    assert f'{name}{{job="mugs"}} 7.0' in exposition([shown])[0].decode()
    assert query.endswith("or vector(0)")  # a job that is over tells nothing
