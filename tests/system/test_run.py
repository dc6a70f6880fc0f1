"""One command fills an archive through coordinator, workers and recorder; robust runs and rankings."""

import csv
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tests.common import wait_for
from tests.system.commands import BUDGET, Commands, rows_recorded

from qdgrasp_coordinator.search.source_runs import read_run_grasps
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.rows import Outcome
from qdgrasp_protocol.spec import read_run_spec


def test_a_run_ends_with_exactly_its_budget_and_says_what_it_found(reference):
    folder, _, info = reference
    assert info["complete"]
    assert info["evaluations"] == BUDGET
    assert info["rows"] == BUDGET + info["overlaps"] + info["dead_ends"]
    assert info["successes"] >= info["grasps"] >= info["robust"]
    assert info["steps"] > info["rows"]
    assert 0 < info["cells"] <= info["successes"]
    assert info["errors"] == 0
    assert info["cpu_seconds"] > 0
    assert (folder / "run.sqlite").is_file()


def test_the_spec_in_a_run_folder_repeats_the_run_whatever_the_workers_and_batches(qdgrasp, reference):
    folder, digest, _ = reference
    qdgrasp.succeed("run", folder / "spec.toml", "--workers", 2, "--out", "again")
    assert qdgrasp.digest("again") == digest
    assert read_run_spec(qdgrasp.home / "again" / "spec.toml") == read_run_spec(folder / "spec.toml")


@pytest.mark.slow
def test_a_run_in_mujoco_is_the_same_whatever_the_workers_and_is_verified(qdgrasp, reference):
    scene = ("--gripper", "panda", "--object", "rubiks_cube", "--protocol", "physical", "--engine", "mujoco")
    asked = ("run", *scene, "--evaluations", 40, "--set", "population=20")
    qdgrasp.succeed(*asked, "--workers", 1, "--out", "one")
    qdgrasp.succeed(*asked, "--workers", 2, "--out", "two")
    assert qdgrasp.digest("one") == qdgrasp.digest("two")
    assert qdgrasp.info("one")["robust"] > 5
    platforms = []
    for folder in (qdgrasp.home / "one", reference[0]):
        with RunFolder.open(folder).journal() as journal:
            platforms.append(journal.platform.keys())
    assert platforms[0] - platforms[1] == {"mujoco", "mujoco_probes"}
    assert platforms[1] - platforms[0] == {"pybullet", "probes"}
    qdgrasp.succeed("verify", "one", "--all", "--workers", 1)
    compared = qdgrasp.succeed("verify", "one", "--engine", "bullet", "--all", "--json", "--workers", 1).json
    table = list(csv.DictReader((qdgrasp.home / "one" / "engine-bullet.csv").open()))
    assert compared["rows"] == len(table) == qdgrasp.info("one")["successes"]
    assert compared["same_verdict"] > 0.8 * compared["rows"]
    assert sum(each["outcome_now"] == "held" for each in table) > 5
    with RunFolder.open(qdgrasp.home / "one").journal() as journal:
        held = int(np.flatnonzero(journal.slice(0, 40).rows["outcome"] == Outcome.HELD)[0])
    for name in ("still.png", "film.gif"):
        drawn = qdgrasp.succeed("render", "one", "--grasp", held, "-o", name)
        assert drawn.out.startswith(f"held, row {held}: drawn in {name}")
    with Image.open(qdgrasp.home / "film.gif") as film:
        assert film.n_frames > 10
    share = qdgrasp.info("one")["in_both"]["bullet"]
    both = [each["outcome"] == each["outcome_now"] == "held" for each in table]
    assert share == {"held": sum(both), "known": sum(each["outcome"] == "held" for each in table)}
    report = qdgrasp.succeed("show", "one", "--grasp", table[0]["row"], "--json").json
    words = f"{table[0]['outcome_now']}, fitness {table[0]['fitness_now']}"
    assert report["elsewhere"] == {"bullet": words}
    assert words in qdgrasp.succeed("show", "one", "--grasp", table[0]["row"]).out


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["mujoco", "bullet"])
def test_grasps_between_boxes_on_a_table_touch_none_of_them_and_are_the_same_whatever_the_workers(
    qdgrasp, engine
):
    scene = Path(__file__).parents[2] / "examples/scenes/cube-between-boxes.toml"
    asked = ("run", "--gripper", "panda", "--object", "rubiks_cube", "--scene", scene, "--engine", engine)
    for workers, out in ((1, "one"), (2, "two")):
        qdgrasp.succeed(*asked, "--evaluations", 40, "--workers", workers, "--out", out)
    assert qdgrasp.digest("one") == qdgrasp.digest("two")
    qdgrasp.succeed("export", "one", "--format", "bundle", "--top", 20, "-o", "bundle")
    command = [sys.executable, qdgrasp.home / "bundle" / "replay.py", "20"]
    said = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    lifted, clear = (int(line.split()[0]) for line in said.splitlines())
    assert lifted >= 15
    assert clear >= 19
    with np.load(qdgrasp.home / "bundle" / "grasps.npz") as grasps:
        moved = dict(grasps)
    moved["way"] += (0.0, 0.0, 0.4)  # from below the table
    np.savez(command[1].with_name("grasps.npz"), **moved)
    said = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    assert said.splitlines()[1].startswith("0 of 20 touch no")


