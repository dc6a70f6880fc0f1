"""Budgets that a run may be given after its beginning, and folders of campaigns."""

import shutil
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from tests.coordinator.recorded_runs import random_rows, record, record_spec
from tests.coordinator.scenes import made_scene

from qdgrasp_coordinator.metrics.job_status import RunListing
from qdgrasp_coordinator.metrics.run_stats import RunCounter
from qdgrasp_coordinator.scheduler.run_plan import JobExtent
from qdgrasp_coordinator.storage.finished_runs import FinishedRuns
from qdgrasp_coordinator.storage.job_folder import JobFolder
from qdgrasp_coordinator.storage.journal import Journal
from qdgrasp_coordinator.storage.journal_writer import JournalWriter
from qdgrasp_coordinator.storage.outputs import CAMPAIGN, FINISHED, JOURNAL
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.errors import FolderError, ImpossibleValue
from qdgrasp_protocol.rows import Outcome, Rows, RowShape
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_tools.campaign.campaign_file import Campaign, make_campaign, read_campaign
from qdgrasp_tools.campaign.campaign_folder import CampaignRunQueue, begin_campaign, extend_run, open_campaign
from qdgrasp_tools.campaign.summaries import campaign_summary
from qdgrasp_tools.verification.wrong_rows import take_errors_back

SHAPE = RowShape(genes=7, joints=2)


def begun(path: Path, rows: Rows, **settings: Any) -> RunFolder:
    """A run that has recorded these rows."""
    spec = RunSpec(**{"gripper": "hand", "object": "thing", "population": 8} | settings)
    return record_spec(path / "run", spec, rows)


def generation(size: int) -> Rows:
    """Nominal rows with a success at the beginning, and its hundred trials."""
    rows = SHAPE.empty(size + 100)
    rows["index"][:size], rows["trial"][size:] = np.arange(size), np.arange(1, 101)
    rows["outcome"] = Outcome.MISSED
    rows["outcome"][0] = Outcome.HELD
    return rows


def test_a_run_whose_trials_end_a_generation_early_keeps_its_budget(tmp_path: Path) -> None:
    folder = begun(tmp_path, generation(6), protocol="robust", evaluations=6)
    extend_run(folder, evaluations=6)
    with pytest.raises(ImpossibleValue, match="only whole generations can be extended"):
        extend_run(folder, evaluations=7)
    assert folder.spec.evaluations == 6
    whole = begun(tmp_path / "whole", generation(8), protocol="robust", evaluations=8)
    extend_run(whole, evaluations=100)
    assert whole.spec.evaluations == 100


def test_errors_are_taken_back_with_all_rows_behind_the_first(tmp_path: Path) -> None:
    rows = generation(6)
    rows["outcome"][4] = Outcome.ERROR
    folder = begun(tmp_path, rows, protocol="robust", evaluations=6)
    with JournalWriter.open(folder.path) as journal:
        journal._database.execute("INSERT INTO errors VALUES (4, 'it burst')")
    take_errors_back(folder)
    with folder.journal() as journal:
        assert (journal.count <= 4, journal.errors()) == (True, {})


N = 100


@pytest.fixture
def run(tmp_path: Path) -> RunFolder:
    return record(tmp_path / "run", made_scene(), random_rows(N), evaluations=N, overlaps="count")


@pytest.fixture
def campaign(run: RunFolder, tmp_path: Path) -> JobFolder:
    """A campaign with this run, which is finished, and with none that is not."""
    job = JobFolder.create(tmp_path / "job", "mugs")
    run.path.rename(job.run_path("run-0"))
    (job.run_path("run-0") / "job.json").unlink()
    return job


def extent(campaign: JobFolder, spec: RunSpec) -> JobExtent:
    return CampaignRunQueue(campaign, {"run-0": spec}).extent


def finished_here(campaign: JobFolder, spec: RunSpec) -> RunListing | None:
    index = FinishedRuns(campaign.path)
    index.refresh()
    return index.find(campaign.run_path("run-0"), spec)


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """Folders whose journals were opened."""
    seen: list[Path] = []
    open_journal = Journal.open
    monkeypatch.setattr(Journal, "open", lambda path: (seen.append(path), open_journal(path))[1])
    return seen


