"""TOML from a stranger is refused with a sentence, and takes neither memory nor stack."""

import pytest

from qdgrasp_protocol import toml
from qdgrasp_protocol.errors import InputError


@pytest.mark.parametrize(
    "text",
    {
        "lists": "a=" + "[" * 20_000,
        "tables": "a=" + "{a=" * 20_000,
        "a dotted key": "a" + ".a" * 100_000 + "=1",
        "a dotted key in a table": "x = {b=1, a" + ".a" * 100_000 + "=1}",
        "a dotted header": "[a" + ".a" * 100_000 + "]",
        "a number without end": "a=" + "1" * 100_000,
        "too long": "#" * (toml.MAX_SIZE + 1),
        "no TOML": "a",
    }.values(),
    ids=lambda text: f"{text[:6]}-{len(text)}",
)
def test_toml_without_end_is_refused_in_one_sentence(text: str) -> None:
    with pytest.raises(InputError) as caught:
        toml.loads(text, "the spec")
    assert str(caught.value).startswith("the spec ")
    assert len(str(caught.value)) < 300


def test_long_lines_of_numbers_are_read() -> None:
    line = ", ".join(["0.125"] * 5000)
    assert len(toml.loads(f"poses = [{line}]\nat = 'a.b.c'", "the spec")["poses"]) == 5000
