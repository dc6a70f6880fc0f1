"""The table of a campaign's objects: states, sums, and why some got little."""

from typing import Any

import pytest
from msgspec import structs
from tests.coordinator.recorded_campaigns import ObjectRun, listed

from qdgrasp_coordinator.metrics.job_status import ObjectListing
from qdgrasp_coordinator.metrics.run_stats import NO_TOTALS, RunTotals
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_tools.campaign.summaries import table_lines

BUDGET = 4000


def totals(**counts: int) -> RunTotals:
    return structs.replace(NO_TOTALS, **({"evaluations": BUDGET, "simulated": BUDGET} | counts))


GOOD = totals(successes=2000, grasps=1000, robust=500, cells=200)


def run(object_: str = "mug", hand: str = "panda", seed: int = 0, **more: Any) -> ObjectRun:
    """A finished run that found much, unless `more` says otherwise; `spec` are more values of its spec."""
    spec = RunSpec(gripper=hand, object=object_, seed=seed, evaluations=BUDGET, **more.pop("spec", {}))
    made = ObjectRun(f"{hand}-{object_.rpartition('/')[2]}-s{seed}", spec, GOOD, is_done=True)
    return made._replace(**more)


def waiting(object_: str = "mug", **more: Any) -> ObjectRun:
    return run(object_, totals=None, is_done=False, **more)


def one(*runs: ObjectRun, **more: Any) -> ObjectListing:
    (listing,) = listed(runs, **more)
    return listing


def many(**named: RunTotals) -> dict[str, ObjectListing]:
    """Objects with one finished run each, by name, beside three that got much."""
    counts = {"a": GOOD, "b": GOOD, "c": GOOD} | named
    return {each.object: each for each in listed(run(name, totals=one) for name, one in counts.items())}


def test_the_runs_of_an_object_are_added_up() -> None:
    half = structs.replace(GOOD, evaluations=BUDGET // 2, errors=3)
    found = one(run(), run(hand="allegro", totals=half, is_done=False), waiting(seed=1))
    assert (found.evaluations, found.cells, found.errors) == (6000, 400, 3)
    assert (found.runs, found.runs_done, found.state, found.hands) == (3, 1, "running", ["panda", "allegro"])
    assert found.success_share == pytest.approx(4000 / 6000)
    assert found.grasps == 2000
    assert found.names == ["panda-mug-s0", "allegro-mug-s0", "panda-mug-s1"]


def test_the_regions_of_runs_are_a_column_where_there_are_some() -> None:
    plain, handle = run("box"), run("mug", spec={"on": ("/home/me/handle.ply",), "avoid": ("rim",)})
    head, *lines = table_lines(listed([plain, handle, run("mug", seed=1)]))
    assert "regions" in head.split()
    assert ["on handle.ply, avoid rim" in line for line in lines] == [False, True]
    assert "regions" not in table_lines(listed([plain]))[0]


OVERLAPPING = totals(simulated=100, overlaps=3900)
NO_POSES = totals(simulated=0, dead_ends=4000)
UNTOUCHED = totals(successes=3, grasps=3, cells=2)
DROPPED = totals(successes=3800, cells=150)
ERRORS = totals(simulated=0, errors=4000)
NARROW = totals(successes=2000, grasps=1000, cells=4)


@pytest.mark.parametrize(
    ("found", "reason"),
    [
        (OVERLAPPING, "no grasp: the open hand overlaps it in 3900 of 4000 poses"),
        (NO_POSES, "no grasp: 4000 of 4000 genomes led to no pose"),
        (UNTOUCHED, "few grasps: 3 of 4000 simulations touched it"),
        (DROPPED, "no grasp: it was dropped in 3800 of 3800 successes"),
        (ERRORS, "no grasp: the simulator failed on 4000 of 4000 rows"),
        (NARROW, "few cells: 2000 successes in 4 cells, 0 contact niches"),
        (NO_TOTALS, "no grasp: no row is recorded"),
        (GOOD, ""),
    ],
)
def test_an_object_that_got_little_says_why(found: RunTotals, reason: str) -> None:
    assert many(x=found)["x"].little == reason
    assert [each.object for each in many(x=found).values() if each.little] == (["x"] if reason else [])


def test_an_object_is_judged_by_its_finished_runs_alone() -> None:
    """Of three runs one is over: what the others have got so far does not count against it."""
    begun = run("x", seed=1, totals=totals(evaluations=10), is_done=False)
    assert not listed([run("a"), run("b"), run("x"), begun, waiting("x", seed=2)])[2].little
    assert not listed([run("a"), run("x", totals=OVERLAPPING, is_done=False)])[1].little
