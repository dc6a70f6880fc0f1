"""How every session on the bus is opened: one builder, for our own processes and for zenoh's tools."""

import json
from collections.abc import Iterable, Mapping
from typing import Any, Literal

from qdgrasp_protocol.credentials import Credentials
from qdgrasp_protocol.endpoint import Endpoint
from qdgrasp_protocol.errors import EndpointError

Mode = Literal["client", "router"]
"""Routers relay; everybody else is a client of them."""
Settings = dict[str, object]
"""Values by their path in a zenoh configuration."""

SETTINGS: Settings = {
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    "scouting/delay": 0,  # ms; nobody is scouted, so opening a router need not wait for answers
    "transport/shared_memory/enabled": False,
    "transport/unicast/max_sessions": 10_000,
    "transport/unicast/open_timeout": 3000,  # ms of one try; then another router has its turn
    "transport/link/rx/max_message_size": 17 << 20,  # codec.MAX_PAYLOAD and what stands around it
    "transport/link/tx/lease": 4000,  # ms
    "transport/link/tx/queue/congestion_control/block/wait_before_close": 1_000_000,  # us
}
"""What every session is opened with (docs/decisions/0003-bus-sessions-and-access.md)."""
RETRY = {"period_init_ms": 100, "period_max_ms": 1000, "period_increase_factor": 1.5}
FOREVER = -1


def settings(
    mode: Mode,
    *,
    listen: Iterable[Endpoint] = (),
    connect: Iterable[Endpoint] = (),
    credentials: Credentials | None = None,
    seconds: float = 0.0,
) -> Settings:
    """The settings of a session.

    Parameters
    ----------
    listen
        Where a router listens.
    connect
        Routers: a client connects to the first that answers, and to another one when that is lost;
        a router connects to each, now or later.
    credentials
        What the session proves its role with; None: nothing, on links without encryption.
    seconds
        How long opening a client may take; a connection lost later is sought for ever.

    Raises
    ------
    EndpointError
        An encrypted endpoint without credentials, or credentials that an endpoint cannot show.
    """
    listening, connecting = tuple(listen), tuple(connect)
    for endpoint in (*listening, *connecting):
        check(endpoint, credentials)
    chosen = SETTINGS | {"mode": mode}
    if listening:
        chosen |= _places("listen", listening, 0, fails=True)
    if connecting:
        patience = int(1000 * seconds) if mode == "client" else FOREVER
        chosen |= _places("connect", connecting, patience, fails=mode == "client")
    return chosen | (_tls(mode, credentials) if credentials else {})


def check(endpoint: Endpoint, credentials: Credentials | None) -> None:
    """See that an endpoint is encrypted where, and only where, there are certificates."""
    if endpoint.is_encrypted and credentials is None:
        raise EndpointError(
            f"{endpoint.text} is encrypted and needs certificates: name their folder with --security "
            "(`qdgrasp security init` writes one)."
        )
    if credentials is not None and not endpoint.is_encrypted:
        raise EndpointError(
            f"{endpoint.text} is not encrypted, and --security {credentials.folder} asks for that; "
            "write it as tls/HOST:PORT."
        )


def nested(values: Mapping[str, object]) -> dict[str, Any]:
    """Settings as the tree that a configuration file holds."""
    tree: dict[str, Any] = {}
    for path, value in values.items():
        *branches, leaf = path.split("/")
        twig = tree
        for branch in branches:
            twig = twig.setdefault(branch, {})
        twig[leaf] = value
    return tree


def to_json5(values: Mapping[str, object], comment: str) -> str:
    """A zenoh configuration file with these settings, under a comment."""
    head = "".join(f"// {line}\n" for line in comment.splitlines())
    return f"{head}{json.dumps(nested(values), indent=2)}\n"


def _places(verb: str, endpoints: tuple[Endpoint, ...], timeout_ms: int, *, fails: bool) -> Settings:
    return {
        f"{verb}/endpoints": [endpoint.text for endpoint in endpoints],
        f"{verb}/timeout_ms": timeout_ms,
        f"{verb}/exit_on_failure": fails,
        f"{verb}/retry": RETRY,
    }


def _tls(mode: Mode, credentials: Credentials) -> Settings:
    """Both sides show a certificate, and a link ends with the certificate it was opened by."""
    certificate, key = str(credentials.certificate), str(credentials.key)
    shown: Settings = {"connect_certificate": certificate, "connect_private_key": key}
    if mode == "router":
        shown |= {"listen_certificate": certificate, "listen_private_key": key}
    always: Settings = {
        "root_ca_certificate": str(credentials.authority),
        "enable_mtls": True,
        "verify_name_on_connect": True,
        "close_link_on_expiration": True,
    }
    return {f"transport/link/tls/{name}": value for name, value in (always | shown).items()}
