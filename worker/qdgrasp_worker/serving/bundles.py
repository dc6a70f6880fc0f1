"""Scene bundles at a worker: fetched over the bus by digest, checked, and kept on disk."""

import hashlib
import os
import tempfile
from contextlib import suppress
from pathlib import Path

from qdgrasp_protocol import chunks
from qdgrasp_protocol.bus import Bus
from qdgrasp_protocol.keys import DIGEST

MOST = 2 << 30
"""What the scenes on disk may take together [bytes]."""


class Bundles:
    """Scene bundles by digest.

    Parameters
    ----------
    folder
        Where bundles are kept between processes; None: nowhere.
    """

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder

    def bundle(self, bus: Bus, job: str, digest: str) -> bytes:
        """The bytes of a scene, from disk or from the job's coordinator.

        Raises
        ------
        NoReply, Refused
            The coordinator does not answer, or has no such scene.
        MessageError
            What came is not the scene of that digest.
        """
        payload = self._kept(digest)
        if payload is None:
            payload = chunks.fetch(bus, job, digest)
            self._keep(digest, payload)
        return payload

    def _kept(self, digest: str) -> bytes | None:
        if self._folder is None:
            return None
        with suppress(OSError):
            payload = (self._folder / digest).read_bytes()
            if hashlib.sha256(payload).hexdigest() == digest:
                with suppress(OSError):  # a folder of others
                    os.utime(self._folder / digest)
                return payload
        return None

    def _keep(self, digest: str, payload: bytes) -> None:
        if self._folder is None:
            return
        with suppress(OSError):  # a cache that cannot be written is only slower
            self._folder.mkdir(parents=True, exist_ok=True)
            _write(self._folder, digest, payload)
            _make_room(self._folder)


def _write(folder: Path, name: str, payload: bytes) -> None:
    """Write a file whole or not at all."""
    handle, draft = tempfile.mkstemp(dir=folder)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(payload)
        Path(draft).replace(folder / name)
    except OSError:
        Path(draft).unlink(missing_ok=True)
        raise


def _make_room(folder: Path) -> None:
    """Remove the scenes that were used the longest time ago, above what may be kept."""
    scenes = [(path, path.stat()) for path in folder.iterdir() if DIGEST.fullmatch(path.name)]
    scenes.sort(key=lambda scene: scene[1].st_mtime_ns, reverse=True)
    size = 0
    for path, status in scenes:
        size += status.st_size
        if size > MOST:
            path.unlink(missing_ok=True)
