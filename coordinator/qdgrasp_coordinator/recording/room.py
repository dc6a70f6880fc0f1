"""Whether there is room on the disk, and how long it is waited for: decided without a disk."""

from math import inf
from pathlib import Path

from qdgrasp_protocol.errors import DiskFull

RETRY_INTERVAL = 1.0
"""Seconds between two tries to write on a full disk."""


class Room:
    """The room in a folder, as far as writing in it has shown.

    Parameters
    ----------
    path
        The folder.
    patience
        How long a full disk is waited for [s].
    """

    def __init__(self, path: Path, patience: float) -> None:
        self._path = path
        self._patience = patience
        self._since: float | None = None
        self.trouble = ""
        """Why nothing can be written, in words; empty when it can."""
        self.try_at = -inf
        """When to try to write again."""

    def missed(self, reason: str, now: float, command: str) -> None:
        """Note that something did not fit; `command` goes on once there is room.

        Raises
        ------
        DiskFull
            Nothing has fitted for too long.
        """
        if self._since is None:
            self._since = now
        elif now - self._since > self._patience:
            raise DiskFull(
                f"{self._path} has had no room for {self._patience:g} s; make room, then `{command}` goes on."
            )
        self.trouble = reason
        self.try_at = now + RETRY_INTERVAL

    def found(self) -> None:
        """Note that something was written."""
        self._since, self.trouble, self.try_at = None, "", -inf
