from typing import Any

import numpy as np
import pytest
from tests.coordinator.analysis.runs import climb, made

from qdgrasp_coordinator.analysis.curves import COVERAGE, curve
from qdgrasp_coordinator.analysis.entries import Entry, entries
from qdgrasp_coordinator.analysis.history import History
from qdgrasp_coordinator.analysis.pooled import pooled
from qdgrasp_coordinator.analysis.reference import ReferenceSet
from qdgrasp_coordinator.analysis.target import Target


def covered(thing: str, size: int, *found: int, seed: int = 0, **settings: Any) -> History:
    """A run that finds so many entries of a set, ten evaluations each."""
    known = ReferenceSet(thing, np.zeros((size, 3), np.int64), np.zeros(size, np.uint8))
    values: dict[str, Any] = {"method": "me_scs", "object": thing, "target": Target(known)} | settings
    method = values.pop("method")
    return made(method, climb(1), seed, found=climb(*found), published=climb(*found), **values)


def pool(*runs: History) -> list[Entry]:
    return pooled(entries(runs))


def test_each_object_counts_alike_however_large_its_set() -> None:
    (entry,) = pool(covered("mug", 10, 1, 2), covered("bowl", 1000, 200, 600))
    assert entry.scene.words == "jaw on 2 objects"
    (run,) = entry.runs
    assert run.coverage([0, 10, 15, 20]).tolist() == pytest.approx([0, 0.15, 0.15, 0.4])
    assert run.published_coverage(20) == pytest.approx(0.4)
    assert curve(entry, COVERAGE).median[-1] == pytest.approx(0.4)


def test_a_pooled_run_is_as_long_as_the_shortest_and_finished_when_all_are() -> None:
    (entry,) = pool(covered("mug", 10, 1), covered("bowl", 10, 1, evaluations=60))
    assert (entry.runs[0].evaluations, entry.unfinished) == (60, 1)


def test_objects_without_a_set_and_objects_that_a_method_lacks_are_left_out() -> None:
    both = [
        covered(thing, 10, 1, method=name) for thing in ("mug", "bowl") for name in ("me_scs", "contact_rand")
    ]
    lone = [covered("can", 10, 9, method="me_scs"), made("me_scs", climb(1), object="box")]
    found = pool(*both, *lone, *(made("contact_rand", climb(1), object="box"),))
    assert [(entry.method, entry.scene.object) for entry in found] == [
        ("contact_rand", "2 objects"), ("me_scs", "2 objects"),
    ]  # fmt: skip
    assert found[1].runs[0].coverage(100) == pytest.approx(0.1)


def test_seeds_that_not_every_object_has_are_left_out() -> None:
    runs = [covered("mug", 10, 1, seed=seed) for seed in (0, 1)]
    (entry,) = pool(*runs, covered("bowl", 10, 1, seed=1), covered("bowl", 10, 1, seed=0, evaluations=0))
    assert [run.spec.seed for run in entry.runs] == [1]


def test_one_object_makes_no_mean() -> None:
    assert pool(covered("mug", 10, 1), covered("mug", 10, 2, gripper="claw"), made("me_scs", climb(1))) == []
