"""What a session proves its role with: the files of a folder that `qdgrasp security init` wrote."""

import os
import stat
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from qdgrasp_protocol.errors import SecurityError

VARIABLE = "QDGRASP_SECURITY"
"""Names the folder to commands that somebody starts; processes that a command starts are told by a flag."""
OTHERS = stat.S_IRWXG | stat.S_IRWXO
"""The permissions of everybody but a key's owner."""


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
    """Asks how jobs are, hears their figures, and tells a job to pause, go on or end."""

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
            A file is missing or cannot be read, or others on this machine can read the key.
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
        """See that everything is there for us, and that nobody else can read the key."""
        try:
            self._check()
        except OSError as error:
            raise SecurityError(
                f"{error.filename} cannot be read ({error.strerror}): the files of a {self.role} are to be "
                "those of the user who runs it."
            ) from None

    def _check(self) -> None:
        needed = [self.authority, self.certificate, self.key]
        if self.role is Role.ROUTER:
            needed.append(self.configuration)
        missing = [path.name for path in needed if not path.is_file()]
        if missing:
            raise SecurityError(
                f"{self.folder} lacks {' and '.join(missing)}, which the {self.role} needs; "
                "copy them from the folder that `qdgrasp security init` wrote."
            )
        for path in needed:
            path.open("rb").close()
        if stat.S_IMODE(self.key.stat().st_mode) & _strangers(self.key):
            raise SecurityError(
                f"Others on this machine can read or change {self.key}; `chmod 600 {self.key}` mends it."
            )


def _strangers(key: Path) -> int:
    """The permissions that a key must not give.

    Kubernetes and systemd hand a key to a service so: it stays root's, and a group of one may read it.
    """
    is_handed_over = key.stat().st_uid == 0 and os.geteuid() != 0
    return OTHERS & ~stat.S_IRGRP if is_handed_over else OTHERS
