"""`qdgrasp doctor`: whether this machine has what a run needs."""

import importlib.metadata
import json
import os
import platform as machine
import sqlite3
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import typer

from qdgrasp_assets import catalog
from qdgrasp_coordinator.cli import options
from qdgrasp_protocol.errors import InputError, QdgraspError
from qdgrasp_protocol.zenoh_bus import ZenohBus, free_endpoint

PACKAGES = ("eclipse-zenoh", "pybullet", "numpy", "ribs", "trimesh", "msgpack", "coacd")
NETWORK_FILE_SYSTEMS = {"nfs", "nfs4", "cifs", "smb3", "fuse.sshfs", "lustre", "beegfs", "gpfs"}
SIMULATOR_PATIENCE = 60  # seconds


class Trouble(InputError):
    """Something that a run needs is not there."""


def doctor() -> None:
    """Check what a run needs on this machine: Python, packages, bus, simulator, disk and assets.

    Example: qdgrasp doctor
    """
    checks: dict[str, Callable[[], str]] = {
        "python": _python,
        "packages": _packages,
        "cores": lambda: str(options.cores()),
        "bus": _bus,
        "simulator": _simulator,
        "disk": _disk,
        "assets": _assets,
    }
    failed = [name for name, check in checks.items() if not _report(name, check)]
    if failed:
        raise Trouble(f"{len(failed)} of {len(checks)} checks failed: {', '.join(failed)}.")


def _report(name: str, check: Callable[[], str]) -> bool:
    try:
        typer.echo(f"ok      {name:<10} {check()}")
    except (QdgraspError, OSError, ImportError) as error:
        typer.echo(f"FAILED  {name:<10} {error}")
        return False
    return True


def _python() -> str:
    if sys.version_info[:2] != (3, 11):
        raise Trouble(f"Python 3.11 is needed, this is {machine.python_version()}.")
    return f"{machine.python_version()} on {machine.machine()}"


def _packages() -> str:
    return ", ".join(f"{name} {importlib.metadata.version(name)}" for name in PACKAGES)


def _bus() -> str:
    endpoint = free_endpoint()
    with ZenohBus.router(endpoint), ZenohBus.connect(endpoint, 5.0) as client:
        client.put("qdgrasp/v1/doctor/meta", b"{}", encoding="application/json")
    return f"a router listened on {endpoint} and took a client"


def _simulator() -> str:
    command = [sys.executable, "-m", "qdgrasp_worker.cli", "--self-test"]
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=SIMULATOR_PATIENCE, check=False
        )
    except subprocess.TimeoutExpired:
        raise Trouble(f"the probe set took more than {SIMULATOR_PATIENCE} s.") from None
    if done.returncode:
        raise Trouble((done.stderr.strip().splitlines() or ["the worker ended without a word"])[-1])
    return f"probe set {json.loads(done.stdout.strip().splitlines()[-1])['probes'][:12]}"


def _disk() -> str:
    here = Path.cwd()
    kind = _file_system(here)
    if kind in NETWORK_FILE_SYSTEMS:
        raise Trouble(f"{here} is on a network file system ({kind}); records need a local disk.")
    with tempfile.NamedTemporaryFile(dir=here):
        free = os.statvfs(here)
    return f"{free.f_bavail * free.f_frsize >> 30} GiB free, SQLite {sqlite3.sqlite_version}"


def _file_system(path: Path) -> str:
    """The type of the file system that holds `path`, as Linux names it; empty where that is not known."""
    try:
        mounts = [line.split()[1:3] for line in Path("/proc/mounts").read_text().splitlines()]
    except OSError:
        return ""
    holding = [(mount, kind) for mount, kind in mounts if path.is_relative_to(mount)]
    return max(holding, key=lambda entry: len(entry[0]))[1] if holding else ""


def _assets() -> str:
    return f"grippers {', '.join(catalog.gripper_names())}; objects {', '.join(catalog.object_names())}"
