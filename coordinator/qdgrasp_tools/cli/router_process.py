"""`qdgrasp-router`: a router in a process of its own, for places without `zenohd`."""

from queue import SimpleQueue
from typing import Annotated

import structlog
import typer

from qdgrasp_protocol import cli_support
from qdgrasp_protocol.cli_support import run_command
from qdgrasp_protocol.process import configure_logging, lifetime
from qdgrasp_protocol.session import Credentials, Role, default_endpoint
from qdgrasp_protocol.zenoh_bus import ZenohBus

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)
log = structlog.get_logger()


@app.command()
def router(
    listen: Annotated[
        str | None, typer.Option(help="Endpoints, separated by commas; default: port 7447 on loopback.")
    ] = None,
    connect: Annotated[
        str | None,
        typer.Option(help="Endpoints of other routers to relay with; they may be started before or after."),
    ] = None,
    security: cli_support.SecurityOption = None,
    insecure: cli_support.InsecureOption = False,
    version: cli_support.VersionOption = False,
) -> None:
    """Relay between coordinators, recorders, workers and monitors until SIGINT or SIGTERM.

    Clients that name two routers (--connect tls/a:7447,tls/b:7447) go over to the other when one dies.

    Example: qdgrasp-router --listen tls/0.0.0.0:7447 --security security
    """
    with lifetime("qdgrasp-router") as stop:
        configure_logging("router")
        credentials = Credentials.find(security, Role.ROUTER)
        endpoint = listen or default_endpoint(encrypted=credentials is not None).text
        with ZenohBus.router(endpoint, connect=connect, credentials=credentials, insecure=insecure):
            log.info("listening", endpoint=endpoint, relays_with=connect or "no other router")
            stopped: SimpleQueue[None] = SimpleQueue()
            stop.tell(lambda: stopped.put(None))
            if not stop.is_set:
                stopped.get()
        log.info("stopped")
    raise typer.Exit(stop.exit_code)


def main() -> None:
    """Entry point of `qdgrasp-router`."""
    run_command(app, "qdgrasp-router")


if __name__ == "__main__":
    main()
