"""Queries about recorded runs, from their journals."""

import itertools
from pathlib import Path
from types import SimpleNamespace

import pytest
from msgspec import structs
from tests.coordinator.recorded_campaigns import BUDGET, record_campaign, rows_of
from tests.coordinator.recorded_runs import random_rows, record_spec, spoil_block, success_mask, write_journal
from tests.fakes.memory_bus import MemoryNetwork
from tests.fakes.recorder import BUNDLE, JOB, SCENE, SPEC, FakeCoordinator, make_rows, recording

from qdgrasp_coordinator.metrics.job_status import RunListings, from_json
from qdgrasp_coordinator.storage.job_folder import JobFolder
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.bus import fetch_bundle
from qdgrasp_protocol.errors import Refused
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_tools.monitor import queries
from qdgrasp_tools.monitor.queries import RunIndex

HERE = RunSpec(gripper="jaw", object="block.stl", population=10, evaluations=300)


@pytest.fixture
def campaign(tmp_path: Path) -> Path:
    """The folder of a job with two runs: one that is over, and one that is not."""
    job = JobFolder.create(tmp_path / "job", "mugs")
    for name, budget in {"a": 300, "b": 1000}.items():
        spec = structs.replace(HERE, evaluations=budget)
        alone = record_spec(tmp_path / name, spec, random_rows(300), block=100)
        alone.path.rename(job.run_path(name))
        (job.run_path(name) / "job.json").unlink()
    return job.path


@pytest.fixture
def ticking(monkeypatch: pytest.MonkeyPatch) -> None:
    """A clock on which a second goes by between two looks."""
    seconds = itertools.count()
    monkeypatch.setattr(queries, "time", SimpleNamespace(monotonic=lambda: float(next(seconds))))


def test_a_journal_that_is_damaged_behind_its_beginning_is_left_out_of_every_answer(tmp_path: Path) -> None:
    rows = random_rows(300)
    made = record_spec(tmp_path / "mug", HERE, rows, block=100)
    spoil_block(made.path / "run.sqlite", 200)
    counted = RunIndex(made.path)
    assert [counted.page(0).runs for _ in range(3)] == [[]] * 3


@pytest.mark.usefixtures("ticking")
@pytest.mark.parametrize("run", ["a", "b"])
def test_how_a_run_grew_is_known_as_far_as_it_is_counted_and_when_it_is_over(campaign: Path, run: str):
    counted = RunIndex(campaign)
    ends = [[point.evaluations for point in counted.one(run).curve.points] for _ in range(4)]
    assert ends == [list(range(10, stop + 1, 10)) for stop in (100, 200, 300, 300)]


KEYS = Keys(JOB)
ROWS = make_rows(400)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "job"


def entries(network: MemoryNetwork) -> RunListings:
    with network.session() as bus:
        return from_json(bus.ask(KEYS.entries), RunListings)


def test_entries_count_what_is_recorded_of_each_run(network, coordinator, path) -> None:
    with recording(network, path):
        coordinator.open_runs("a", "b")
        coordinator.send(ROWS, 0, 300, run="a")
        coordinator.hears_durable(300, "a")
        one, other = entries(network).runs
        assert (one.run, one.rows, other.run, other.rows) == ("a", 300, "b", 0)
        assert one.scene == BUNDLE.digest
        assert sum(one.outcomes.values()) == one.evaluations == 300
        assert one.successes == int(success_mask(ROWS[:300]).sum())
        coordinator.send(ROWS, 300, 400, run="a")
        coordinator.hears_durable(400, "a")
        later = entries(network).runs[0]
    with RunFolder(path / "runs" / "a").journal() as journal:
        counted = queries.RunIndex(path).page(0).runs[0]
        assert (journal.count, later.rows) == (400, 400)
    assert structs.asdict(later) == structs.asdict(counted)


@pytest.mark.usefixtures("ticking")
def test_runs_are_left_out_until_there_was_time_to_count_them(campaign: Path, monkeypatch) -> None:
    monkeypatch.setattr(queries, "COUNTING_SECONDS", 4.0)
    counted = RunIndex(campaign)
    told = [counted.page(0) for _ in range(2)]
    assert [([run.rows for run in one.runs], one.uncounted) for one in told] == [([300], 1), ([300, 300], 0)]


