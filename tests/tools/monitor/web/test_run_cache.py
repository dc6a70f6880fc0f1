import json
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from msgspec.structs import replace
from numpy.typing import NDArray
from tests.tools.monitor.web.conftest import ORIGIN, HandMadeRecords, engine_table, finds, random_finds
from tests.tools.monitor.web.test_scene_data import columns_of, in_cells, read, settled

from qdgrasp_assets.scene import Scene, SceneObject
from qdgrasp_coordinator.storage.success_pages import SuccessTable
from qdgrasp_protocol.errors import NoReply
from qdgrasp_protocol.rows import Outcome
from qdgrasp_tools.monitor.records import JournalId, RecordPage
from qdgrasp_tools.monitor.web import run_cache
from qdgrasp_tools.monitor.web.run_cache import (
    BUSY_SECONDS,
    FRESH_SECONDS,
    MARGIN_SECONDS,
    RunCache,
    RunCaches,
)
from qdgrasp_tools.monitor.web.scene_data import HEADER


@pytest.fixture
def records(make_scene) -> HandMadeRecords:
    return HandMadeRecords(make_scene())


@pytest.fixture
def run(records: HandMadeRecords) -> RunCache:
    return RunCaches(records, lambda: records.now).run("job", "run")


def test_what_two_threads_ask_for_first_is_made_once() -> None:
    made, others = [], []

    def make(key: str) -> object:
        made.append(key)
        if len(made) == 1:
            others.extend(pool.submit(get, key) for _ in range(7))
        return object()

    get = run_cache.made_once(2, make)
    with ThreadPoolExecutor(8) as pool:
        first = pool.submit(get, "a").result()
        assert {id(other.result()) for other in others} == {id(first)}
    assert made == ["a"]


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


def test_what_holds_in_all_engines_is_flagged_as_soon_as_there_is_a_table(records, run) -> None:
    found = finds([2, 5, 7], [(k, 0, 0) for k in range(3)], [Outcome.HELD, Outcome.HELD, Outcome.DROPPED])
    records.record(found)
    before = run.cells(0)
    assert json.loads(run.scene())["engines"] == ["bullet"]
    records.tables = {"mujoco": engine_table(found, [Outcome.HELD, Outcome.SHAKEN, Outcome.HELD])}
    records.now += FRESH_SECONDS
    after = run.cells(0)
    assert json.loads(run.scene())["engines"] == ["bullet", "mujoco"]
    assert origin(after) != origin(before)
    assert columns_of(before)["in_all"].tolist() == [1, 1, 0]
    assert columns_of(after)["in_all"].tolist() == [1, 0, 0]
    records.now += FRESH_SECONDS
    assert run.cells(0) == after


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


@pytest.fixture
def computed(records: HandMadeRecords, monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Numbers of grasps whose margin was computed, which is a thousandth of it.

    Each takes half of the time that there is for one answer.
    """
    numbers: list[int] = []

    def margins(rows: SuccessTable, _: SceneObject) -> NDArray[np.float64]:
        numbers.extend(rows["number"].tolist())
        records.now += MARGIN_SECONDS * len(rows) / 2
        return rows["number"] / 1000

    monkeypatch.setattr(run_cache, "recorded_margins", margins)
    monkeypatch.setattr(run_cache, "MARGINS_AT_ONCE", 1)
    return numbers


def margins_of(page: bytes) -> dict[int, float]:
    """The margins on a page that are known, in thousandths, by journal number."""
    columns = columns_of(page)
    known = ~np.isnan(columns["margin"])
    return dict(
        zip(columns["number"][known].tolist(), np.round(1000 * columns["margin"][known]), strict=True)
    )


def test_margins_are_computed_a_few_at_a_time_while_they_are_asked_for(records, run, computed) -> None:
    found = settled(range(20, 30))
    records.record(found)
    records.on_a_page = 20
    counts = []
    for margins in (False, True, True, False, True, True):
        page = run.cells(0, margins=margins)
        counts.append(len(margins_of(page)))
        records.now += FRESH_SECONDS
    assert counts == [0, 1, 4, 4, 7, 10]  # that of the best in the cell alone at first
    assert margins_of(page) == {number: number for number in found["number"].tolist()}
    records.record(settled([40]))
    assert margins_of(run.cells(0, margins=True)).keys() == {*found["number"].tolist(), 40}
    assert sorted(computed) == [*found["number"].tolist(), 40]


def test_what_was_read_is_shown_when_nobody_answers_any_more(records, run, monkeypatch) -> None:
    def away(*_: object) -> None:
        raise NoReply("nobody answers")

    records.record(random_finds(4))
    before = run.cells(0)
    monkeypatch.setattr(records, "page", away)
    records.now += FRESH_SECONDS
    assert run.cells(0) == before
    with pytest.raises(NoReply):
        RunCaches(records).run("job", "another").cells(0)
