"""Transfer of scene bundles over the bus: content-addressed, one query per chunk (docs/bus.md, keys)."""

import hashlib

from qdgrasp_protocol import messages
from qdgrasp_protocol.bus import Bus, Query
from qdgrasp_protocol.errors import MessageError, Refused
from qdgrasp_protocol.keys import Keys, last_chunk, parse_number
from qdgrasp_protocol.messages import Chunk

CHUNK_SIZE = 512 << 10  # Bytes of a bundle in one answer


class TooLarge(MessageError):
    """Error for a scene larger than the limit.

    Parameters
    ----------
    total
        Its number of chunks.
    """

    def __init__(self, total: int) -> None:
        super().__init__(f"the scene has {total} chunks, more than {messages.MAX_BUNDLE // CHUNK_SIZE}")


def answer_chunk(query: Query, payload: bytes, digest: str) -> bytes:
    """Return the chunk of a bundle that a query names by `i=<number>`.

    Raises
    ------
    Refused
        It asks for another bundle, or for a chunk that this one does not have.
    """
    if last_chunk(query.key) != digest:
        raise Refused("no such scene here")
    total = max(1, -(-len(payload) // CHUNK_SIZE))
    place = parse_number(query.parameters.removeprefix("i="))
    if place is None or place >= total:
        raise Refused(f"chunk '{query.parameters[:20]}' is not one of {total}")
    start = place * CHUNK_SIZE
    return messages.encode(Chunk(total=total, data=payload[start : start + CHUNK_SIZE]))


def fetch_bundle(bus: Bus, job: str, digest: str) -> bytes:
    """Fetch all bytes of a bundle from the coordinator of a job; raises as `gather`."""
    return fetch_bundle_from(bus, Keys(job).asset(digest), digest)


def fetch_bundle_from(bus: Bus, key: str, digest: str) -> bytes:
    """Fetch all bytes of a bundle, chunk by chunk, from `key`.

    Raises
    ------
    NoReply, Refused
        `key` is not answered, or there is no such scene.
    TooLarge
        It is larger than a scene can be.
    MessageError
        The bytes are not the scene of that digest.
    """
    first = messages.decode(bus.ask(key, parameters="i=0"), Chunk)
    if first.total * CHUNK_SIZE > messages.MAX_BUNDLE:
        raise TooLarge(first.total)
    rest = [messages.decode(bus.ask(key, parameters=f"i={i}"), Chunk).data for i in range(1, first.total)]
    payload = b"".join([first.data, *rest])
    if hashlib.sha256(payload).hexdigest() != digest:
        raise MessageError(f"the scene that came is not {digest[:12]}")
    return payload