def test_a_finished_run_is_opened_once(run: RunFolder, campaign: JobFolder, opened: list[Path]) -> None:
    first = extent(campaign, run_spec_of(campaign))
    assert (first.runs_done, first.done.evaluations) == (1, N)
    assert opened == [campaign.run_path("run-0")]
    assert extent(campaign, run_spec_of(campaign)) == first
    assert len(opened) == 1


def run_spec_of(campaign: JobFolder) -> RunSpec:
    return RunFolder(campaign.run_path("run-0")).spec


@pytest.mark.parametrize(
    "damage",
    [
        lambda text: b"",
        lambda text: b"no line\n{}",
        lambda text: text[:-20],
        lambda text: text.replace(b'"files":"', b'"files":"\xff'),
    ],
)
def test_an_index_that_is_damaged_is_mended_from_the_journals(campaign: JobFolder, damage) -> None:
    spec, file = run_spec_of(campaign), campaign.path / FINISHED
    known = extent(campaign, spec)
    file.write_bytes(damage(file.read_bytes()))
    assert finished_here(campaign, spec) is None
    assert extent(campaign, spec) == known
    assert finished_here(campaign, spec) is not None


@pytest.fixture
def grown(tmp_path: Path) -> Path:
    """A campaign of two runs that are finished: one by its target of grasps, one by its budget."""
    folder, scene = tmp_path / "grown", made_scene()
    wanted = asked(object=["mug", "bowl"], seed=0, grasps=20, evaluations=N, overlaps="count")
    begin_campaign(folder, wanted)
    for (name, spec), share in zip(wanted.runs.items(), (1.0, 0.2), strict=True):
        rows = random_rows(N)
        rows["outcome"][int(share * N) :] = Outcome.MISSED
        until = RunCounter(spec).rows_until_stop(rows)
        record(tmp_path / name, scene, rows[:until], **msgspec.structs.asdict(spec))
        shutil.copytree(tmp_path / name, folder / "runs" / name)
    return folder


def test_larger_targets_and_caps_extend_the_runs_that_these_ended(grown: Path) -> None:
    def unfinished(**goals: int) -> list[str]:
        values = {"grasps": 20, "evaluations": N} | goals
        wanted = asked(object=["mug", "bowl"], seed=0, overlaps="count", **values)
        return list(begin_campaign(grown, wanted).budgets)

    assert unfinished() == []
    assert unfinished(evaluations=2 * N) == ["panda-bowl-contact_rand-s0"]
    assert unfinished(grasps=25) == ["panda-mug-contact_rand-s0"]


def test_a_summary_says_why_runs_ended(grown: Path) -> None:
    found = campaign_summary(open_campaign(grown))
    assert found.ended == {"N grasps are found": 1, "the budget of N evaluations is spent": 1}
    assert "ended            1: N grasps are found" in found.table.splitlines()


def asked(**values: Any) -> Campaign:
    cross = {"gripper": "panda", "object": "mug", "method": "contact_rand", "seed": [0, 1], **values}
    return make_campaign({"cross": [cross]}, "c.toml")


@pytest.fixture
def path(tmp_path: Path) -> Path:
    begin_campaign(tmp_path / "many", asked())
    return tmp_path / "many"


def test_a_campaign_may_grow_by_runs_and_evaluations(path: Path) -> None:
    more = asked(seed=[0, 1, 2], evaluations=20_000)
    assert begin_campaign(path, more).runs == 3
    assert read_campaign(path / CAMPAIGN).runs == more.runs


def test_a_run_that_is_asked_for_otherwise_or_no_more_is_refused_and_the_folder_left_as_it_was(path) -> None:
    with pytest.raises(FolderError, match=r"1 run that is not asked for any more, such as '.*-s1'"):
        begin_campaign(path, asked(seed=0))
    name, spec = next(iter(asked().runs.items()))
    RunFolder.add(JobFolder(path), name, msgspec.structs.replace(spec, mass=0.3), None)
    with pytest.raises(FolderError, match=r"another spec \(mass\)"):
        begin_campaign(path, asked(seed=[0, 1, 2]))
    assert read_campaign(path / CAMPAIGN).runs == asked().runs


def test_a_damaged_journal_keeps_no_campaign_from_going_on(path: Path) -> None:
    name, spec = next(iter(asked().runs.items()))
    run = RunFolder.add(JobFolder(path), name, spec, None)
    (run.path / JOURNAL).write_bytes(b"no journal")
    assert begin_campaign(path, asked()).runs_done == 0
