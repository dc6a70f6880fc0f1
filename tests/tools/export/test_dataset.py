"""`qdgrasp export CAMPAIGN`: one data set, its index and card; going on after a kill."""

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import h5py
import numpy as np
import pandas
import pyarrow.parquet
import pytest
import yaml
from msgspec.structs import replace
from tests.coordinator.recorded_runs import record
from tests.tools.export.conftest import MakeRun, random_rows
from tests.tools.export.independent_readers import webdataset
from typer.testing import CliRunner

import qdgrasp
from qdgrasp_coordinator.storage.engine_table import write_table
from qdgrasp_coordinator.storage.job_folder import JobFolder
from qdgrasp_coordinator.storage.journal import Journal
from qdgrasp_coordinator.storage.run_folder import RunFolder, journal_digest
from qdgrasp_protocol.errors import FolderError, ImpossibleValue, InputError, OutputError
from qdgrasp_protocol.rows import Outcome
from qdgrasp_protocol.spec import ObjectRecord
from qdgrasp_tools.campaign import campaign_export
from qdgrasp_tools.campaign.campaign_export import export_campaign, parse_shares, split_of
from qdgrasp_tools.cli.main import app
from qdgrasp_tools.export import dataset_card, grasp_reader, grasp_set, metadata
from qdgrasp_tools.export.dataset_card import DatasetFigures, DatasetOptions
from qdgrasp_tools.export.grasp_reader import ChosenGrasps, GraspChoice, GraspReader, read_run

FORMATS = ("parquet", "graspgen", "acronym", "isaac", "webdataset")
OBJECTS = ("cup", "block", "ball")
GRASPS = GraspChoice()
BALL = ObjectRecord(category="toy", licence="CC0", source="shop", split="test")


