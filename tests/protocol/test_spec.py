import math
from pathlib import Path
from typing import get_args

import pytest
from hypothesis import given
from hypothesis import strategies as st

from qdgrasp_protocol import spec
from qdgrasp_protocol.errors import ImpossibleValue, InputError
from qdgrasp_protocol.spec import (
    AimFor,
    DiversityName,
    Overlaps,
    ProtocolName,
    RunSpec,
    from_toml,
    read_run_spec,
    run_spec,
    to_toml,
)

LEAST = {"gripper": "panda", "object": "mug"}
POSITIVE = {"min_value": 1e-6, "allow_nan": False}
SPECS = st.builds(
    RunSpec,
    gripper=st.text(),
    object=st.text(),
    mass=st.none() | st.floats(max_value=1000, **POSITIVE),
    scale=st.none() | st.floats(max_value=1_000_000, **POSITIVE),
    friction=st.none() | st.floats(max_value=10, **POSITIVE),
    method=st.text(),
    protocol=st.sampled_from(get_args(ProtocolName)),
    aim_for=st.none() | st.sampled_from(get_args(AimFor)),
    diversity=st.none() | st.sampled_from(get_args(DiversityName)),
    evaluations=st.integers(1, 10**9),
    seed=st.integers(0, 2**63 - 1),
    overlaps=st.sampled_from(get_args(Overlaps)),
    population=st.integers(1, 4096),
    mutation_sigma=st.floats(max_value=2, **POSITIVE),
    mutation_probability=st.floats(max_value=1, **POSITIVE),
    generations_in_flight=st.integers(1, 16),
    in_flight=st.none() | st.integers(1, 100_000),
    surface_seed=st.integers(0, 2**63 - 1),
    poses=st.none()
    | st.lists(st.lists(st.floats(width=32, allow_nan=False)).map(tuple), min_size=1).map(tuple),
)


@given(SPECS)
def test_a_spec_comes_back_from_its_toml(spec: RunSpec) -> None:
    assert from_toml(to_toml(spec)) == spec


@pytest.mark.parametrize(
    ("key", "value", "expected"),
    [
        ("evaluations", 0, "a whole number at least 1"),
        ("evaluations", "100", "a whole number"),
        ("evaluations", True, "a whole number"),
        ("evaluations", 10**30, "a whole number"),
        ("mass", math.nan, "a number greater than 0 and at most 1000"),
        ("protocol", "papr", "one of 'lift', 'paper'"),
        (
            "mesh",
            {"simplify": 3},
            "a table of simplify (a whole number at least 20 and at most 500000), remesh",
        ),
        ("resting_pose", "all", "a whole number at least 0 and less than 100, or one of 'any'"),
        ("poses", [[0.0]] * 5000, "lists of numbers"),
        ("gripper", 3, "text"),
    ],
)
def test_an_impossible_value_is_refused_with_what_is_possible(key: str, value: object, expected: str) -> None:
    with pytest.raises(ImpossibleValue) as caught:
        run_spec(LEAST | {key: value})
    assert str(caught.value).startswith(f"spec: {key} must be {expected}")
    assert caught.value.exit_code == 2


def test_a_table_has_hands_come_from_a_tenth_of_a_metre_unless_another_way_is_said() -> None:
    assert run_spec(LEAST).approach == 0.0
    assert run_spec(LEAST | {"resting_pose": "any"}).approach == 0.1
    assert run_spec(LEAST | {"resting_pose": 2, "approach_distance": 0}).approach == 0.0
    assert run_spec(LEAST | {"approach_distance": 0.05}).approach == 0.05
    device = LEAST | {"engine": "mujoco-warp", "protocol": "physical"}
    assert run_spec(device | {"resting_pose": 0, "approach_distance": 0}).approach == 0.0
    with pytest.raises(InputError, match="does not look at the way of a hand"):
        run_spec(device | {"approach_distance": 0.1})


def test_a_file_that_is_missing_or_no_toml_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"No spec can be read at '.*none\.toml': No such file"):
        read_run_spec(tmp_path / "none.toml")
    with pytest.raises(InputError, match="Is a directory"):
        read_run_spec(tmp_path)
    for content in (b"gripper = ", b"\xff\xfe", b"a = 1\na = 2"):
        (tmp_path / "bad.toml").write_bytes(content)
        with pytest.raises(InputError, match=r"bad\.toml"):
            read_run_spec(tmp_path / "bad.toml")
    with pytest.raises(InputError, match="spec is not TOML"):
        from_toml("gripper = ")


@pytest.mark.parametrize(
    "text",
    {
        "lists": "a=" + "[" * 20_000,
        "a dotted key": "a" + ".a" * 100_000 + "=1",
        "a dotted key in a table": "x = {b=1, a" + ".a" * 100_000 + "=1}",
        "a number without end": "a=" + "1" * 100_000,
        "too long": "#" * (spec.MAX_TOML_SIZE + 1),
    }.values(),
    ids=lambda text: f"{text[:6]}-{len(text)}",
)
def test_toml_without_end_is_refused_in_one_sentence(text: str) -> None:
    with pytest.raises(InputError) as caught:
        spec.parse_toml(text, "the spec")
    assert str(caught.value).startswith("the spec ")
    assert len(str(caught.value)) < 300


def test_every_key_that_a_person_types_has_a_text_and_its_values() -> None:
    assert spec.key_texts().keys() == set(RunSpec.__struct_fields__) - set(spec.UNTYPED_KEYS)
