"""Who must not even get a session: no certificate, another authority's, an expired one, a plain link."""

import ssl
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from qdgrasp_coordinator.security import authority
from qdgrasp_coordinator.security.authority import Identity
from qdgrasp_coordinator.security.folder import SecurityFolder
from qdgrasp_coordinator.security.stage import stranger
from qdgrasp_protocol.credentials import Credentials, Role
from qdgrasp_protocol.endpoint import Endpoint
from qdgrasp_protocol.errors import EndpointError
from qdgrasp_protocol.handshake import greet
from qdgrasp_protocol.zenoh_bus import ZenohBus

PATIENCE = 1.0  # seconds that opening a session may take
LONG_AGO = timedelta(days=2)
"""A certificate that was issued then for a day has expired."""


@dataclass(frozen=True)
class Knock:
    """Somebody who tried to get in.

    Attributes
    ----------
    who
        In words.
    got_in
        A session was opened, which is wrong.
    """

    who: str
    got_in: bool


def knocks(endpoint: str, folder: Path) -> list[Knock]:
    """Knock as every kind of stranger, and as one who is welcome.

    Raises
    ------
    EndpointError
        The one who is welcome does not get in either: the router is away, or slower than we wait.
    """
    ours, theirs, now = SecurityFolder(folder).authority, authority.found(1), datetime.now(UTC)
    tried = [
        Knock("no certificate", _greets(endpoint, folder)),
        Knock("a worker's certificate of another authority", _opens(endpoint, theirs, ours, now)),
        Knock("a worker's certificate that has expired", _opens(endpoint, ours, ours, now - LONG_AGO)),
        Knock("a link without encryption", _connects(f"tcp/{endpoint.partition('/')[2]}", None)),
    ]
    if not _opens(endpoint, ours, ours, now):
        raise EndpointError(
            f"It cannot be said whether strangers get in at {endpoint}: a good certificate does not within "
            f"{PATIENCE:g} s either. Try again when the router is there and less busy."
        )
    return tried


def _greets(endpoint: str, folder: Path) -> bool:
    """Whether a router takes somebody who shows nothing."""
    known = Credentials(folder, Role.WORKER)
    try:
        return greet(Endpoint.parse(endpoint), ssl.create_default_context(cafile=str(known.authority)))
    except OSError:  # of TLS, or of a link that was ended without a word
        return False


def _opens(endpoint: str, signer: Identity, trusted: Identity, issued: datetime) -> bool:
    """Whether a router takes a worker's certificate of this signer."""
    with stranger(signer, Role.WORKER.common_name, trusts=trusted, now=issued) as shown:
        return _connects(endpoint, shown)


def _connects(endpoint: str, shown: Credentials | None) -> bool:
    try:
        with ZenohBus.connect(endpoint, PATIENCE, credentials=shown):
            return True
    except EndpointError:
        return False
