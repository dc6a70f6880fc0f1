"""Poses in a spec, each asked once."""

import msgspec
import numpy as np
import pytest
from tests.coordinator.searches.spaces import plain

from qdgrasp_coordinator.runs.preparation import full_spec
from qdgrasp_coordinator.searches.search import METHODS, check, method
from qdgrasp_protocol.errors import ImpossibleValue
from qdgrasp_protocol.spec import RunSpec, from_toml, to_toml

POSES = tuple(
    tuple(float(str(x)) for x in row) for row in np.random.default_rng(2).normal(size=(7, 9)).astype("f4")
)
SPEC = RunSpec(gripper="panda", object="mug", method="given", poses=POSES, evaluations=7, population=3)


def test_the_poses_of_a_spec_are_asked_in_their_order_bit_for_bit() -> None:
    search = method("given").build(from_toml(to_toml(SPEC)), plain(9))
    asked = [search.ask(generation) for generation in range(4)]
    assert [len(genomes) for genomes in asked] == [3, 3, 1, 0]
    assert (
        np.concatenate(asked).tobytes() == np.random.default_rng(2).normal(size=(7, 9)).astype("f4").tobytes()
    )


def test_each_pose_has_a_line_of_the_spec() -> None:
    lines = to_toml(SPEC).splitlines()
    assert lines[-9] == "poses = ["
    assert [len(line.split(",")) for line in lines[-8:-1]] == [10] * 7


def test_poses_are_for_the_method_given_and_needed_by_it() -> None:
    check(SPEC)
    with pytest.raises(ImpossibleValue, match="left out for method 'me_scs'"):
        check(msgspec.structs.replace(SPEC, method="me_scs"))
    with pytest.raises(ImpossibleValue, match="lists of numbers for method 'given'"):
        full_spec({"gripper": "panda", "object": "mug", "method": "given"})
    assert "given" not in METHODS


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"evaluations": 8}, "at most 7, one for each pose"),
        ({"poses": (*POSES[:6], (*POSES[6][:8], float("inf")))}, "finite"),
        ({"poses": (*POSES[:6], POSES[6][:8])}, "lists of 9 numbers"),
    ],
)
def test_poses_that_cannot_be_scored_are_refused(change: dict, words: str) -> None:
    with pytest.raises(ImpossibleValue, match=words):
        method("given").build(msgspec.structs.replace(SPEC, **change), plain(9))
