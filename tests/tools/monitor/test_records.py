"""Records: the same answers from folders and over the bus."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from tests.coordinator.recorded_campaigns import record_campaign
from tests.coordinator.recorded_runs import random_rows, record, success_mask
from tests.fakes.memory_bus import MemoryNetwork

from qdgrasp_coordinator.metrics.run_stats import count_rows
from qdgrasp_coordinator.storage.job_folder import JobFolder
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.errors import FolderError, QdgraspError, UnknownName
from qdgrasp_tools.monitor import queries
from qdgrasp_tools.monitor.queries import QueryServer
from qdgrasp_tools.monitor.records import BusRecords, FolderIndex, FolderRecords, Records


@pytest.fixture
def campaign(tmp_path: Path, make_scene) -> Path:
    job = JobFolder.create(tmp_path / "paper", "paper")
    for run in ("one", "two"):
        folder = record(tmp_path / "made" / run, make_scene(), random_rows(20))
        RunFolder.add(job, run, folder.spec, folder.bundle())
    return job.path


def names(*paths: Path) -> dict[str, list[str]]:
    return {job: list(one.runs) for job, one in FolderIndex(paths).jobs.items()}


def test_of_a_campaign_all_runs_are_shown_also_those_that_begin_later(campaign: Path, tmp_path: Path) -> None:
    shown = FolderIndex([campaign])
    run = RunFolder.open(campaign / "runs" / "one")
    assert list(shown.jobs["paper"].runs) == ["one", "two"]
    RunFolder.add(JobFolder(campaign), "three", run.spec, run.bundle())
    assert list(shown.jobs["paper"].runs) == ["one", "three", "two"]


def test_of_a_campaign_one_run_may_be_named(campaign: Path) -> None:
    assert names(campaign / "runs" / "two") == {"paper": ["two"]}
    both = names(campaign / "runs" / "two", campaign / "runs" / "one")
    assert both == {"paper": ["two"], "paper-2": ["one"]}


def test_a_folder_that_holds_folders_of_jobs_stands_for_all_of_them(campaign: Path, tmp_path: Path) -> None:
    assert names(tmp_path) == {"paper": ["one", "two"]}
    assert names(tmp_path / "made") == {"one": ["run"], "two": ["run"]}


def test_jobs_of_one_name_are_told_apart(tmp_path: Path, make_scene) -> None:
    paths = [record(tmp_path / place / "mug", make_scene(), random_rows(5)).path for place in "abc"]
    shown = FolderIndex(paths)
    assert list(shown.jobs) == ["mug", "mug-2", "mug-3"]
    assert [shown.run(job, "run").path for job in shown.jobs] == paths


def test_what_holds_no_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FolderError, match="holds no run and no campaign, nor does a folder in it"):
        FolderIndex([tmp_path])
    with pytest.raises(FolderError, match="There is no folder"):
        FolderIndex([tmp_path / "nowhere"])


def test_what_is_not_there_is_named(campaign: Path) -> None:
    shown = FolderIndex([campaign])
    with pytest.raises(UnknownName, match="Unknown run 'three'"):
        shown.run("paper", "three")
    with pytest.raises(UnknownName, match="Unknown job 'papers'"):
        shown.run("papers", "one")


ROWS = random_rows(300)


@pytest.fixture
def folder(tmp_path: Path, make_scene) -> RunFolder:
    return record(tmp_path / "mug", make_scene(), ROWS)


@pytest.fixture(params=["folder", "bus"])
def records(request: pytest.FixtureRequest, folder: RunFolder, network: MemoryNetwork) -> Iterator[Records]:
    if request.param == "folder":
        yield FolderRecords(FolderIndex([folder.path]))
        return
    with network.session() as bus, network.session() as ours, QueryServer(bus, "mug", folder.path):
        yield BusRecords(ours)


def test_the_scene_is_the_run_s(records: Records, folder: RunFolder) -> None:
    origin = records.page("mug", "run", 0).origin
    with folder.journal() as journal:
        assert origin == (folder.bundle().digest, journal.created)
    assert records.scene("mug", "run", origin.scene) == folder.scene()


def test_all_successes_come_in_the_order_of_the_journal(records: Records) -> None:
    page = records.page("mug", "run", 0)
    expected = ROWS[success_mask(ROWS)]
    assert (page.next, page.rows) == (300, 300)
    assert np.array_equal(page.found["outcome"], expected["outcome"])
    assert np.array_equal(page.found["base_to_object"], expected["base_to_object"])
    assert np.array_equal(ROWS[page.found["number"]]["joints"], page.found["joints"])


@pytest.fixture
def listed(folder: RunFolder, network: MemoryNetwork) -> Iterator[BusRecords]:
    with network.session() as bus, network.session() as ours, QueryServer(bus, "mug", folder.path):
        yield BusRecords(ours)


def test_how_a_run_grew_is_told_generation_by_generation(listed: BusRecords, folder: RunFolder) -> None:
    curve, counts = listed.curve("mug", "run"), count_rows(folder.spec, [ROWS])
    assert [point.evaluations for point in curve.points] == list(range(10, 301, 10))
    found = [len(ROWS[:stop][success_mask(ROWS[:stop])]) for stop in range(10, 301, 10)]
    assert [point.successes for point in curve.points] == found
    totals = counts.totals
    end = curve.points[-1]
    assert (curve.run, end.cells, end.robust) == ("run", totals.cells, totals.robust)


def test_what_is_not_there_is_refused(records: Records) -> None:
    with pytest.raises(QdgraspError, match="rum"):
        records.page("mug", "rum", 0)


def test_objects_and_single_runs_over_the_bus_are_those_of_the_folder(tmp_path, network, monkeypatch) -> None:
    job = record_campaign(tmp_path / "parts", 3, hands=("panda",))
    expected = queries.RunIndex(job.path).objects(0).objects
    monkeypatch.setattr(queries, "OBJECTS_PER_PAGE", 2)
    bus = BusRecords(network.session())
    with QueryServer(network.session(), "parts", job.path):
        over_bus = bus.objects("parts")
    assert len(over_bus.objects) == 6
    assert over_bus.objects == expected
