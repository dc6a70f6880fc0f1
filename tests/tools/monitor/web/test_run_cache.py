import json

import numpy as np
import pytest
from msgspec.structs import replace
from tests.tools.monitor.web.conftest import ORIGIN, HandMadeRecords, finds, random_finds
from tests.tools.monitor.web.test_scene_data import in_cells, read

from qdgrasp_assets.scene import Scene
from qdgrasp_protocol.errors import NoReply
from qdgrasp_protocol.rows import Outcome
from qdgrasp_tools.monitor.records import JournalId, RecordPage
from qdgrasp_tools.monitor.web.run_cache import BUSY_SECONDS, FRESH_SECONDS, RunCache, run_caches
from qdgrasp_tools.monitor.web.scene_data import HEADER


@pytest.fixture
def records(make_scene) -> HandMadeRecords:
    return HandMadeRecords(make_scene())


@pytest.fixture
def run(records: HandMadeRecords) -> RunCache:
    return run_caches(records, lambda: records.now)("job", "run")


def origin(page: bytes) -> int:
    number: int = HEADER.unpack_from(page)[5]
    return number


def half(scene: Scene) -> Scene:
    """The same with a hand that moves one of its fingers alone."""
    return replace(scene, gripper=replace(scene.gripper, joints=scene.gripper.joints[:1]))


def test_what_is_found_later_is_added(records: HandMadeRecords, run: RunCache) -> None:
    records.record(finds([0], [(1, 0, 0)], [Outcome.HELD]))
    upto, _, _ = read(run.cells(0))
    records.record(finds([1], [(2, 0, 0)], [Outcome.HELD]))
    records.now += FRESH_SECONDS
    assert in_cells(run.cells(upto)) == {(2, 0, 0): (1, Outcome.HELD)}


def test_a_journal_that_fell_back_is_read_anew(records: HandMadeRecords, run: RunCache) -> None:
    records.record(random_finds(50))
    before = run.cells(0)
    records.found, records.rows = records.found[:0], 0
    records.record(finds([3], [(9, 9, 9)], [Outcome.DROPPED]))
    records.now += FRESH_SECONDS
    after = run.cells(0)
    assert origin(after) != origin(before)
    assert in_cells(after) == {(9, 9, 9): (3, Outcome.DROPPED)}


def test_another_job_of_the_same_name_is_shown_with_its_own_scene_and_finds_alone(
    records: HandMadeRecords, run: RunCache, make_scene
) -> None:
    records.record(random_finds(10))
    old = json.loads(run.scene())
    assert old["origin"] == origin(run.cells(0))
    many = finds(np.arange(30), [(9, 9, k) for k in range(30)], [Outcome.HELD] * 30, joints=1)
    records.become(half(make_scene("half")), JournalId("2" * 64, 2.0), many)
    records.now += FRESH_SECONDS
    cells = run.cells(0)
    new = json.loads(run.scene())
    assert in_cells(cells).keys() == {(9, 9, k) for k in range(30)}
    assert (old["gripper"], new["gripper"]) == ("jaw", "half")
    assert new["origin"] == origin(cells) != old["origin"]
    assert list(json.loads(run.grasp(3))["joints"]) == ["left"]


def test_a_recorder_that_did_not_answer_is_left_alone_for_a_while(records, run, monkeypatch) -> None:
    asked = []

    def away(*told: object) -> None:
        asked.append(told)
        raise NoReply("nobody answers")

    monkeypatch.setattr(records, "page", away)
    for _ in range(5):
        with pytest.raises(NoReply):
            run.cells(0)
    assert len(asked) == 1
    records.now += BUSY_SECONDS
    with pytest.raises(NoReply):
        run.cells(0)
    assert len(asked) == 2


def test_finds_that_lack_trials_are_asked_for_again_and_not_at_once(records, run, monkeypatch) -> None:
    found = finds([5], [(1, 0, 0)], [Outcome.HELD])
    scored = finds([5], [(1, 0, 0)], [Outcome.HELD], etas=[0.75])
    told = [RecordPage(ORIGIN, found, 5, 9)] * 3 + [RecordPage(ORIGIN, scored, 9, 9)]
    asked = []
    monkeypatch.setattr(records, "page", lambda job, run, first: asked.append(first) or told.pop(0))
    upto, more, shown = read(run.cells(0))
    assert (asked, more, [(number, eta) for number, (*_, eta) in shown.items()]) == ([0, 5], False, [(5, -1)])
    run.cells(upto)
    assert asked == [0, 5]
    records.now += FRESH_SECONDS
    assert read(run.cells(upto)) == (upto, False, {})
    records.now += FRESH_SECONDS
    assert {n: eta for n, (*_, eta) in read(run.cells(upto))[2].items()} == {5: 0.75}
    assert asked == [0, 5, 5, 5]


def test_what_was_read_is_shown_when_nobody_answers_any_more(records, run, monkeypatch) -> None:
    def away(*_: object) -> None:
        raise NoReply("nobody answers")

    records.record(random_finds(4))
    before = run.cells(0)
    monkeypatch.setattr(records, "page", away)
    records.now += FRESH_SECONDS
    assert run.cells(0) == before
    with pytest.raises(NoReply):
        run_caches(records)("job", "another").cells(0)
