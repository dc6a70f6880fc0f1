"""The sessions that try everything at a router, and their names.

Each role has three: one gives, one takes, and one takes by patterns that are wider than anybody's rights.
A session hears itself without a router, so none of them does two of these.
"""

import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from qdgrasp_coordinator.security import authority
from qdgrasp_coordinator.security.authority import Identity
from qdgrasp_coordinator.security.folder import SecurityFolder, write
from qdgrasp_coordinator.security.traffic import TRAFFIC
from qdgrasp_protocol.bus import Bus
from qdgrasp_protocol.credentials import Credentials, Role
from qdgrasp_protocol.zenoh_bus import ZenohBus

JOB = "security-check"
GUEST = "guest"
"""Has a certificate of the authority, and no role."""
ROLES = tuple(role for role in Role if role is not Role.ROUTER)
ACTORS = (*(role.value for role in ROLES), GUEST)
KEYS = tuple(dict.fromkeys(flow.key.replace("**", "job").replace("*", JOB) for flow in TRAFFIC))
"""One key of each kind of traffic, of a job that nobody serves: no number is an epoch here."""
WIDE = (
    "**",
    "qdgrasp/**",
    "qdgrasp/v1/**",
    f"qdgrasp/v1/{JOB}/**",
    f"qdgrasp/v1/{JOB}/*",
    f"qdgrasp/v1/{JOB}/live/**",
    f"qdgrasp/v1/{JOB}/rpc/*",
    f"qdgrasp/v1/{JOB}/rec/**",
    *(f"**/{verbatim}/**" for verbatim in ("@work", "@result", "@ctl", "@outcome", "@asset", "@recorded")),
    f"qdgrasp/*/{JOB}/@work/*",
    f"qdgrasp/*/{JOB}/@result/*",
)
"""Patterns that no role may use."""


@dataclass(frozen=True)
class Taker:
    """A session that hears, answers and watches.

    Attributes
    ----------
    name
        Whose it is.
    bus
        The session.
    patterns
        What it declares.
    """

    name: str
    bus: Bus
    patterns: tuple[str, ...]


@dataclass(frozen=True)
class Stage:
    """Who gives and who takes."""

    givers: dict[str, Bus]
    takers: list[Taker]


@contextmanager
def stage(endpoint: str, folder: Path, patience: float, takers_at: str | None = None) -> Iterator[Stage]:
    """Open all sessions at a router.

    Parameters
    ----------
    endpoint
        Of the router.
    folder
        What `qdgrasp security init` wrote, with the authority's key.
    patience
        Seconds that opening a session may take.
    takers_at
        Of another router for those who take; None: the same one.
    """
    with ExitStack() as stack:
        proofs: dict[str, Credentials] = {role.value: _found(folder, role) for role in ROLES}
        proofs[GUEST] = stack.enter_context(stranger(SecurityFolder(folder).authority, GUEST))

        def enter(name: str, where: str) -> Bus:
            return stack.enter_context(ZenohBus.connect(where, patience, credentials=proofs[name]))

        there = takers_at or endpoint
        givers = {name: enter(name, endpoint) for name in ACTORS}
        takers = [Taker(name, enter(name, there), KEYS) for name in ACTORS]
        wide = [Taker(f"{name}, by a wide pattern", enter(name, there), WIDE) for name in ACTORS]
        yield Stage(givers, takers + wide)


@contextmanager
def stranger(
    signer: Identity, common_name: str, *, trusts: Identity | None = None, now: datetime | None = None
) -> Iterator[Credentials]:
    """A certificate of our making, in a folder of its own, for as long as the context lasts.

    Parameters
    ----------
    signer
        The authority that issues it.
    trusts
        The authority whose routers are trusted; None: the same.
    now
        When it is issued, for a day.
    """
    with tempfile.TemporaryDirectory(prefix="qdgrasp-") as name:
        files = Credentials(Path(name), Role.WORKER)
        identity = authority.issue(signer, common_name, 1, now=now)
        write(files.authority, (trusts or signer).certificate_pem)
        write(files.certificate, identity.certificate_pem)
        write(files.key, identity.key_pem)
        yield files


def _found(folder: Path, role: Role) -> Credentials:
    found = Credentials(folder.absolute(), role)
    found.check()
    return found
