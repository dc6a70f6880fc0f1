"""A state machine with a broken rule is noticed: the histories are wild enough, and the invariants sharp."""

from pathlib import Path
from unittest.mock import patch

import pytest
from tests.simulation.invariants import INVARIANTS
from tests.simulation.mutations import MUTATIONS, Mutation, noticed

from qdgrasp_coordinator.dispatching.batch import Settlement
from qdgrasp_coordinator.dispatching.tickets import Tickets


@pytest.mark.parametrize("mutation", MUTATIONS, ids=lambda mutation: mutation.name)
def test_it_is_noticed_within_some_histories_to(mutation: Mutation) -> None:
    assert noticed(mutation) is not None


def test_an_invariant_that_is_not_to_notice_a_mutation_does_not_count() -> None:
    def fail(*_: object) -> Settlement:
        raise ZeroDivisionError

    for invariants, count in ((("settled once",), None), (("no machine fails",), 1)):
        mutation = Mutation("fail", "5", invariants, lambda: [patch.object(Tickets, "judge", fail)])
        found = noticed(mutation, most=3)
        assert (found and found[1]) == count


def test_every_invariant_is_to_notice_something() -> None:
    assert {name for mutation in MUTATIONS for name in mutation.invariants} == set(INVARIANTS)


def test_the_page_names_every_invariant_and_every_mutation() -> None:
    page = (Path(__file__).resolve().parents[2] / "docs" / "simulation.md").read_text(encoding="utf-8")
    missing = [name for name in (*INVARIANTS, *(m.name for m in MUTATIONS)) if f"| {name} |" not in page]
    assert missing == []
