"""What a session proves its role with: the files of a folder that `qdgrasp security init` wrote."""

import os
import stat
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from qdgrasp_protocol.errors import SecurityError

OTHERS = stat.S_IWGRP | stat.S_IRWXO
"""A group may read a key: that is how systemd and Kubernetes hand one to a service."""


class Role(StrEnum):
    """What a certificate allows; each has one common name, and workers are one class."""

    ROUTER = "router"
    """Relays for everybody: `qdgrasp-router`, `zenohd`, a coordinator that listens itself."""
    COORDINATOR = "coordinator"
    RECORDER = "recorder"
    WORKER = "worker"
    MONITOR = "monitor"
    """Watches, and says nothing."""
    ADMIN = "admin"
    """Watches, reads records, and tells a job to pause, go on or end."""

    @property
    def common_name(self) -> str:
        """The common name of its certificates, which the routers' access list goes by."""
        return f"qdgrasp-{self.value}"


@dataclass(frozen=True)
class Credentials:
    """The certificate of a role, its key, and the authority that the other side's must come from.

    Attributes
    ----------
    folder
        Where the files lie.
    role
        Which of them.
    """

    folder: Path
    role: Role

    @classmethod
    def find(cls, folder: Path | None, role: Role) -> "Credentials | None":
        """The files of a role in a folder; None where no folder was named.

        Raises
        ------
        SecurityError
            A file is missing, or others on this machine can read the key.
        """
        if folder is None:
            return None
        found = cls(folder.absolute(), role)
        found.check()
        return found

    @property
    def authority(self) -> Path:
        """The certificate of the authority."""
        return self.folder / "ca.pem"

    @property
    def certificate(self) -> Path:
        """The certificate of the role."""
        return self.folder / f"{self.role}.pem"

    @property
    def key(self) -> Path:
        """The private key of the role."""
        return self.folder / f"{self.role}.key"

    @property
    def configuration(self) -> Path:
        """A zenoh configuration of the role; the router's holds the access list."""
        return self.folder / f"{self.role}.json5"

    def check(self) -> None:
        """See that everything is there, and that nobody else can read the key."""
        needed = [self.authority, self.certificate, self.key]
        if self.role is Role.ROUTER:
            needed.append(self.configuration)
        missing = [path.name for path in needed if not path.is_file()]
        if missing:
            raise SecurityError(
                f"{self.folder} lacks {' and '.join(missing)}, which the {self.role} needs; "
                "copy them from the folder that `qdgrasp security init` wrote."
            )
        if stat.S_IMODE(self.key.stat().st_mode) & _strangers(self.key):
            raise SecurityError(
                f"Others on this machine can read {self.key}; `chmod 600 {self.key}` mends it."
            )


def _strangers(key: Path) -> int:
    """The permissions that a key must not give.

    Where a service manager hands root's key to a group of one (Kubernetes, systemd), that group may read it.
    """
    is_handed_over = key.stat().st_uid == 0 and os.geteuid() != 0
    return OTHERS & ~stat.S_IRGRP if is_handed_over else OTHERS
