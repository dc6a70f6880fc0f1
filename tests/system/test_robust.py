"""A robust run, and the best grasps of a run scored again in trials."""

import csv
from pathlib import Path

import pytest
from scipy.spatial.transform import Rotation
from tests.system.commands import Commands, rows_recorded, wait_for

from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_coordinator.keeping.ranking import best, grasps

CUBE = ("--gripper", "panda", "--object", "rubiks_cube", "--population", 12, "--evaluations", 24)


@pytest.fixture(scope="module")
def robust(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A run whose search hears eta: its folder and digest."""
    commands = Commands(tmp_path_factory.mktemp("robust"))
    done = commands("run", *CUBE, "--protocol", "robust", "--out", "run")
    assert done.code == 0, done.err
    return commands.home / "run", commands.digest("run")


def ranking(folder: Path) -> list[dict[str, str]]:
    with (folder / "ranking.csv").open() as file:
        return list(csv.DictReader(file))


def test_a_robust_run_has_its_budget_of_nominal_rows_and_all_trials_of_its_successes(qdgrasp, robust):
    info = qdgrasp.info(robust[0])
    assert (info["complete"], info["evaluations"], info["errors"]) == (True, 24, 0)
    assert info["successes"] > 2
    assert info["trials"] == 100 * info["successes"]
    assert info["rows"] == 24 + info["overlaps"] + info["dead_ends"] + info["trials"]
    assert info["eta"]["successes"] == info["successes"]
    assert info["mean_fitness"] == pytest.approx(200 * info["eta"]["mean"])
    assert 0 < info["eta"]["mean"] < info["eta"]["best"] < 1


def test_a_robust_run_that_is_killed_in_its_trials_ends_with_the_same_digest(qdgrasp, robust):
    folder = qdgrasp.home / "run"
    process = qdgrasp.start("run", *CUBE, "--protocol", "robust", "--workers", 2, "--out", "run")
    wait_for(lambda: rows_recorded(folder) > 100, "trials")
    process.kill()
    process.wait()
    assert rows_recorded(folder) > 100
    resumed = qdgrasp("resume", "run", "--workers", 1, "--batch-size", 7)
    assert resumed.code == 0, resumed.err
    assert qdgrasp.digest("run") == robust[1]


def test_grasps_that_are_scored_again_get_the_eta_that_the_search_heard(qdgrasp, robust):
    done = qdgrasp("rerank", robust[0], "--top", 3, "--out", "again")
    assert done.code == 0, done.err
    assert "3 grasps ranked" in done.out
    heard = {
        (int(row["generation"]), int(row["index"])): float(row["fitness"]) / 200
        for row in grasps(RunFolder.open(robust[0]))
    }
    lines = ranking(qdgrasp.home / "again")
    assert len(lines) == 3
    for line in lines:
        source = int(line["source_generation"]), int(line["source_index"])
        assert float(line["eta"]) == heard[source]
    info = qdgrasp.info("again")
    assert (info["method"], info["evaluations"], info["trials"]) == ("given", 3, 300)


@pytest.mark.slow
def test_a_reranking_that_is_killed_goes_on_elsewhere_as_a_run_and_is_ranked(qdgrasp, reference):
    folder = qdgrasp.home / "again"
    process = qdgrasp.start("rerank", reference[0], "--top", 4, "--workers", 2, "--out", "again")
    wait_for(lambda: rows_recorded(folder) > 50, "trials")
    process.kill()
    process.wait()
    assert not (folder / "ranking.csv").exists()
    moved = folder.rename(qdgrasp.home / "moved")
    done = qdgrasp("resume", moved)
    assert done.code == 0, done.err
    assert "4 grasps ranked" in done.out
    etas = [float(line["eta"]) for line in ranking(moved)]
    assert etas == sorted(etas, reverse=True)
    repeated = qdgrasp("run", moved / "spec.toml", "--out", "repeated")
    assert repeated.code == 0, repeated.err
    assert qdgrasp.digest("repeated") == qdgrasp.digest(moved)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--protocol", "paper"), "Unknown protocol with trials 'paper'. Known: robust."),
        (("--top", "0"), "--top"),
        (("--object-pose", "0,0,0"), "add --discard-table"),
        (("--discard-table", "--object-pose", "north"), "a quaternion x,y,z,w or angles"),
        (("--out", "taken"), "holds other files"),
    ],
)
def test_what_cannot_be_scored_again_is_refused_in_a_sentence(qdgrasp, reference, options, words):
    (qdgrasp.home / "taken").mkdir()
    (qdgrasp.home / "taken" / "file").touch()
    done = qdgrasp("rerank", reference[0], *options)
    assert done.code == 2
    assert words in done.err
    assert "Traceback" not in done.err
    assert not (qdgrasp.home / "runs").exists()


def test_the_best_grasp_is_scored_again_on_a_table_where_it_comes_from_above(qdgrasp, reference):
    source = best(grasps(RunFolder.open(reference[0])), 1)[0]
    approach = Rotation.from_quat(source["base_to_object"][3:]).apply([0, 0, 1])
    from_above, _ = Rotation.align_vectors([[0, 0, -1]], [approach])
    pose = ",".join(f"{number:.6f}" for number in from_above.as_quat())
    options = ("--top", 1, "--discard-table", "--object-pose", pose, "--out", "again")
    done = qdgrasp("rerank", reference[0], *options)
    assert done.code == 0, done.err
    (line,) = ranking(qdgrasp.home / "again")
    assert (line["source_generation"], line["source_index"]) == (
        str(source["generation"]),
        str(source["index"]),
    )
