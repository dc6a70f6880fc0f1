import hashlib

import pytest

from qdgrasp_protocol import bundle_transfer, messages
from qdgrasp_protocol.bus import Query
from qdgrasp_protocol.errors import MessageError, NoReply, Refused
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.memory_bus import MemoryNetwork
from qdgrasp_protocol.messages import Chunk

KEYS = Keys("mugs")


def digest(payload: bytes) -> str:
    return hashlib.sha256(payload).hexdigest()


@pytest.mark.parametrize(
    "length",
    [
        0,
        1,
        bundle_transfer.CHUNK_SIZE - 1,
        bundle_transfer.CHUNK_SIZE,
        bundle_transfer.CHUNK_SIZE + 1,
        3 * bundle_transfer.CHUNK_SIZE,
    ],
)
def test_a_bundle_of_any_length_arrives_whole(length: int) -> None:
    payload = bytes(i % 251 for i in range(length))
    network = MemoryNetwork()
    with network.session() as coordinator, network.session() as worker:
        coordinator.answer(
            KEYS.asset(), lambda query: bundle_transfer.answer_chunk(query, payload, digest(payload))
        )
        assert bundle_transfer.fetch_bundle(worker, "mugs", digest(payload)) == payload


@pytest.mark.parametrize("parameters", ["", "i=", "i=2", "i=-1", "i=x", "j=0", "i=²"])
def test_a_chunk_that_there_is_not_is_refused(parameters: str) -> None:
    with pytest.raises(Refused, match="is not one of 2"):
        bundle_transfer.answer_chunk(
            Query(KEYS.asset("a"), parameters, b""), bytes(bundle_transfer.CHUNK_SIZE + 1), "a"
        )


def test_another_scene_is_refused() -> None:
    with pytest.raises(Refused, match="no such scene"):
        bundle_transfer.answer_chunk(Query(KEYS.asset("b"), "i=0", b""), b"scene", "a")


def test_what_is_not_the_scene_of_its_digest_is_refused() -> None:
    network = MemoryNetwork()
    with network.session() as bus:
        with pytest.raises(NoReply):
            bundle_transfer.fetch_bundle(bus, "mugs", "a" * 64)
        bus.answer(KEYS.asset(), lambda query: messages.encode(Chunk(total=1, data=b"another")))
        with pytest.raises(MessageError, match="is not aaaaaaaaaaaa"):
            bundle_transfer.fetch_bundle(bus, "mugs", "a" * 64)


def test_a_scene_that_is_said_to_be_too_large_is_not_even_fetched() -> None:
    asked = []

    def answer(query: Query) -> bytes:
        asked.append(query.parameters)
        return messages.encode(Chunk(total=4096, data=b""))

    with MemoryNetwork().session() as bus:
        bus.answer(KEYS.asset(), answer)
        with pytest.raises(MessageError, match="4096 chunks, more than 256"):
            bundle_transfer.fetch_bundle(bus, "mugs", "a" * 64)
    assert asked == ["i=0"]
