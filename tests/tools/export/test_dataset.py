"""`qdgrasp export` of several runs and campaigns: one data set, its index and card."""

import json
import shutil
from pathlib import Path

import pandas
import pytest
import yaml
from tests.tools.export.conftest import MakeRun
from tests.tools.export.independent_readers import READERS
from typer.testing import CliRunner, Result

from qdgrasp_coordinator.storage.job_folder import JobFolder
from qdgrasp_coordinator.storage.run_folder import RunFolder, journal_digest, run_folders
from qdgrasp_protocol.errors import FolderError, OutputError
from qdgrasp_protocol.rows import Outcome
from qdgrasp_protocol.spec import ObjectRecord
from qdgrasp_tools.cli.main import app
from qdgrasp_tools.export.exporter import export_grasps
from qdgrasp_tools.export.grasp_reader import GraspChoice, read_run

OBJECTS = ("cup", "block", "ball")
BALL = ObjectRecord(category="toy", licence="CC0", source="shop", split="test")


@pytest.fixture
def campaign(make_run: MakeRun, tmp_path: Path) -> JobFolder:
    """Three objects with two seeds each; of each two rows of every outcome. Facts are known of the ball."""
    job = JobFolder.create(tmp_path / "campaign", "campaign")
    for number, name in enumerate(OBJECTS):
        for seed in (0, 1):
            run = make_run(
                *sorted([*Outcome, *Outcome]),
                name="made",
                seed=2 * number + seed,
                object=f"{name}.stl",
                about=BALL if name == "ball" else None,
            )
            (run.path / "job.json").unlink()
            shutil.move(run.path, job.run_path(f"jaw-{name}-s{seed}"))
    return job


@pytest.fixture
def runs(campaign: JobFolder) -> list[RunFolder]:
    return run_folders([campaign.path])


def command(*words: object) -> Result:
    return CliRunner().invoke(app, ["export", *map(str, words)])


def counts(folder: Path, name: str) -> dict[str, int]:
    """The number of grasps of each run, as other readers have them."""
    index = pandas.read_csv(folder / "index.csv").set_index("run")
    if name != "graspgen":
        read = {run: READERS[name](folder / files.split()[0]) for run, files in index.files.items()}
        return {run: int((file.quality > 0).sum()) for run, file in read.items()}
    first = {run: folder / files.split()[0] for run, files in index.files.items()}
    return {
        run: sum(json.loads(path.read_text())["grasps"]["object_in_gripper"]) for run, path in first.items()
    }


@pytest.mark.parametrize("name", READERS)
def test_all_runs_are_in_it_with_as_many_grasps_as_their_journals(runs, tmp_path, name) -> None:
    said = export_grasps(runs, tmp_path / "out", name)
    assert "24 grasps" in said
    assert "3 objects in 6 runs written" in said
    assert counts(tmp_path / "out", name) == {
        run.path.name: int(read_run(run).is_grasp.sum()) for run in runs
    }


def test_several_runs_and_campaigns_are_one_data_set_and_a_run_named_twice_counts_once(
    campaign, make_run, tmp_path
) -> None:
    alone = make_run(Outcome.HELD, name="jaw-cup-s0")
    folders = (alone.path, campaign.path, alone.path)
    done = command(*folders, "--format", "parquet", "-o", tmp_path / "out")
    assert done.exit_code == 0, done.exception
    found = counts(tmp_path / "out", "parquet")
    assert len(found) == 7
    assert (found["jaw-cup-s0"], found["jaw-cup-s0-2"]) == (1, 4)


def test_the_index_says_what_is_known_of_each_run(runs, tmp_path: Path) -> None:
    export_grasps(runs, tmp_path / "out", "parquet")
    index = pandas.read_csv(tmp_path / "out" / "index.csv").set_index("run")
    for run in runs:
        line, found = index.loc[run.path.name], read_run(run)
        with run.journal() as journal:
            assert (line.digest, line.scene) == (journal_digest(journal), journal.scene)
        assert (line.successes, line.grasps, line["rows"]) == (len(found), 4, 4)
    ball = index.loc["jaw-ball-s0"]
    assert (ball.category, ball.licence, ball.source, ball.split) == ("toy", "CC0", "shop", "test")


def test_runs_that_cannot_be_read_are_left_out_and_named(runs, tmp_path: Path) -> None:
    (runs[0].path / "run.sqlite").write_bytes(b"no journal")
    said = export_grasps(runs, tmp_path / "out", "parquet")
    assert "1 run left out, see README.md" in said
    assert f"`{runs[0].path.name}`: " in (tmp_path / "out" / "README.md").read_text()


def interrupt(_sentence: str) -> None:
    raise KeyboardInterrupt


def test_a_data_set_is_replaced_by_force_alone_and_nothing_is_left_of_one_that_was_stopped(runs, tmp_path):
    out = tmp_path / "out"
    with pytest.raises(KeyboardInterrupt):
        export_grasps(runs, out, "parquet", tell=interrupt)
    with pytest.raises(FolderError, match="no grasp to write"):
        export_grasps(runs, out, "parquet", GraspChoice(min_quality=1.0, min_fitness=6))
    assert [path.name for path in tmp_path.iterdir()] == ["campaign"]
    export_grasps(runs, out, "parquet")
    with pytest.raises(OutputError, match="is there already"):
        export_grasps(runs, out, "parquet")
    export_grasps(runs, out, "acronym", force=True)
    assert counts(out, "acronym")


def test_the_head_of_the_card_names_the_tables_of_the_hub(runs, tmp_path: Path) -> None:
    export_grasps(runs, tmp_path / "out", "parquet")
    head = yaml.safe_load((tmp_path / "out" / "README.md").read_text().split("---\n")[1])
    tables = {each["config_name"]: each["data_files"] for each in head["configs"]}
    assert set(tables) == {"jaw", "index"}
    for table in tables["jaw"]:
        assert list((tmp_path / "out").glob(table["path"]))


def test_graspgen_lists_each_run_in_the_split_of_its_object(runs, tmp_path) -> None:
    export_grasps(runs, tmp_path / "out", "graspgen")
    home = tmp_path / "out" / "data" / "jaw" / "splits"
    test, train = ((home / f"{name}.txt").read_text().split() for name in ("test", "train"))
    assert (len(test), len(train)) == (2, 4)
    assert not set(test) & set(train)
