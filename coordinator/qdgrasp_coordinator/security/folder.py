"""The folder that `qdgrasp security init` writes: an authority, and what each role proves itself with.

ca.pem  ca.key                    the authority; the key stays where the folder is
ROLE.pem  ROLE.key  ROLE.json5    for each role: certificate, key, zenoh configuration
NAME/                             what one more node needs, and nothing else
"""

import ipaddress
import os
import re
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from qdgrasp_coordinator.security import authority
from qdgrasp_coordinator.security.authority import Identity
from qdgrasp_coordinator.security.configuration import configuration
from qdgrasp_protocol.credentials import Credentials, Role
from qdgrasp_protocol.errors import ImpossibleValue, SecurityError
from qdgrasp_protocol.keys import NAME

PRIVATE_FILE, PRIVATE_FOLDER = 0o600, 0o700
AUTHORITY_DAYS = 3650
"""An authority outlives what it issues."""
HOST = re.compile(
    r"(?=.{1,253}$)[A-Za-z0-9]([A-Za-z0-9-]*[A-Za-z0-9])?(\.[A-Za-z0-9]([A-Za-z0-9-]*[A-Za-z0-9])?)*"
)


class SecurityFolder:
    """Certificates and keys in a folder that only its owner can read.

    Parameters
    ----------
    path
        Where.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    @classmethod
    def create(cls, path: Path, *, hosts: Sequence[str], days: int) -> "SecurityFolder":
        """Found an authority and issue a certificate for each role.

        Parameters
        ----------
        hosts
            Names and addresses by which routers are reached; the first stands in clients' configurations.
        days
            How long the certificates are good.

        Raises
        ------
        SecurityError
            There is something at `path` already, or it cannot be written.
        """
        check_hosts(hosts)
        if path.exists() and any(path.iterdir() if path.is_dir() else [path]):
            raise SecurityError(
                f"{path} is there already, and nothing in it is overwritten: name another folder, or add "
                f"to it with `qdgrasp security add {path} ROLE NAME`."
            )
        made = cls(path)
        root = authority.found(max(days, AUTHORITY_DAYS))
        _make(path)
        write(path / "ca.pem", root.certificate_pem)
        write(path / "ca.key", root.key_pem)
        for role in Role:
            made._issue(path, root, role, hosts, days)
        return made

    @property
    def authority(self) -> Identity:
        """The authority.

        Raises
        ------
        SecurityError
            Its files are not here, or cannot be read.
        """
        try:
            files = [(self.path / name).read_bytes() for name in ("ca.pem", "ca.key")]
        except OSError as error:
            raise SecurityError(
                f"{error.filename} cannot be read ({error.strerror}); certificates are issued in the folder "
                "that `qdgrasp security init` wrote."
            ) from None
        return Identity.from_pem(*files)

    def add(self, role: Role, name: str, *, hosts: Sequence[str], days: int) -> Path:
        """Issue one more certificate of a role, in a folder of its own that a node can be given.

        Raises
        ------
        SecurityError
            There is such a folder already, or no authority here that lasts as long.
        """
        check_hosts(hosts)
        if not NAME.fullmatch(name):
            raise ImpossibleValue("the name", name, "1 to 64 of the characters a-z, 0-9, '_' and '-'")
        root, place = self.authority, self.path / name
        left = (root.certificate.not_valid_after_utc - datetime.now(UTC)).days
        if days > left:
            raise SecurityError(
                f"A certificate cannot outlive its authority, which has {max(0, left)} days left, less than "
                f"{days}; choose fewer with --days, or begin anew with `qdgrasp security init`."
            )
        if place.exists():
            raise SecurityError(f"{place} is there already; choose another name.")
        _make(place)
        write(place / "ca.pem", root.certificate_pem)
        self._issue(place, root, role, hosts, days, name)
        return place

    def _issue(
        self, place: Path, root: Identity, role: Role, hosts: Sequence[str], days: int, holder: str = ""
    ) -> None:
        """Write what a role proves itself with."""
        names = hosts if role is Role.ROUTER else ()
        identity = authority.issue(root, role.common_name, days, hosts=names, holder=holder)
        files = Credentials(place.absolute(), role)
        write(files.certificate, identity.certificate_pem)
        write(files.key, identity.key_pem)
        write(files.configuration, configuration(files, hosts[0]).encode())


def check_hosts(hosts: Sequence[str]) -> None:
    """See that every host is a name or an address.

    Raises
    ------
    ImpossibleValue
        One is not, or there is none.
    """
    if not hosts:
        raise ImpossibleValue("--host", "", "at least one name or address")
    for host in hosts:
        try:
            ipaddress.ip_address(host)
        except ValueError:
            if not HOST.fullmatch(host):
                raise ImpossibleValue("--host", host, "a host's name or address, without a port") from None


def write(path: Path, content: bytes) -> None:
    """Write a file that is there for the first time, readable by its owner only from the start.

    Raises
    ------
    SecurityError
        It cannot be written.
    """
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, PRIVATE_FILE)
        with os.fdopen(descriptor, "wb") as file:
            file.write(content)
    except OSError as error:
        raise SecurityError(f"{path} cannot be written: {error.strerror}.") from None


def _make(path: Path) -> None:
    """Make a folder that only its owner can look into."""
    try:
        path.mkdir(parents=True, exist_ok=True)
        path.chmod(PRIVATE_FOLDER)
    except OSError as error:
        raise SecurityError(f"{path} cannot be made: {error.strerror}.") from None
