"""Flags that end the runs of a campaign."""

import shlex
from collections.abc import Callable
from pathlib import Path

import pytest
import trimesh
from tests.coordinator.recorded_campaigns import BUDGET, record_campaign
from typer.testing import CliRunner

from qdgrasp_protocol.errors import InputError
from qdgrasp_tools.campaign.campaign_file import SATURATION, Campaign
from qdgrasp_tools.cli import campaign_commands
from qdgrasp_tools.cli.main import app

Asked = Callable[[str], Campaign]


@pytest.fixture
def asked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Asked:
    """Return the campaign that a command line asks for; nothing is carried out."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "parts").mkdir()
    trimesh.creation.box((0.02, 0.02, 0.08)).export(tmp_path / "parts" / "lever.stl")
    (tmp_path / "c.toml").write_text('[[cross]]\ngripper = "panda"\nobject = "mug"\n')
    begun: list[Campaign] = []

    def begin(path: Path, campaign: Campaign, job: str | None = None) -> None:
        begun.append(campaign)
        raise KeyboardInterrupt

    monkeypatch.setattr(campaign_commands, "begin_campaign", begin)

    def act(line: str) -> Campaign:
        result = CliRunner().invoke(app, ["campaign", *shlex.split(line)])
        if isinstance(result.exception, InputError):
            raise result.exception
        return begun.pop()

    return act


MESHES = "--objects parts --gripper panda --mass 0.1"


@pytest.mark.parametrize(
    ("flags", "ends"),
    [
        ("", (10_000, None, None)),
        ("--grasps 2000", (20_000, 2000, SATURATION)),
        ("--grasps 2000 --evaluations 9000 --set saturation=0.3", (9000, 2000, 0.3)),
        ("--evaluations 9000", (9000, None, None)),
        ("--set saturation=0", (10_000, None, 0)),
    ],
)
@pytest.mark.parametrize("what", ["c.toml", MESHES])
def test_a_target_of_grasps_and_a_cap_are_those_of_every_run(asked: Asked, what: str, flags, ends) -> None:
    (spec,) = asked(f"{what} {flags}").runs.values()
    assert (spec.evaluations, spec.grasps, spec.saturation) == ends


def test_a_campaign_of_meshes_goes_on_from_its_folder_with_a_larger_target(asked, tmp_path) -> None:
    begun = asked(f"{MESHES} --grasps 300 --evaluations 4000")
    (tmp_path / "again.toml").write_text(begun.toml)
    (spec,) = asked("again.toml --grasps 500").runs.values()
    assert (spec.evaluations, spec.grasps, spec.saturation) == (4000, 500, SATURATION)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("c.toml --set population=3", "population goes with --objects DIR"),
        ("c.toml --units mm", "scale goes with --objects DIR"),
        ("c.toml --mesh remesh", "mesh goes with --objects DIR"),
        ("c.toml --set saturation=1.5", "saturation must be a number at least 0 and less than 1, got 1.5"),
    ],
)
def test_what_does_not_go_together_is_refused_in_a_sentence(asked: Asked, line: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        asked(line)


def test_a_campaign_that_ends_early_says_what_all_of_its_runs_have_recorded(tmp_path, capsys) -> None:
    folder = record_campaign(tmp_path / "out", 8)
    campaign_commands.print_summary(folder, is_timed=True)
    lines = capsys.readouterr().out.splitlines()
    words = [line.split() for line in lines]
    assert ["runs", "done", "11"] in words
    assert ["evaluations", str(11 * BUDGET + BUDGET // 2)] in words
    assert lines[-1].startswith("Not all runs are finished; ")
