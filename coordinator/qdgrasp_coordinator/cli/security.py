"""`qdgrasp security`: certificates and access lists for jobs on many machines."""

import socket
from pathlib import Path
from typing import Annotated

import typer

from qdgrasp_protocol import flags
from qdgrasp_protocol.credentials import Role
from qdgrasp_protocol.endpoint import home
from qdgrasp_protocol.errors import SecurityError
from qdgrasp_protocol.phrases import counted

LOOPBACK = ("localhost", "127.0.0.1", "::1")

app = typer.Typer(no_args_is_help=True, help="Certificates and access lists for jobs on many machines.")

Days = Annotated[int, typer.Option(min=1, max=36500, help="How long certificates are good [days].")]
Hosts = Annotated[
    list[str] | None,
    typer.Option(
        "--host",
        help="Name or address by which a router is reached; may be repeated; default: this machine's.",
    ),
]
Directory = Annotated[Path, typer.Argument(metavar="DIR", help="The folder of certificates.")]


@app.command()
def init(directory: Directory, host: Hosts = None, days: Days = 365) -> None:
    """Write an authority, a certificate for each role, and the routers' access list.

    DIR/ca.key signs further certificates and is needed by nobody else. A node that only serves workers needs
    ca.pem, worker.pem and worker.key; `qdgrasp security add` makes a folder for one.

    Example: qdgrasp security init security --host head --host 10.0.0.1
    """
    from qdgrasp_coordinator.security.folder import SecurityFolder  # cryptography takes a while to load

    made = SecurityFolder.create(directory, hosts=_hosts(host), days=days)
    typer.echo(
        f"{made.path} holds an authority and certificates for {', '.join(Role)}, good for "
        f"{counted(days, 'day')}. "
        f"Start a router: `qdgrasp-router --listen tls/0.0.0.0:7447 --security {made.path}`."
    )


@app.command()
def add(
    directory: Directory,
    role: Annotated[Role, typer.Argument(help="What it allows.")],
    name: Annotated[str, typer.Argument(help="Whose it is: a node's name.")],
    host: Hosts = None,
    days: Days = 365,
) -> None:
    """Issue one more certificate, in a folder DIR/NAME that holds what one node needs and nothing else.

    Example: qdgrasp security add security worker lab-7
    """
    from qdgrasp_coordinator.security.folder import SecurityFolder

    place = SecurityFolder(directory).add(role, name, hosts=_hosts(host), days=days)
    typer.echo(
        f"{place} holds a certificate of the {role}, good for {counted(days, 'day')}: copy it to {name}."
    )


@app.command()
def check(
    security: flags.Security = None,
    connect: flags.Connect = None,
    through: Annotated[
        str | None, typer.Option(help="Endpoint of a second router: who hears and answers is its client.")
    ] = None,
) -> None:
    """Prove the access list at a running router: every role tries every verb on every key.

    It takes a quarter of a minute and needs the folder that `qdgrasp security init` wrote, with ca.key: a
    certificate without a role, an expired one and another authority's are tried too. The job that it plays
    is called security-check; running jobs do not notice.

    Example: qdgrasp security check --security security --connect tls/head:7447
    """
    if security is None:
        raise SecurityError("Name the folder that `qdgrasp security init` wrote with --security.")
    from qdgrasp_coordinator.security.proof import prove
    from qdgrasp_coordinator.security.verdicts import table

    found = prove(connect or home(encrypted=True).text, security, takers_at=through)
    typer.echo(table(found.matrix))
    for fault in found.faults:
        typer.echo(f"WRONG: {fault}")
    typer.echo(found.words)
    if not found.holds:
        raise typer.Exit(1)


def _hosts(given: list[str] | None) -> list[str]:
    """The names of a router: those given, or this machine's, and always those of loopback."""
    return list(dict.fromkeys([*(given or [socket.gethostname()]), *LOOPBACK]))
