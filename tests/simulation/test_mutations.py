"""A state machine with a broken rule is noticed: the histories are wild enough, and the invariants sharp."""

import pytest
from tests.simulation.mutations import MUTATIONS, Mutation, noticed
from tests.simulation.watch import INVARIANTS


@pytest.mark.parametrize("mutation", MUTATIONS, ids=lambda mutation: mutation.name)
def test_it_is_noticed_within_some_histories_to(mutation: Mutation) -> None:
    found = noticed(mutation)
    assert found is not None
    assert found[0] in INVARIANTS
