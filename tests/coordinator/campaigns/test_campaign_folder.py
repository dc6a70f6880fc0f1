"""The folder of a campaign: begun, grown, and left as it was where that cannot be."""

from pathlib import Path
from typing import Any

import msgspec
import pytest

from qdgrasp_coordinator.campaigns.campaign import Campaign, campaign, read_campaign
from qdgrasp_coordinator.campaigns.campaign_folder import begin, open_campaign
from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_coordinator.folders.job_folder import JobFolder
from qdgrasp_coordinator.folders.journal_format import FILE
from qdgrasp_coordinator.folders.names import CAMPAIGN
from qdgrasp_protocol.errors import FolderError, ImpossibleValue


def asked(**values: Any) -> Campaign:
    cross = {"gripper": "panda", "object": "mug", "method": "contact_rand", "seed": [0, 1], **values}
    return campaign({"cross": [cross]}, "c.toml")


@pytest.fixture
def path(tmp_path: Path) -> Path:
    begin(tmp_path / "many", asked())
    return tmp_path / "many"


def test_a_new_folder_holds_the_campaign_and_no_run_is_done(tmp_path: Path) -> None:
    extent = begin(tmp_path / "many", asked())
    assert (extent.runs, extent.runs_done, extent.evaluations) == (2, 0, 20_000)
    assert read_campaign(tmp_path / "many" / CAMPAIGN).runs == asked().runs
    assert JobFolder.open(tmp_path / "many").name == "many"


def test_a_campaign_may_grow_by_runs_and_evaluations(path: Path) -> None:
    more = asked(seed=[0, 1, 2], evaluations=20_000)
    assert begin(path, more).runs == 3
    assert read_campaign(path / CAMPAIGN).runs == more.runs


def test_a_campaign_that_lost_a_run_is_refused_and_its_folder_left_as_it_was(path: Path) -> None:
    with pytest.raises(FolderError, match=r"1 run that is not asked for any more, such as '.*-s1'"):
        begin(path, asked(seed=0))
    assert read_campaign(path / CAMPAIGN).runs == asked().runs


def test_a_run_that_is_asked_for_otherwise_is_refused_and_the_folder_left_as_it_was(path: Path) -> None:
    name, spec = next(iter(asked().runs.items()))
    RunFolder.add(JobFolder(path), name, msgspec.structs.replace(spec, mass=0.3), None)
    with pytest.raises(FolderError, match=r"another spec \(mass\)"):
        begin(path, asked(seed=[0, 1, 2]))
    assert read_campaign(path / CAMPAIGN).runs == asked().runs


def test_a_damaged_journal_keeps_no_campaign_from_going_on(path: Path) -> None:
    name, spec = next(iter(asked().runs.items()))
    run = RunFolder.add(JobFolder(path), name, spec, None)
    (run.path / FILE).write_bytes(b"no journal")
    assert begin(path, asked()).runs_done == 0


def test_a_campaign_keeps_its_name_on_the_bus(path: Path) -> None:
    begin(path, asked(), "many")
    with pytest.raises(FolderError, match="is of job 'many', not 'few'"):
        begin(path, asked(), "few")


def test_a_name_that_the_bus_cannot_carry_begins_nothing(tmp_path: Path) -> None:
    with pytest.raises(ImpossibleValue, match="job must be 1 to 64 of the characters"):
        begin(tmp_path / "many", asked(), "a/b c")
    with pytest.raises(ImpossibleValue, match="job must be"):
        RunFolder.create(tmp_path / "one", next(iter(asked().runs.values())), None, job="")
    assert not list(tmp_path.iterdir())


def test_a_single_run_is_no_campaign(tmp_path: Path) -> None:
    RunFolder.create(tmp_path / "one", next(iter(asked().runs.values())), None)
    for act in (open_campaign, lambda one: begin(one, asked())):
        with pytest.raises(FolderError, match="holds a single run, no campaign"):
            act(tmp_path / "one")
