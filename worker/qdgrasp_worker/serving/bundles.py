"""Scene bundles at a worker: fetched over the bus by digest, checked, and kept on disk."""

import hashlib
import os
import tempfile
from contextlib import suppress
from pathlib import Path

from qdgrasp_protocol import chunks
from qdgrasp_protocol.bus import Bus


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
                return payload
        return None

    def _keep(self, digest: str, payload: bytes) -> None:
        if self._folder is None:
            return
        with suppress(OSError):  # a cache that cannot be written is only slower
            self._folder.mkdir(parents=True, exist_ok=True)
            handle, name = tempfile.mkstemp(dir=self._folder)
            with os.fdopen(handle, "wb") as file:
                file.write(payload)
            Path(name).replace(self._folder / digest)
