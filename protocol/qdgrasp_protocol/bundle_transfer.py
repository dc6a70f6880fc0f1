"""Transfer of scene bundles over the bus, by their sha256, a query per chunk (docs/bus.md)."""

import hashlib
import os
from pathlib import Path

from qdgrasp_protocol import messages
from qdgrasp_protocol.bus import Bus, Query
from qdgrasp_protocol.errors import MessageError, Refused
from qdgrasp_protocol.keys import Keys, last_chunk, parse_number
from qdgrasp_protocol.messages import Chunk

CHUNK_SIZE = 512 << 10  # Bytes of a bundle in one answer


class TooLarge(MessageError):
    """A scene that is larger than one can be, by its number of chunks."""

    def __init__(self, total: int) -> None:
        super().__init__(f"the scene has {total} chunks, more than {messages.MAX_BUNDLE // CHUNK_SIZE}")


def answer_chunk(query: Query, payload: bytes, digest: str) -> bytes:
    """The chunk of a bundle that a query names by `i=<number>`; Refused if there is no such one."""
    if last_chunk(query.key) != digest:
        raise Refused("no such scene here")
    total, start = _place(query, len(payload))
    return messages.encode(Chunk(total=total, data=payload[start : start + CHUNK_SIZE]))


def answer_file_chunk(query: Query, path: Path) -> bytes:
    """The chunk of a file that a query names by `i=<number>`; Refused without one.

    The file may have changed: its sha256 is compared where it is fetched. Refused also without a file.
    """
    try:
        with path.open("rb") as file:
            total, start = _place(query, os.fstat(file.fileno()).st_size)
            file.seek(start)
            return messages.encode(Chunk(total=total, data=file.read(CHUNK_SIZE)))
    except OSError as error:
        raise Refused(f"the file {path.name} cannot be read: {error.strerror or error}") from None


def _place(query: Query, size: int) -> tuple[int, int]:
    """The number of chunks of so many bytes, and where the one that a query names begins."""
    total = max(1, -(-size // CHUNK_SIZE))
    place = parse_number(query.parameters.removeprefix("i="))
    if place is None or place >= total:
        raise Refused(f"chunk '{query.parameters[:20]}' is not one of {total}")
    return total, place * CHUNK_SIZE


def fetch_bundle(bus: Bus, job: str, digest: str) -> bytes:
    """All bytes of a bundle, from the coordinator of a job; raises as `fetch_bundle_from`."""
    return fetch_bundle_from(bus, Keys(job).asset(digest), digest)


def fetch_bundle_from(bus: Bus, key: str, digest: str) -> bytes:
    """All bytes of a bundle, from the process that answers on `key`.

    NoReply or Refused if there is no such scene, TooLarge if it cannot be one, a MessageError if what came is
    not the scene of that digest.
    """
    first = messages.decode(bus.ask(key, parameters="i=0"), Chunk)
    if first.total * CHUNK_SIZE > messages.MAX_BUNDLE:
        raise TooLarge(first.total)
    rest = [messages.decode(bus.ask(key, parameters=f"i={i}"), Chunk).data for i in range(1, first.total)]
    payload = b"".join([first.data, *rest])
    if hashlib.sha256(payload).hexdigest() != digest:
        raise MessageError(f"the scene that came is not {digest[:12]}")
    return payload
