"""Messages are the same after decoding, other bytes are refused; genomes and their values."""

from typing import Any

import msgpack
import msgspec
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tests.fakes.messages import KINDS

from qdgrasp_protocol import messages
from qdgrasp_protocol.build_messages import SAFE_NAME
from qdgrasp_protocol.errors import MessageError
from qdgrasp_protocol.messages import Joined, Message, Recorded, Result, shorten
from qdgrasp_protocol.rows import Gene, Layout


def values(kind: msgspec.inspect.Type) -> st.SearchStrategy[Any]:
    """Values that a field's type allows."""
    match kind:
        case msgspec.inspect.Metadata():
            return values(kind.type)
        case msgspec.inspect.IntType():
            return st.integers(kind.ge or 0, kind.le)
        case msgspec.inspect.FloatType(gt=float() | int()):
            return st.floats(kind.gt, kind.le, exclude_min=True)
        case msgspec.inspect.FloatType():
            return st.floats(kind.ge, kind.le, allow_nan=False)  # it is equal to nothing
        case msgspec.inspect.NoneType():
            return st.none()
        case msgspec.inspect.UnionType():
            return st.one_of([values(one) for one in kind.types])
        case msgspec.inspect.StrType(pattern=str(pattern)) if pattern == SAFE_NAME:
            return st.sampled_from(["mesh.stl", "parts/buffer 1.bin", "..a"])
        case msgspec.inspect.StrType(pattern=str(pattern)):
            return st.from_regex(pattern.replace(r"\A", "^").replace(r"\Z", "$"), fullmatch=True)
        case msgspec.inspect.StrType(max_length=int(most)):
            return st.text(max_size=most)
        case msgspec.inspect.StrType():
            return st.text(max_size=300).map(shorten)
        case msgspec.inspect.LiteralType():
            return st.sampled_from(kind.values)
        case msgspec.inspect.BytesType():
            return st.binary(min_size=kind.min_length or 0, max_size=kind.max_length or 100)
        case msgspec.inspect.BoolType():
            return st.booleans()
        case msgspec.inspect.ListType():
            return st.lists(values(kind.item_type), max_size=5)
        case msgspec.inspect.TupleType():
            return st.tuples(*map(values, kind.item_types))
        case msgspec.inspect.VarTupleType():
            most = min(5, 5 if kind.max_length is None else kind.max_length)
            return st.lists(values(kind.item_type), min_size=kind.min_length or 0, max_size=most).map(tuple)
        case msgspec.inspect.DictType():
            return st.dictionaries(values(kind.key_type), values(kind.value_type), max_size=5)
        case msgspec.inspect.StructType():
            return structs(kind.cls)
    raise AssertionError(f"no values for {kind}")


def structs(kind: type[msgspec.Struct]) -> st.SearchStrategy[Any]:
    """Messages of a kind, or parts of them, as the schema allows."""
    info = msgspec.inspect.type_info(kind)
    assert isinstance(info, msgspec.inspect.StructType)
    return st.builds(kind, **{field.name: values(field.type) for field in info.fields})


ANY_MESSAGE = st.one_of([structs(kind) for kind in KINDS])


@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(ANY_MESSAGE)
def test_every_kind_of_message_survives_the_trip(message: Message) -> None:
    assert messages.decode(messages.encode(message), type(message)) == message


REPORT = {"v": messages.VERSION, "epoch": 1, "run": "run", "durable": 1, "trouble": ""}


