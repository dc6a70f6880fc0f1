"""Plans of runs from specs, and the queue of a job with one run."""

from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from qdgrasp_coordinator.scheduler.run_plan import ReevaluationPlan, full_spec, prepare_scene
from qdgrasp_coordinator.search.registry import METHODS
from qdgrasp_protocol.errors import ImpossibleValue, InputError, JawNeeded
from qdgrasp_protocol.messages import Failure
from qdgrasp_protocol.rows import Outcome, Rows, RowShape

ASKED = {"gripper": "panda", "object": "tennis_ball"}


@pytest.mark.parametrize("entry", METHODS.values(), ids=METHODS)
def test_the_spec_is_completed_with_what_the_method_has(entry) -> None:
    spec = full_spec({**ASKED, "method": entry.name})
    assert (spec.population, spec.overlaps) == (entry.population, entry.overlaps)
    assert (spec.generations_in_flight, spec.aim_for) == (entry.generations_in_flight, entry.aim_for)


def test_more_genomes_in_flight_are_taken_for_granted_where_nothing_is_said_of_them() -> None:
    """A recorded spec has all keys; where one is given, the others keep their older defaults."""
    assert full_spec(dict(ASKED)).in_flight == METHODS["portfolio"].in_flight
    for said in ({"population": 50}, {"generations_in_flight": 2}, {"in_flight": None}):
        assert full_spec(ASKED | said).in_flight is None
    assert full_spec({**ASKED, "generations_in_flight": 2, "in_flight": 100}).in_flight == 100


@pytest.mark.parametrize(
    ("key", "value"), [("population", 500), ("generations_in_flight", 2), ("in_flight", 1080)]
)
def test_what_the_method_cannot_do_is_refused(key, value) -> None:
    with pytest.raises(ImpossibleValue, match=rf"^{key} must be .*cma_mae"):
        full_spec({**ASKED, "method": "contact_cma_mae", key: value})


def jawless(folder: Path) -> Path:
    """The built-in Panda, not told to be a two-finger hand."""
    built_in = Path(str(files("qdgrasp_assets") / "grippers"))
    (folder / "panda.urdf").write_text((built_in / "panda.urdf").read_text())
    toml = folder / "hand.toml"
    before, _, jaw = (built_in / "panda.toml").read_text().partition("[jaw]")
    toml.write_text(before + jaw[jaw.index("[joints") :])
    return toml


def test_a_hand_without_a_jaw_is_refused_by_antipodal_methods_alone(tmp_path) -> None:
    asked = {**ASKED, "gripper": str(jawless(tmp_path))}
    prepare_scene(full_spec({**asked, "method": "approach_rand"}))
    with pytest.raises(JawNeeded, match=r"'antipodal' is for two-finger hands, and the gripper 'hand'"):
        prepare_scene(full_spec({**asked, "method": "antipodal_me_scs"}))


@pytest.mark.parametrize(
    ("pose", "words"),
    [((1e6, 0, 0, 0, 0, 0, 1), "poses: positions must be no more"), ((0,) * 7, "of length zero")],
)
def test_poses_of_a_spec_that_no_hand_can_take_end_the_run_before_it_begins(pose, words) -> None:
    spec = full_spec({**ASKED, "method": "given", "evaluations": 1, "poses": [pose]})
    with pytest.raises(InputError, match=words):
        prepare_scene(spec)


SHAPE = RowShape(genes=2, joints=1)
N = 9


@pytest.fixture
def recorded() -> Rows:
    """Rows of two generations, some of them trials of one grasp."""
    rows = SHAPE.empty(N)
    rows["generation"], rows["index"] = 3 + np.arange(N) // 6, np.arange(N) % 6
    rows["trial"][4:] = np.arange(1, N - 3)
    rows["genome"] = np.linspace(-1, 1, 2 * N).reshape(N, 2)
    return rows


@pytest.fixture
def heard() -> list[tuple[int, np.void, str]]:
    """Places, rows and reasons that were compared."""
    return []


@pytest.fixture
def repetition(recorded: Rows, heard: list[tuple[int, np.void, str]]) -> ReevaluationPlan:
    return ReevaluationPlan(full_spec(ASKED), recorded, lambda *compared: heard.append(compared))


def evaluated(repetition: ReevaluationPlan) -> Rows:
    """Return the asked rows as a worker evaluates them."""
    asked = repetition.ask()
    rows = SHAPE.empty(len(asked.indices))
    rows["generation"], rows["index"] = asked.number, asked.indices
    rows["trial"], rows["genome"] = asked.trials, asked.genomes
    rows["outcome"] = Outcome.HELD
    return rows


def test_each_row_is_asked_in_its_trial_once(recorded, repetition) -> None:
    asked = repetition.ask()
    assert asked.trials.tolist() == recorded["trial"].tolist()
    assert asked.genomes.tobytes() == recorded["genome"].tobytes()
    assert len(set(asked.indices.tolist())) == N
    assert repetition.ask() is None


def test_rows_are_compared_with_those_of_their_places_in_any_order(recorded, repetition, heard) -> None:
    shuffled = evaluated(repetition)[np.random.default_rng(0).permutation(N)]
    for part in (shuffled[:4], shuffled[4:]):
        assert len(repetition.settle(part)) == 0
    assert sorted(place for place, *_ in heard) == list(range(N))
    for place, row, _ in heard:
        assert row["genome"].tobytes() == recorded["genome"][place].tobytes()


def test_a_row_that_comes_twice_is_compared_once(repetition, heard) -> None:
    rows = evaluated(repetition)
    for part in (rows[:5], rows[:5], rows[3:]):
        repetition.settle(part)
    assert [place for place, *_ in heard] == list(range(N))
    assert repetition.tally.evaluations == N


def test_why_a_row_failed_is_told_with_it(repetition, heard) -> None:
    repetition.settle(evaluated(repetition)[::-1], failures=[Failure(row=1, reason="it burst")])
    assert [(place, reason) for place, _, reason in heard if reason] == [(N - 2, "it burst")]