@pytest.fixture
def campaign(make_run: MakeRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> JobFolder:
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


def runs(campaign: JobFolder) -> list[RunFolder]:
    return [RunFolder.open(path) for path in campaign.run_paths]


def counts(folder: Path, name: str) -> dict[str, int]:
    """The number of grasps of each run, as other libraries read them."""
    index = pandas.read_csv(folder / "index.csv")
    if name == "parquet":
        return dict(pandas.read_parquet(folder / "data").groupby("run").size())
    if name == "webdataset":
        parts = [webdataset(path).beside for path in sorted(folder.glob("data/*/*.tar"))]
        return dict(pandas.concat(parts).groupby("run").size())
    files = {run: files.split() for run, files in zip(index.run, index.files, strict=True)}
    if name == "acronym":
        return {run: len(h5py.File(folder / one)["grasps/transforms"]) for run, (one,) in files.items()}
    if name == "isaac":
        return {
            run: len(yaml.safe_load((folder / one).read_text())["grasps"]) for run, (one,) in files.items()
        }
    return {
        run: sum(json.loads((folder / names[0]).read_text())["grasps"]["object_in_gripper"])
        for run, names in files.items()
    }


@pytest.mark.parametrize("name", FORMATS)
def test_all_runs_are_in_it_with_as_many_grasps_as_their_journals(campaign, tmp_path, name) -> None:
    out = tmp_path / "out"
    said = export_campaign(campaign.path, out, name, GRASPS)
    assert "24 grasps" in said
    assert "3 objects in 6 runs written" in said
    assert counts(out, name) == {run.run: int(read_run(run).is_grasp.sum()) for run in runs(campaign)}
    assert not out.with_name("out.part").exists()
    assert not {"progress.jsonl", "unfinished", "lock"} & {path.name for path in out.iterdir()}


def test_the_index_tells_what_is_known_of_each_run(campaign: JobFolder, tmp_path: Path) -> None:
    export_campaign(campaign.path, tmp_path / "out", "parquet", GRASPS, shares=(100.0,))
    index = pandas.read_parquet(tmp_path / "out" / "index.parquet").set_index("run")
    text = pandas.read_csv(tmp_path / "out" / "index.csv").set_index("run")
    assert list(text.index) == list(index.index)
    assert [name for name in index if name not in text] == ["about"]
    for run in runs(campaign):
        line, summary = index.loc[run.run], qdgrasp.open(run.path).summary
        with run.journal() as journal:
            assert line.digest == journal_digest(journal) == json.loads(line.about)["runs"][0]["digest"]
        for name in ("evaluations", "successes", "grasps", "robust", "seed", "method", "protocol", "engine"):
            assert line[name] == getattr(summary, name), name
        assert line.best_quality == read_run(run).confidence.max() == 1.0
    ball, cup = index.loc["jaw-ball-s0"], index.loc["jaw-cup-s0"]
    assert (ball.category, ball.licence, ball.source, ball.split) == ("toy", "CC0", "shop", "test")
    assert (cup.category, cup.split, cup.licence) == ("", "train", runs(campaign)[2].scene().object.licence)
    assert set(index.files["jaw-ball-s0"]) == {"data/jaw/test-00000.parquet"}


def test_shards_hold_several_objects_sorted_and_end_by_size(campaign, tmp_path, monkeypatch) -> None:
    export_campaign(campaign.path, tmp_path / "one", "parquet", GRASPS)
    assert sorted(path.name for path in (tmp_path / "one" / "data" / "jaw").iterdir()) == [
        "test-00000.parquet", "train-00000.parquet",
    ]  # fmt: skip
    table = pandas.read_parquet(tmp_path / "one" / "data" / "jaw" / "train-00000.parquet")
    assert table.object.tolist() == ["block"] * 8 + ["cup"] * 8
    monkeypatch.setattr("qdgrasp_tools.export.tabular.ROW_GROUP", 1)
    monkeypatch.setattr(grasp_reader, "PART_ROWS", 3)
    export_campaign(campaign.path, tmp_path / "many", "parquet", GRASPS, shard_bytes=1)
    shards = sorted((tmp_path / "many" / "data" / "jaw").glob("train-*"))
    assert len(shards) == 8  # of 3 and 1 grasps of each run
    joined = pandas.concat(map(pandas.read_parquet, shards), ignore_index=True)
    pandas.testing.assert_frame_equal(joined, table)
    index = pandas.read_parquet(tmp_path / "many" / "index.parquet").set_index("run")
    assert list(index.files["jaw-cup-s1"]) == [f"data/jaw/train-0000{number}.parquet" for number in (6, 7)]


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize("ended", ["at a run", "within a file", "between file and line"])
def test_what_is_complete_is_kept_and_the_rest_written_once(campaign, tmp_path, monkeypatch, name, ended):
    def export(out: Path, **more: object) -> str:
        return export_campaign(campaign.path, out, name, GRASPS, shard_bytes=1, **more)

    monkeypatch.setattr("qdgrasp_tools.export.tabular.ROW_GROUP", 1)
    export(tmp_path / "whole")
    out, part, calls = tmp_path / "out", tmp_path / "out.part", iter(range(100))
    if ended == "at a run":
        assert export(out, is_stopped=lambda: next(calls) == 3) == ""
    else:
        where, method = {
            "within a file": (GraspReader, "at"), "between file and line": (campaign_export.Progress, "add"),
        }[ended]  # fmt: skip
        original = getattr(where, method)

        def fail(*arguments: object) -> object:
            if next(calls) == 3:
                raise KeyboardInterrupt
            return original(*arguments)

        with monkeypatch.context() as patched:
            patched.setattr(where, method, fail)
            with pytest.raises(KeyboardInterrupt):
                export(out)
    assert not out.exists()
    assert not (part / "README.md").exists()
    files = [file for file in (part / "data").rglob("*") if file.is_file()]
    recorded = {
        one for entry in campaign_export.Progress(part / "progress.jsonl").entries() for one in entry.files
    }
    before = {file: file.stat().st_ino for file in files if str(file.relative_to(part)) in recorded}
    assert before
    with (part / "progress.jsonl").open("ab") as lines:
        lines.write(b'{"file": "data/ja')  # a line that was cut off
    assert export(out)
    for file, number in before.items():
        assert (out / file.relative_to(part)).stat().st_ino == number
    assert contents(out) == contents(tmp_path / "whole")


def contents(folder: Path) -> dict[str, bytes]:
    """The bytes of all files, by name."""
    files = [path for path in sorted(folder.rglob("*")) if path.is_file()]
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def test_an_end_by_a_signal_kills_nothing_and_is_gone_on_with(campaign, tmp_path, monkeypatch) -> None:
    arguments = ["export", str(campaign.path), "--format", "acronym", "-o", str(tmp_path / "out")]
    original = campaign_export.DatasetWriter.write

    def write(self: object, run: campaign_export.DatasetRun, stopped: Callable[[], bool]) -> bool:
        os.kill(os.getpid(), 2)
        return original(self, run, stopped)

    with monkeypatch.context() as patched:
        patched.setattr(campaign_export.DatasetWriter, "write", write)
        done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 130
    assert f"Complete files are in {tmp_path / 'out'}.part; the same command goes on" in done.stderr
    assert CliRunner().invoke(app, arguments).exit_code == 0
    assert campaign_export.is_dataset(tmp_path / "out")


def test_an_export_with_other_flags_does_not_go_on_with_one_that_was_begun(campaign, tmp_path) -> None:
    out, part = tmp_path / "out", tmp_path / "out.part"
    assert export_campaign(campaign.path, out, "csv", GRASPS, is_stopped=lambda: True) == ""
    with pytest.raises(InputError, match="with other options: min_fitness was not given and is 2; give"):
        export_campaign(campaign.path, out, "csv", GraspChoice(min_fitness=2))
    shutil.rmtree(part)
    part.mkdir()
    (part / "mine.txt").touch()
    with pytest.raises(InputError, match="holds other files"):
        export_campaign(campaign.path, out, "csv", GRASPS)
    assert (part / "mine.txt").exists()


def test_a_data_set_that_is_there_is_replaced_by_force_alone(campaign, tmp_path) -> None:
    out = tmp_path / "out"
    export_campaign(campaign.path, out, "parquet", GRASPS)
    with pytest.raises(InputError, match="is there already"):
        export_campaign(campaign.path, out, "parquet", GRASPS)
    export_campaign(campaign.path, out, "parquet", GraspChoice(min_fitness=2), force=True)
    assert len(pandas.read_parquet(out / "data")) == 12
    assert sorted(path.name for path in tmp_path.iterdir()) == ["campaign", "out"]


def test_a_data_set_that_a_killed_command_had_moved_is_put_back_and_then_kept(campaign, tmp_path) -> None:
    out, moved = tmp_path / "out", tmp_path / ".out.old"
    export_campaign(campaign.path, out, "csv", GRASPS)
    before = contents(out)
    out.rename(moved)
    with pytest.raises(InputError, match="is there already"):
        export_campaign(campaign.path, out, "csv", GRASPS)
    assert (contents(out), sorted(path.name for path in tmp_path.iterdir())) == (before, ["campaign", "out"])
    shutil.rmtree(out)
    moved.mkdir()
    (moved / "mine.txt").touch()
    with pytest.raises(OutputError, match=r"\.out\.old is no data set; move it away"):
        export_campaign(campaign.path, out, "csv", GRASPS)
    assert sorted(path.name for path in tmp_path.iterdir()) == [".out.old", "campaign"]


@pytest.mark.parametrize("out", ["/", "n" * 300])
def test_a_path_where_no_folder_can_be_is_refused(campaign, out) -> None:
    with pytest.raises(OutputError):
        export_campaign(campaign.path, Path(out), "csv", GRASPS)


def test_of_each_run_it_is_chosen_as_of_a_run_alone(campaign: JobFolder, tmp_path: Path) -> None:
    choice = GraspChoice(min_fitness=0, top=5, diverse=3)
    export_campaign(campaign.path, tmp_path / "out", "parquet", choice, negatives=2, frame="com")
    every = pandas.read_parquet(tmp_path / "out" / "data")
    for run in runs(campaign):
        chosen = grasp_set.select_grasps(read_run(run), 0, 5, 3)
        mine = every[every.run == run.run]
        assert mine.number.tolist()[:3] == chosen.numbers.tolist()
        assert len(mine) == 5
        np.testing.assert_array_equal(mine.x.to_numpy()[:3], chosen.poses("com")[:, 0])


def test_a_least_quality_leaves_out_what_is_worse_and_says_the_best(campaign, tmp_path) -> None:
    export_campaign(campaign.path, tmp_path / "out", "parquet", GraspChoice(min_quality=0.6))
    assert pandas.read_parquet(tmp_path / "out" / "data").confidence.min() == 1.0
    with pytest.raises(InputError, match="has no grasp to write"):
        export_campaign(campaign.path, tmp_path / "none", "parquet", GraspChoice(min_fitness=3))
    assert not list(tmp_path.glob("none*"))


def test_each_run_has_the_least_fitness_of_its_own_protocol(campaign, make_run, tmp_path) -> None:
    run = make_run(Outcome.SHAKEN, Outcome.HELD, name="made", object="cow.stl", protocol="physical")
    shutil.copytree(run.path, campaign.run_path("jaw-cow-s0"), ignore=shutil.ignore_patterns("job.json"))
    export_campaign(campaign.path, tmp_path / "out", "parquet", GRASPS)
    index = pandas.read_csv(tmp_path / "out" / "index.csv").set_index("run")
    assert (index.min_fitness["jaw-cow-s0"], index.rows["jaw-cow-s0"]) == (6, 1)
    assert (index.min_fitness["jaw-cup-s0"], index.rows["jaw-cup-s0"]) == (1, 4)
    assert "- taken of each run: min_fitness 1 or 6\n" in (tmp_path / "out" / "README.md").read_text()


def test_the_card_says_the_fitness_of_lifted_grasps_where_there_are_any(campaign, make_run, tmp_path) -> None:
    cards = []
    for name in ("without", "with"):
        export_campaign(campaign.path, tmp_path / "out" / name, "parquet", GRASPS)
        cards.append((tmp_path / "out" / name / "README.md").read_text())
        run = make_run(Outcome.HELD, name=name, object="cow.stl", protocol="lift")
        shutil.copytree(
            run.path, campaign.run_path(f"jaw-{name}-s0"), ignore=shutil.ignore_patterns("job.json")
        )
    assert [f"; under `lift` {metadata.LIFT_MEANING}" in card for card in cards] == [False, True]


def test_a_distance_of_zero_that_was_asked_for_stands_in_the_card(campaign, tmp_path) -> None:
    choice = GraspChoice(min_fitness=0, approach_distance=0.0)
    export_campaign(campaign.path, tmp_path / "out", "parquet", choice)
    assert "- taken of each run: approach_distance 0.0\n" in (tmp_path / "out" / "README.md").read_text()


def test_runs_that_cannot_be_read_are_left_out_and_named(campaign: JobFolder, tmp_path: Path) -> None:
    (campaign.run_path("jaw-cup-s0") / "scene.bundle").unlink()
    said = export_campaign(campaign.path, tmp_path / "out", "parquet", GRASPS)
    assert "20 grasps of 3 objects in 5 runs; 1 run left out" in said
    assert "- `jaw-cup-s0`: " in (tmp_path / "out" / "README.md").read_text()
    (campaign.run_path("jaw-cup-s1") / "spec.toml").write_text("gripper =")
    assert "16 grasps of 2 objects in 4 runs; 2 runs left out" in export_campaign(
        campaign.path, tmp_path / "less", "parquet", GRASPS
    )
    for path in campaign.run_paths:
        (path / "scene.bundle").unlink(missing_ok=True)
    with pytest.raises(FolderError, match=r"no grasp to write: 6 runs could not be read, the first: .*spec"):
        export_campaign(campaign.path, tmp_path / "none", "parquet", GRASPS)
    assert not list(tmp_path.glob("none*"))


@pytest.mark.parametrize("name", FORMATS)
def test_the_readers_in_the_card_run_as_they_stand_there(campaign, tmp_path, name) -> None:
    out = tmp_path / "out"
    export_campaign(campaign.path, out, name, GRASPS)
    (code,) = re.findall(r"```python\n(.*?)```", (out / "README.md").read_text(), re.DOTALL)
    assert len(code.splitlines()) <= 12
    done = subprocess.run([sys.executable, "-c", code], cwd=out, capture_output=True, check=False, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout


def test_the_head_of_the_card_names_the_tables_of_the_hub(campaign: JobFolder, tmp_path: Path) -> None:
    out = tmp_path / "out"
    export_campaign(campaign.path, out, "parquet", GRASPS)
    _, head, text = (out / "README.md").read_text().split("---\n", 2)
    configs = {one["config_name"]: one["data_files"] for one in yaml.safe_load(head)["configs"]}
    for files in configs.values():
        for one in files:
            assert list(out.glob(one["path"])), one
    assert {one["split"] for one in configs["jaw"]} == {"train", "test"}
    schema = pyarrow.parquet.read_schema(out / "data" / "jaw" / "train-00000.parquet")
    for field in schema:
        name = re.sub(r"^(joint|pregrasp)\..*", r"\1.NAME", field.name)
        assert f"| `{name}` |" in text
        assert not pyarrow.types.is_dictionary(field.type)  # the hub's reader refuses these
    assert "| CC0 | 1 |" in text
    for word in ("protocol `paper`, engine `bullet`", "a finger touches the object", "How to cite"):
        assert word in text


def test_objects_without_a_split_beside_some_of_train_name_it_once() -> None:
    figures = DatasetFigures([])
    figures.files["jaw"] = dict.fromkeys(("", "train"), "data/jaw/train-00000.parquet")
    options = DatasetOptions(
        campaign="", format="parquet", frame="mesh", failures=0, choice={}, meshes="name", shares=()
    )
    head = yaml.safe_load(dataset_card._head(Path("out"), options, figures).strip("-"))
    assert head["configs"][0]["data_files"] == [{"split": "train", "path": "data/jaw/train-*.parquet"}]


def test_the_best_quality_is_that_of_a_grasp_where_a_failure_has_a_better_one() -> None:
    index = np.array([(0, 0.1), (1, 0.25)], [("number", int), ("confidence", float)])
    assert ChosenGrasps(None, index, failures=1, min_fitness=1).best == 0.1  # type: ignore[arg-type]
    assert ChosenGrasps(None, index[1:], failures=1, min_fitness=1).best is None  # type: ignore[arg-type]


def test_hands_of_one_name_with_other_joints_do_not_share_a_shard(campaign, scene, tmp_path) -> None:
    other = replace(scene.gripper.joints[0], name="thumb")
    hand = replace(scene.gripper, joints=(other, *scene.gripper.joints[1:]))
    rows = random_rows(scene, [Outcome.HELD] * 5)
    run = record(
        tmp_path / "made", replace(scene, gripper=hand), rows, method="contact_rand", object="cow.stl"
    )
    (run.path / "job.json").unlink()
    shutil.move(run.path, campaign.run_path("jaw-cow-s0"))
    export_campaign(campaign.path, tmp_path / "out", "parquet", GRASPS)
    shards = sorted((tmp_path / "out" / "data" / "jaw").glob("train-*"))
    tables = [pandas.read_parquet(path) for path in shards]
    assert [sorted(set(table.object)) for table in tables] == [["block"], ["cow"], ["cup"]]
    assert ["joint.thumb" in table for table in tables] == [False, True, False]


def test_meshes_are_copied_once_for_each_object_if_asked_for(campaign, tmp_path) -> None:
    export_campaign(campaign.path, tmp_path / "out", "parquet", GRASPS, meshes="copy")
    assert sorted(path.name for path in (tmp_path / "out" / "meshes").iterdir()) == [
        "ball.obj", "block.obj", "cup.obj",
    ]  # fmt: skip
    index = pandas.read_csv(tmp_path / "out" / "index.csv")
    assert set(index.mesh[index.object == "cup"]) == {"meshes/cup.obj"}
    export_campaign(campaign.path, tmp_path / "named", "parquet", GRASPS)
    assert not (tmp_path / "named" / "meshes").exists()


def test_splits_by_hash_are_of_objects_and_near_the_shares() -> None:
    shares = parse_shares("80,10,10")
    names = [split_of(f"object-{number}", shares) for number in range(2000)]
    assert [names.count(split) / 2000 for split in campaign_export.SPLIT_NAMES] == pytest.approx(
        [0.8, 0.1, 0.1], abs=0.02
    )
    assert split_of("mug", ()) == ""
    for wrong in ("80;10", "-1,2", "0,0", "1,1,1,1", "nan,1"):
        with pytest.raises(ImpossibleValue):
            parse_shares(wrong)


def test_graspgen_lists_each_run_in_the_split_of_its_object(campaign, tmp_path) -> None:
    export_campaign(campaign.path, tmp_path / "out", "graspgen", GRASPS, shares=(0.0, 1.0))
    home = tmp_path / "out" / "data" / "jaw"
    lists = {path.stem: path.read_text().split() for path in (home / "splits").iterdir()}
    assert lists["test"] == ["jaw-ball-s0.obj", "jaw-ball-s1.obj"]
    assert lists["valid"] == [f"jaw-{name}-s{seed}.obj" for name in ("block", "cup") for seed in (0, 1)]
    index = json.loads((home / "grasp_data" / "map_uuid_to_path.json").read_text())
    for mesh, file in index.items():
        assert (home / "object_data" / mesh).is_file()
        assert (home / "grasp_data" / file).is_file()


def test_grasps_of_an_object_come_back_as_poses(evaluated_run: RunFolder, tmp_path: Path) -> None:
    job = JobFolder.create(tmp_path / "campaign", "campaign")
    for name in ("a-s0", "a-s1"):
        (shutil.copytree(evaluated_run.path, job.run_path(name)) / "job.json").unlink()
    out, poses = tmp_path / "out", tmp_path / "poses.npz"
    export_campaign(job.path, out, "parquet", GRASPS)
    gripper, object_ = evaluated_run.spec.gripper, evaluated_run.spec.object
    arguments = ["import", str(out), "--gripper", gripper, "--object", object_, "-o", str(poses)]
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 0, done.exception
    grasps = read_run(evaluated_run)
    grasps = grasps[grasps.is_grasp]
    with np.load(poses) as arrays:
        assert arrays["base_position"].tobytes() == 2 * grasps.rows["base_to_object"][:, :3].tobytes()
        assert arrays["name"].tolist() == [
            f"a-s{seed}/{number}" for seed in (0, 1) for number in grasps.numbers
        ]
    refused = CliRunner().invoke(app, [*arguments, "--of", "mug", "--force"]).exception
    assert "has no grasp of gripper" in str(refused)
    (out / "data" / gripper / "train-00000.parquet").write_bytes(b"PAR1")
    assert "damaged" in str(CliRunner().invoke(app, [*arguments, "--force"]).exception)


def test_python_iterates_a_campaign_by_object_and_hand(campaign: JobFolder) -> None:
    opened = qdgrasp.open(campaign.path)
    assert len(opened) == 6
    assert [run.path.name for run in opened] == [f"jaw-{o}-s{s}" for o in sorted(OBJECTS) for s in (0, 1)]
    for run in opened:
        (table,) = run.tables(min_fitness=2)
        assert table["number"].to_pylist() == run.grasps(min_fitness=2).numbers.tolist()
    assert opened["jaw-cup-s1"].spec.seed == 0
    with pytest.raises(FolderError):
        opened["none"]
    with pytest.raises(FolderError):
        qdgrasp.CampaignRuns(campaign.run_path("jaw-cup-s1"))


@pytest.mark.parametrize("name", ["parquet", "graspgen", "webdataset"])
def test_no_more_than_a_part_of_a_run_is_read_at_a_time(campaign, tmp_path, monkeypatch, name) -> None:
    sizes, read, kept = list[int](), GraspReader.at, Journal.kept

    def at(self: GraspReader, numbers: np.ndarray) -> grasp_set.Grasps:
        sizes.append(len(numbers))
        return read(self, numbers)

    def blocks(self: Journal, first: int = 0, stop: int | None = None) -> Iterator[np.ndarray]:
        for rows in kept(self, first, stop):
            yield from (rows[place : place + 3] for place in range(0, len(rows), 3))

    export_campaign(campaign.path, tmp_path / "whole", name, GRASPS)
    monkeypatch.setattr(GraspReader, "at", at)
    monkeypatch.setattr(Journal, "kept", blocks)
    monkeypatch.setattr(grasp_reader, "PART_ROWS", 3)
    export_campaign(campaign.path, tmp_path / "parts", name, GRASPS)
    assert max(sizes) == 3
    assert counts(tmp_path / "parts", name) == counts(tmp_path / "whole", name)
    if name == "graspgen":
        assert contents(tmp_path / "parts") == contents(tmp_path / "whole")


def test_verdicts_of_another_engine_are_columns_of_all_runs_where_any_has_them(campaign, tmp_path) -> None:
    run = RunFolder.open(campaign.run_path("jaw-cup-s0"))
    found = read_run(run)[:3]
    now = found.rows.copy()
    now["outcome"] = (Outcome.HELD, Outcome.OVERLAP, Outcome.HELD)
    write_table(run, "mujoco", found.numbers, found.rows, now)
    export_campaign(campaign.path, tmp_path / "out", "parquet", GraspChoice(min_fitness=0))
    table = pandas.read_parquet(tmp_path / "out" / "data").set_index(["run", "number"]).mujoco_outcome
    assert table["jaw-cup-s0"][found.numbers].tolist() == ["held", "overlap", "held"]
    assert table.notna().sum() == 3
    assert len(list((tmp_path / "out" / "data" / "jaw").glob("train-*"))) == 1
    export_campaign(
        campaign.path, tmp_path / "both", "parquet", GraspChoice(min_fitness=0, holds_in="mujoco")
    )
    assert pandas.read_parquet(tmp_path / "both" / "data").number.tolist() == found.numbers[[0, 2]].tolist()