CUBE = ("--gripper", "panda", "--object", "rubiks_cube", "--set", "population=12", "--evaluations", 24)


@pytest.fixture(scope="module")
def robust(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A run whose search hears eta: its folder and digest."""
    commands = Commands(tmp_path_factory.mktemp("robust"))
    commands.succeed("run", *CUBE, "--protocol", "robust", "--out", "run")
    return commands.home / "run", commands.digest("run")


def ranking(folder: Path) -> list[dict[str, str]]:
    with (folder / "ranking.csv").open() as file:
        return list(csv.DictReader(file))


@pytest.mark.slow
def test_a_robust_run_that_is_killed_in_its_trials_ends_with_the_same_digest(qdgrasp, robust):
    folder = qdgrasp.home / "run"
    process = qdgrasp.start("run", *CUBE, "--protocol", "robust", "--workers", 2, "--out", "run")
    wait_for(lambda: rows_recorded(folder) > 100, "trials")
    process.kill()
    process.wait()
    assert rows_recorded(folder) > 100
    qdgrasp.succeed("resume", "run", "--workers", 1)
    assert qdgrasp.digest("run") == robust[1]


@pytest.mark.slow
def test_grasps_that_are_scored_again_get_the_eta_that_the_search_heard(qdgrasp, robust):
    done = qdgrasp.succeed("rerank", robust[0], "--top", 3, "--out", "again")
    assert "3 grasps ranked" in done.out
    heard = {
        (int(row["generation"]), int(row["index"])): float(row["fitness"]) / 200
        for row in read_run_grasps(RunFolder.open(robust[0]))
    }
    lines = ranking(qdgrasp.home / "again")
    assert len(lines) == 3
    for line in lines:
        assert float(line["eta"]) == heard[(int(line["source_generation"]), int(line["source_index"]))]
    info = qdgrasp.info("again")
    assert (info["method"], info["evaluations"], info["trials"]) == ("given", 3, 300)


@pytest.mark.slow
def test_an_export_scores_the_best_first_from_where_their_jaw_settled(qdgrasp):
    scene = ("--gripper", "panda", "--object", "rubiks_cube", "--evaluations", 60)
    qdgrasp.succeed("run", *scene, "--out", "first", "--workers", 2)
    flags = ("--format", "csv", "--verify-top", 4, "--top", 2, "-o")
    qdgrasp.succeed("export", "first", *flags, "grasps.csv")
    assert "export it instead" in qdgrasp("export", "first", *flags, "again.csv").err
    lines = (qdgrasp.home / "grasps.csv").read_text().splitlines()
    grasps = list(csv.DictReader(line for line in lines if not line.startswith("#")))
    found = [(each["trials"], each["eta_hard"] != "", each["reseated"]) for each in grasps]
    assert found == [("100", True, "1")] * 2
    info = qdgrasp.info("runs/first-robust")
    assert (info["method"], info["evaluations"], info["trials"]) == ("given", 2, 240)
