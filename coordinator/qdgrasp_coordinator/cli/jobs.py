"""`qdgrasp jobs`: what runs where, since when, and how far."""

from qdgrasp_coordinator.cli import options
from qdgrasp_coordinator.cli.asking import place, session
from qdgrasp_coordinator.cli.monitor import show
from qdgrasp_coordinator.monitor.overview import overview
from qdgrasp_protocol import flags
from qdgrasp_protocol.credentials import Role


def jobs(
    connect: flags.Connect = None, security: flags.Security = None, as_json: options.Json = False
) -> None:
    """Say which jobs there are, what they have done, and who works on them.

    Example: qdgrasp jobs --connect tcp/head:7447
    """
    endpoint = place(connect, security)
    with session(endpoint, security, Role.MONITOR) as bus:
        show(overview(bus), endpoint, as_json=as_json)