@pytest.mark.parametrize(
    "payload",
    {
        "nothing": b"",
        "never used": b"\xc1",
        "1 MB of empty lists": b"\x90" * (1 << 20),
        "1 MB of empty lists in lists": b"\xdc\x01\x00" + (b"\xdc\x0f\xff" + b"\x90" * 4095) * 256,
        "lists in lists in lists": b"\x91" * 5000,
        "maps in maps": b"\x81\xa1a" * 5000,
        "a list said to be long": b"\xdd\xff\xff\xff\xff",
        "a map said to be big": b"\xdf\xff\xff\xff\xff",
        "a list too long": msgpack.packb([0] * 4097),
        "a map too big": msgpack.packb({str(i): 0 for i in range(33)}),
        "a text too long": msgpack.packb("x" * 257),
        "a text that is none": b"\xa2\xff\xfe",
        "a blob too long": msgpack.packb(b"x" * ((1 << 20) + 1)),
        "an extension": msgpack.packb(msgpack.ExtType(5, b"x")),
        "an empty extension": b"\xc7\x00\x05",
        "a time": msgpack.packb(msgpack.Timestamp(1, 1)),
        "a key that is a number": msgpack.packb({1: 1}),
        "a key that is a blob": msgpack.packb({b"v": 1}),
        "two objects": msgpack.packb(REPORT) + b"\x00",
        "half an object": msgpack.packb(REPORT)[:-1],
        "a list": msgpack.packb([1, 2]),
        "17 MB": bytes(17 << 20),
    }.values(),
    ids=lambda payload: f"{payload[:8].hex()}-{len(payload)}",
)
def test_what_is_no_message_within_the_limits_is_refused(payload: bytes) -> None:
    for kind in (Recorded, Joined, Result):
        with pytest.raises(MessageError):
            messages.decode(payload, kind)


@pytest.mark.parametrize(
    "change",
    [
        {"v": 0},
        *({"epoch": epoch} for epoch in (-1, 2**63, 1.0, True, None)),
        *({"run": run} for run in ("", "Run", "run\n", "a/b", b"run")),
        *({"more": 1}, {"trouble": "x" * 201}),
    ],
)
def test_a_field_outside_the_schema_is_refused(change: dict[str, object]) -> None:
    messages.decode(msgpack.packb(REPORT), Recorded)
    with pytest.raises(MessageError, match="not a recorded"):
        messages.decode(msgpack.packb(REPORT | change), Recorded)


@pytest.mark.parametrize("version", [messages.VERSION - 1, messages.VERSION + 1])
def test_a_message_of_another_version_is_refused_as_such(version: int) -> None:
    with pytest.raises(MessageError, match=f"of version {version} of the protocol, and this package speaks"):
        messages.decode(msgpack.packb(REPORT | {"v": version, "more": 1}), Recorded)


def test_what_others_wrote_is_repeated_without_control_characters_and_not_at_length() -> None:
    evil = "\x1b[2J\n" + 200 * "ü"
    with pytest.raises(MessageError) as caught:
        messages.decode(msgpack.packb(REPORT | {evil[:100]: 1}), Recorded)
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 250


@pytest.mark.parametrize(
    "payload",
    [
        b"\xdc\xff\xff" + b"\x90" * 0xFFFF + b"\x90" * 9,
        b"\x92" + (b"\xdc\xff\xff" + b"\x90" * 0xFFFF) * 2,
        b"\xdd\x04\x00\x00\x00" + bytes(64 << 20),
        b"\x91" * 100_000,
        b"",
    ],
    ids=["more than one", "many lists", "a long list", "lists in lists", "nothing"],
)
def test_a_scene_that_unfolds_without_end_is_refused(payload: bytes) -> None:
    with pytest.raises(MessageError):
        messages.check_bundle(payload)


LAYOUT = Layout("contact", (Gene("x", -0.13, 0.21), Gene("omega", 0.0, 2 * np.pi), Gene("synergy", 0.0, 0.0)))


def test_genomes_of_values_stand_for_these_values() -> None:
    genomes = np.random.default_rng(0).uniform(-1, 1, (500, 3)).astype(np.float32)
    values = LAYOUT.values(genomes)
    assert LAYOUT.values(LAYOUT.genomes(values)) == pytest.approx(values, abs=1e-6)
    assert LAYOUT.genomes(values).dtype == np.float32