def test_many_runs_come_in_pages(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(queries, "RUNS_PER_PAGE", 2)
    network = MemoryNetwork()
    coordinator = FakeCoordinator(network.session())
    with recording(network, path):
        coordinator.open_runs("a", "b", "c")
        with network.session() as bus:
            pages = [from_json(bus.ask(KEYS.entries, parameters=f"from={n}"), RunListings) for n in (0, 2)]
    assert [([run.run for run in page.runs], page.next) for page in pages] == [(["a", "b"], 2), (["c"], 0)]


def test_a_scene_is_shown_from_the_folder_of_its_run(network, coordinator, path) -> None:
    RunFolder.create(path, SPEC, BUNDLE, job=JOB)
    with recording(network, path), network.session() as bus:
        coordinator.open()
        assert fetch_bundle(bus, KEYS.recorded_asset(BUNDLE.digest)) == SCENE
        with pytest.raises(Refused, match="no run here has the scene 000000000000"):
            bus.ask(KEYS.recorded_asset("0" * 64), parameters="i=0")


@pytest.mark.parametrize(
    ("parameters", "reason"),
    [
        ("run=other&from=0", "no run 'other'"),
        ("run=../job&from=0", "no run '../job'"),
        ("", "no run ''"),
        ("run=run&from=-1", "'-1' is no number: from"),
        ("run=run&from=1e3", "'1e3' is no number: from"),
    ],
)
def test_what_cannot_be_shown_is_refused_with_the_reason(network, coordinator, path, parameters, reason):
    with recording(network, path), network.session() as bus:
        coordinator.open()
        with pytest.raises(Refused, match=reason):
            bus.ask(KEYS.finds, parameters=parameters)


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> JobFolder:
    """A campaign over four objects, three of which have begun, the third not to its end."""
    return record_campaign(tmp_path_factory.mktemp("library") / "parts", 4)


def test_objects_are_those_of_the_campaign_with_what_their_runs_got(library: JobFolder) -> None:
    found = RunIndex(library.path).objects(0)
    assert (len(found.objects), found.next, found.uncounted) == (7, 0, 0)
    first, _, third, fourth, *skipped = found.objects
    assert (first.object, first.category, first.state, first.runs_done) == ("part_00000", "mug", "done", 2)
    assert (first.evaluations, first.successes, first.grasps) == (2 * BUDGET, 60, 40)
    assert (third.state, third.runs_done, third.overlaps) == ("running", 1, BUDGET * 3 // 2)
    assert third.little == f"no grasp: the open hand overlaps it in {BUDGET} of {BUDGET} poses"
    assert (fourth.state, fourth.runs, fourth.evaluations) == ("waiting", 2, 0)
    assert [each.state for each in skipped] == ["skipped"] * 3


def test_what_comes_is_added_to_the_objects(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(queries, "LISTED_SECONDS", 0.0)
    job = record_campaign(tmp_path / "parts", 2, begun=0.5, hands=("panda",))
    index = RunIndex(job.path)
    assert [each.state for each in index.objects(0).objects[:2]] == ["running", "waiting"]
    (path,) = job.run_paths
    spec = RunFolder(path).spec
    (path / "run.sqlite").unlink()
    write_journal(path, spec, rows_of("good"), RunFolder(path).bundle(), run=path.name)
    assert (index.objects(0).objects[0].state, index.objects(0).objects[0].evaluations) == ("done", BUDGET)


def test_without_the_file_of_the_campaign_objects_are_those_of_its_runs(campaign: Path) -> None:
    (found,) = RunIndex(campaign).objects(0).objects
    assert (found.object, found.runs, found.runs_done, found.state) == ("block.stl", 2, 1, "running")
    JobFolder(campaign).run_paths[0].joinpath("spec.toml").write_text("no spec")
    (found,) = RunIndex(campaign).objects(0).objects
    assert found.runs == 1
