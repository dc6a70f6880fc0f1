"""`qdgrasp doctor` and `security`: what a machine needs, and certificates for many."""

import importlib.metadata
import importlib.util
import os
import socket
import sqlite3
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from qdgrasp_assets import catalog
from qdgrasp_protocol.cli_support import echo
from qdgrasp_protocol.errors import InputError, QdgraspError
from qdgrasp_protocol.session import Role
from qdgrasp_protocol.spec import DEFAULT_ENGINE, DEVICE_ENGINE, ENGINE_PACKAGES, usual_engine
from qdgrasp_protocol.text import counted
from qdgrasp_protocol.zenoh_bus import ZenohBus
from qdgrasp_tools.cli import options
from qdgrasp_tools.local.supervisor import local_platform


def doctor() -> None:
    """Check what a run needs on this machine: engines, bus, simulator, disk and assets.

    Example: qdgrasp doctor
    """
    checks: dict[str, Callable[[], str]] = {
        "engines": _check_engines,
        "cores": lambda: str(options.worker_count(None)),
        "bus": _check_bus,
        "simulator": _check_simulator,
        "disk": _check_disk,
        "assets": _check_assets,
    }
    failed = [name for name, check in checks.items() if not _report(name, check)]
    if failed:
        raise InputError(f"{len(failed)} of {len(checks)} checks failed: {', '.join(failed)}.")


def _report(name: str, check: Callable[[], str]) -> bool:
    try:
        echo(f"ok      {name:<10} {check()}")
    except (QdgraspError, OSError, ImportError) as error:
        echo(f"FAILED  {name:<10} {error}")
        return False
    return True


def _check_engines() -> str:
    """Name the engines, and the one of scenes that name none."""
    found = ", ".join(f"{name} {_version(name)}" for name in ENGINE_PACKAGES.values())
    return f"{found}; {usual_engine().get('engine', DEFAULT_ENGINE)} unless --engine says another"


def _version(package: str) -> str:
    """Return the version of an engine's package, which is imported; "absent" if not installed."""
    name = package.replace("-", "_")
    if importlib.util.find_spec(name) is None:
        return "absent"
    module = importlib.import_module(name)
    return str(getattr(module, "__version__", None) or importlib.metadata.version(package))


def _check_bus() -> str:
    router, endpoint = ZenohBus.embedded(None)
    with router, ZenohBus.connect(endpoint, 5.0) as client:
        client.put("qdgrasp/v1/doctor/meta", b"{}", encoding="application/json")
    return f"a router listened on {endpoint} and took a client"


def _check_simulator() -> str:
    platform = local_platform()
    device = [f"{DEVICE_ENGINE} on {platform['warp_device']}"] if DEVICE_ENGINE in platform else []
    probes = {name.replace("_", " "): digest for name, digest in platform.items() if "probes" in name}
    return ", ".join([*(f"{name} {digest[:12]}" for name, digest in probes.items()), *device])


def _check_disk() -> str:
    here = Path.cwd()
    with tempfile.NamedTemporaryFile(dir=here):
        free = os.statvfs(here)
    return f"{free.f_bavail * free.f_frsize >> 30} GiB free, SQLite {sqlite3.sqlite_version}"


def _check_assets() -> str:
    return f"grippers {', '.join(catalog.gripper_names())}; objects {', '.join(catalog.object_names())}"


LOOPBACK = ("localhost", "127.0.0.1", "::1")

security_app = typer.Typer(
    name="security", no_args_is_help=True, help="Certificates and access lists for jobs on many machines."
)

Days = Annotated[int, typer.Option(min=1, max=36500, help="How long certificates are good [days].")]
Hosts = Annotated[
    list[str] | None,
    typer.Option(
        "--host",
        help="Name or address by which a router is reached; may be repeated; default: this machine's.",
    ),
]
Directory = Annotated[Path, typer.Argument(metavar="DIR", help="The folder of certificates.")]


@security_app.command()
def init(directory: Directory, host: Hosts = None, days: Days = 365) -> None:
    """Write an authority, a certificate for each role, and the routers' access list.

    DIR/ca.key signs further certificates and is needed for nothing else. A node that only serves workers
    needs ca.pem, worker.pem and worker.key; `qdgrasp security add` makes a folder for one.

    Example: qdgrasp security init security --host head --host 10.0.0.1
    """
    from qdgrasp_tools.security import SecurityFolder  # cryptography takes a while to load

    made = SecurityFolder.create(directory, hosts=_router_hosts(host), days=days)
    echo(
        f"{made.path} holds an authority and certificates for {', '.join(Role)}, good for "
        f"{counted(days, 'day')}. "
        f"Start a router: `qdgrasp-router --listen tls/0.0.0.0:7447 --security {made.path}`."
    )


@security_app.command()
def add(
    directory: Directory,
    role: Annotated[Role, typer.Argument(help="The role that the certificate allows.")],
    name: Annotated[str, typer.Argument(help="Name of the node that it is for.")],
    host: Hosts = None,
    days: Days = 365,
) -> None:
    """Issue one more certificate,
    in a folder DIR/NAME that holds what one node needs and nothing else.

    Example: qdgrasp security add security worker lab-7
    """  # noqa: D205  # typer joins the lines
    from qdgrasp_tools.security import SecurityFolder

    place = SecurityFolder(directory).add(role, name, hosts=_router_hosts(host), days=days)
    echo(f"{place} holds a certificate of the {role}, good for {counted(days, 'day')}: copy it to {name}.")


def _router_hosts(given: list[str] | None) -> list[str]:
    """The names of a router: those given, or this machine's, and always those of loopback."""
    return list(dict.fromkeys([*(given or [socket.gethostname()]), *LOOPBACK]))
