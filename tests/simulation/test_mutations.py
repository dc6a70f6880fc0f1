"""A state machine with a broken rule is noticed: the histories are wild enough, and the invariants sharp."""

from pathlib import Path

import pytest
from tests.simulation.invariants import INVARIANTS
from tests.simulation.mutations import MUTATIONS, Mutation, noticed


@pytest.mark.parametrize("mutation", MUTATIONS, ids=lambda mutation: mutation.name)
def test_it_is_noticed_within_some_histories_to(mutation: Mutation) -> None:
    found = noticed(mutation)
    assert found is not None
    assert found[0] in INVARIANTS


def test_the_page_names_every_invariant_and_every_mutation() -> None:
    page = (Path(__file__).resolve().parents[2] / "docs" / "simulation.md").read_text(encoding="utf-8")
    missing = [name for name in (*INVARIANTS, *(m.name for m in MUTATIONS)) if f"| {name} |" not in page]
    assert missing == []
