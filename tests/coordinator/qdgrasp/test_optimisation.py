"""The search of a program is checked before there is a folder."""

from pathlib import Path
from typing import Any

import pytest

import qdgrasp

SCENE: dict[str, Any] = {"gripper": "panda", "object": "tennis_ball"}


class Uniform:
    """A search that is never asked here."""

    def __init__(self, layout: qdgrasp.Layout) -> None:
        self.layout = layout

    def ask(self, generation: int) -> Any:
        raise NotImplementedError

    def tell(self, generation: int, rows: qdgrasp.Rows) -> None:
        raise NotImplementedError


BAD: dict[str, tuple[dict[str, Any], str]] = {
    "no function": ({"make": 3}, "make must be a class or function that is called with the genes, got 3"),
    "no search": ({"make": len}, "The result of make, 7, has no ask and no tell"),
    "a search that hears nothing": ({"make": lambda genes: iter(genes.names)}, "has no ask and no tell"),
    "no prior": ({"prior": ["contact"]}, "Unknown prior"),
    "no budget": (
        {"evaluations": 0},
        "evaluations must be a whole number at least 1, got 0",
    ),
    "no gripper": ({"gripper": None}, "'gripper' is missing; say gripper=... with a name or a file"),
    "nobody": ({"place": qdgrasp.Place(workers=0)}, "has no workers: start some, or name a router"),
    "a hand that has no jaw": ({"gripper": "allegro", "prior": "antipodal"}, "is for two-finger hands"),
}


@pytest.mark.parametrize(("changed", "why"), BAD.values(), ids=BAD)
def test_what_cannot_be_searched_with_is_refused_and_leaves_no_folder(changed, why, tmp_path) -> None:
    given = {"make": Uniform, "out": tmp_path / "run", "evaluations": 10} | SCENE | changed
    with pytest.raises(qdgrasp.InputError, match=why):
        qdgrasp.optimise(given.pop("make"), given.pop("out"), **given)
    assert list(tmp_path.iterdir()) == []


def test_what_a_program_raises_itself_goes_through_and_leaves_no_folder(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError):
        qdgrasp.optimise(lambda genes: 1 / 0, tmp_path / "run", evaluations=10, **SCENE)
    assert list(tmp_path.iterdir()) == []
