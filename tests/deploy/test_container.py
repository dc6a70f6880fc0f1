"""Container images and their lock files."""

import re
import subprocess
import sys
import tomllib
from fnmatch import fnmatch

import pytest
from packaging.requirements import Requirement
from packaging.version import Version
from tests.deploy.commands import DEPLOY

from qdgrasp_protocol.errors import EXTRAS
from qdgrasp_worker.evaluator import DEVICE_MODULE

ROOT = DEPLOY.parent
CONTAINER = DEPLOY / "container"
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
EXTRA_NEEDS = PROJECT["project"]["optional-dependencies"]
HEAD_NEEDS = [
    *PROJECT["project"]["dependencies"],
    *(each for name in EXTRAS.keys() - {"arm", "gpu"} for each in EXTRA_NEEDS[name]),
]
PIN = re.compile(r"^([A-Za-z0-9_.-]+)==(\S+) \\\n(?:    --hash=sha256:[0-9a-f]{64}(?: \\)?\n)+", re.MULTILINE)


def test_the_files_of_an_image_exist_and_are_sent_to_the_builder() -> None:
    lines = (ROOT / ".containerignore").read_text().splitlines()
    sent = [line[1:] for line in lines if line.startswith("!")]
    text = (CONTAINER / "Containerfile").read_text().replace("\\\n", " ")
    copied = [
        word for line in re.findall(r"^COPY (?!.*--from)(.*)$", text, re.M) for word in line.split()[:-1]
    ]
    assert {"assets", "coordinator", "protocol", "worker", "pyproject.toml"} <= set(copied)
    for path in copied:
        assert (ROOT / path).exists()
        assert any(path == each or path.startswith(f"{each}/") or fnmatch(path, each) for each in sent)


def pins(name: str) -> dict[str, Version]:
    """Versions in a lock file, each with its hashes."""
    return {package: Version(version) for package, version in PIN.findall((CONTAINER / name).read_text())}


@pytest.mark.parametrize("name", ["requirements", "worker", "build"])
def test_a_lock_file_satisfies_what_is_needed(name: str) -> None:
    text = HEAD_NEEDS
    if name != "requirements":
        lines = (CONTAINER / f"{name}.in").read_text().splitlines()
        text = [line for line in lines if line and not line.startswith("#")]
    locked = pins(f"{name}.txt")
    for need in map(Requirement, text):
        assert locked[need.name] in need.specifier, f"{need}: run `make lock`"
    if name == "worker":
        assert locked.items() <= pins("requirements.txt").items()


def test_a_worker_needs_nothing_that_its_lock_file_leaves_out() -> None:
    modules = {"eclipse-zenoh": "zenoh", "pyyaml": "yaml"}  # where it is imported
    left_out = pins("requirements.txt").keys() - pins("worker.txt").keys()
    missing = {modules.get(name, name.replace("-", "_")) for name in left_out}
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
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
