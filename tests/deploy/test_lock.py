import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.version import Version
from tests.deploy.commands import DEPLOY

CONTAINER = DEPLOY / "container"
PROJECT = tomllib.loads((DEPLOY.parent / "pyproject.toml").read_text())
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


def imports(name: str) -> str:
    """What a package of a lock file is called where it is imported."""
    return {"eclipse-zenoh": "zenoh", "pyyaml": "yaml"}.get(name, name.replace("-", "_"))


@pytest.mark.parametrize("name", LOCKS)
def test_every_line_of_a_lock_is_one_version_with_its_hashes(name: str) -> None:
    rest = re.sub(r"^ *#.*\n", "", ENTRY.sub("", read(name)), flags=re.MULTILINE)
    assert rest.strip() == ""
    assert pins(name)


@pytest.mark.parametrize(
    ("name", "needed"),
    [
        ("requirements.txt", [Requirement(text) for text in PROJECT["project"]["dependencies"]]),
        ("worker.txt", asked("worker.in")),
        ("build.txt", asked("build.in")),
    ],
    ids=LOCKS,
)
def test_a_lock_satisfies_what_is_needed(name: str, needed: list[Requirement]) -> None:
    locked = pins(name)
    wrong = [
        str(each) for each in needed if each.name not in locked or locked[each.name] not in each.specifier
    ]
    assert wrong == []


def test_what_builds_an_image_is_what_builds_the_package() -> None:
    assert list(map(str, asked("build.in"))) == list(
        map(str, map(Requirement, PROJECT["build-system"]["requires"]))
    )


def test_a_worker_has_the_versions_of_everybody_else() -> None:
    assert pins("worker.txt").items() <= pins("requirements.txt").items()
    assert len(pins("worker.txt")) < len(pins("requirements.txt")) / 2


def test_a_worker_does_without_what_its_lock_leaves_out(tmp_path: Path) -> None:
    missing = {imports(name) for name in pins("requirements.txt").keys() - pins("worker.txt").keys()}
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
    importlib.import_module(module.name)
import qdgrasp_protocol.zenoh_bus
from qdgrasp_worker.platform import platform
print(platform()["probes"])
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert re.fullmatch(r"[0-9a-f]{64}\n", done.stdout)
