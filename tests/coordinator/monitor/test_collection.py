"""Which runs are shown of folders that somebody named."""

import os
from pathlib import Path

import pytest
from tests.coordinator.recorded_runs import random_rows, record

from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_coordinator.folders.job_folder import JobFolder
from qdgrasp_coordinator.monitor.collection import Collection
from qdgrasp_protocol.errors import FolderError, UnknownName


@pytest.fixture
def campaign(tmp_path: Path, make_scene) -> Path:
    job = JobFolder.create(tmp_path / "paper", "paper")
    for run in ("one", "two"):
        folder = record(tmp_path / "made" / run, make_scene(), random_rows(20))
        RunFolder.add(job, run, folder.spec, folder.bundle())
    return job.path


def names(*paths: Path) -> dict[str, list[str]]:
    return {job: list(one.runs) for job, one in Collection(paths).jobs.items()}


def test_a_run_is_a_job_of_one(tmp_path: Path, make_scene) -> None:
    assert names(record(tmp_path / "mug", make_scene(), random_rows(5)).path) == {"mug": ["run"]}


def test_of_a_campaign_all_runs_are_shown_also_those_that_begin_later(campaign: Path, tmp_path: Path) -> None:
    shown = Collection([campaign])
    run = RunFolder.open(campaign / "runs" / "one")
    assert list(shown.jobs["paper"].runs) == ["one", "two"]
    RunFolder.add(JobFolder(campaign), "three", run.spec, run.bundle())
    assert list(shown.jobs["paper"].runs) == ["one", "three", "two"]


def test_of_a_campaign_one_run_may_be_named(campaign: Path) -> None:
    assert names(campaign / "runs" / "two") == {"paper": ["two"]}
    assert names(campaign / "runs" / "two", campaign / "runs" / "one") == {"paper": ["one", "two"]}
    assert names(campaign / "runs" / "two", campaign) == {"paper": ["one", "two"]}
    assert names(campaign, campaign / "runs" / "two") == {"paper": ["one", "two"]}


def test_a_folder_that_holds_folders_of_jobs_stands_for_all_of_them(campaign: Path, tmp_path: Path) -> None:
    assert names(tmp_path) == {"paper": ["one", "two"]}
    assert names(tmp_path / "made") == {"one": ["run"], "two": ["run"]}


def test_jobs_of_one_name_are_told_apart(tmp_path: Path, make_scene) -> None:
    paths = [record(tmp_path / place / "mug", make_scene(), random_rows(5)).path for place in "abc"]
    shown = Collection(paths)
    assert list(shown.jobs) == ["mug", "mug-2", "mug-3"]
    assert [shown.run(job, "run").path for job in shown.jobs] == paths


def test_a_folder_that_is_named_twice_is_shown_once(tmp_path: Path, make_scene) -> None:
    path = record(tmp_path / "mug", make_scene(), random_rows(5)).path
    assert names(path, path / ".." / "mug") == {"mug": ["run"]}


def test_what_holds_no_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FolderError, match="holds no run and no campaign, nor does a folder in it"):
        Collection([tmp_path])
    with pytest.raises(FolderError, match="There is no folder"):
        Collection([tmp_path / "nowhere"])


def test_what_is_not_there_is_named(campaign: Path) -> None:
    shown = Collection([campaign])
    with pytest.raises(UnknownName, match="Unknown run 'three'"):
        shown.run("paper", "three")
    with pytest.raises(UnknownName, match="Unknown job 'papers'"):
        shown.run("papers", "one")


def test_a_run_whose_name_is_no_text_can_be_named_all_the_same(campaign: Path) -> None:
    os.rename(os.fsencode(campaign / "runs" / "two"), os.fsencode(campaign / "runs") + b"/t\xffwo")  # noqa: PTH104
    shown = Collection([campaign])
    assert list(shown.jobs["paper"].runs) == ["one", r"t\udcffwo"]
    assert shown.run("paper", r"t\udcffwo").spec.gripper == "jaw"
