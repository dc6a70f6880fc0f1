"""What a program gives to be scored, and searches with, is looked at before anything is started."""

from pathlib import Path
from typing import Any

import pytest

import qdgrasp
from qdgrasp_protocol.errors import InputError

ABOVE, DOWN = [[0.0, 0.0, 0.15]], [[1.0, 0.0, 0.0, 0.0]]
BAD = {
    "a ragged list": ({"positions": [[0, 0, 1], [1]]}, "positions must be numbers of shape"),
    "a word": ({"positions": "abc"}, "positions must be numbers of shape"),
    "words": ({"spreads": [["a"]]}, "spreads must be numbers of shape"),
    "half a label": ({"synergies": [0.5]}, "synergies must be integers, got 0.5"),
    "a number that is not real": ({"positions": [[0j, 0, 1]]}, "its type is complex128"),
    "a place that is far": ({"positions": [[0, 0, 1e30]]}, "positions must be no more than 1000 m away"),
    "no pose": ({"positions": [[]] * 0}, "positions must be numbers of shape"),
    "another keyword": ({"colour": 3}, "Unknown keyword 'colour'"),
    "no object": ({"object": None}, "'object' is missing; say object=... with a name or a file"),
    "nobody who evaluates": ({"place": qdgrasp.Place(workers=0)}, "has nobody who evaluates"),
}


@pytest.mark.parametrize(("changed", "why"), BAD.values(), ids=BAD)
def test_what_cannot_be_scored_is_refused(changed: dict[str, Any], why: str) -> None:
    asked = {"positions": ABOVE, "quaternions_xyzw": DOWN, "gripper": "panda", "object": "mug"} | changed
    with pytest.raises(InputError, match=why):
        qdgrasp.evaluate(**asked)


def test_keywords_that_are_known_are_those_of_the_scenery() -> None:
    with pytest.raises(InputError) as refused:
        qdgrasp.Evaluations(gripper="panda", object="mug", colour=3)  # type: ignore[call-arg]
    assert "evaluations" not in str(refused.value)
    assert "surface_seed" in str(refused.value)


def test_a_synergy_of_a_hand_that_has_none_is_refused() -> None:
    place = qdgrasp.Place(workers=0)
    with pytest.raises(InputError, match="synergies must be -1, for the hand has none, got 5"):
        qdgrasp.evaluate(ABOVE, DOWN, synergies=[5], place=place, gripper="panda", object="tennis_ball")


def test_a_free_joint_of_a_hand_that_has_none_is_refused() -> None:
    place = qdgrasp.Place(workers=0)
    with pytest.raises(InputError, match="spreads must be NaN, for the hand has no free joints"):
        qdgrasp.evaluate(ABOVE, DOWN, spreads=[[0.3]], place=place, gripper="panda", object="tennis_ball")


def test_time_that_is_over_is_said_in_words() -> None:
    place = qdgrasp.Place(workers=0)
    with (
        qdgrasp.Evaluations(prior="given", place=place, gripper="panda", object="tennis_ball") as evaluations,
        pytest.raises(TimeoutError, match="After 0 s there are not all rows of 1 genome"),
    ):
        evaluations.evaluate([[*ABOVE[0], *DOWN[0]]], timeout=0.0)


class Narrow:
    """Asks for genomes that have too few genes."""

    def __init__(self, layout: qdgrasp.Layout) -> None:
        pass

    def ask(self, generation: int) -> Any:
        return [[0.0]]

    def tell(self, generation: int, rows: qdgrasp.Rows) -> None:
        pass


def test_after_a_search_that_asked_wrongly_it_is_said_how_to_go_on(tmp_path: Path) -> None:
    def attempt() -> str:
        place = qdgrasp.Place(workers=1)
        with pytest.raises(InputError) as refused:
            qdgrasp.optimise(
                Narrow, tmp_path / "out", evaluations=10, place=place, gripper="panda", object="tennis_ball"
            )
        return str(refused.value)

    assert "genomes must be" in attempt()
    assert "resume=True goes on with it" in attempt()
