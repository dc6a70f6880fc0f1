"""One command fills an archive through coordinator, workers and recorder."""

from pathlib import Path

import pytest
from tests.system.commands import BUDGET, LONG, SMALL

from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_protocol.spec import read_run_spec


def test_a_run_ends_with_exactly_its_budget_and_says_what_it_found(reference):
    folder, _, info = reference
    assert info["complete"]
    assert info["evaluations"] == BUDGET
    assert info["rows"] == BUDGET + info["overlaps"] + info["dead_ends"]
    assert info["successes"] >= info["grasps"] >= info["robust"]
    assert info["dead_ends"] > 0
    assert info["proposals"] > info["rows"]
    assert 0 < info["cells"] <= info["successes"]
    assert info["errors"] == 0
    assert info["cpu_seconds"] > 0
    assert (folder / "run.sqlite").is_file()


def test_the_spec_in_a_run_folder_repeats_the_run(qdgrasp, reference):
    folder, digest, _ = reference
    done = qdgrasp("run", folder / "spec.toml", "--workers", 2, "--batch-size", 7, "--out", "again")
    assert done.code == 0, done.err
    assert qdgrasp.digest("again") == digest
    assert read_run_spec(qdgrasp.home / "again" / "spec.toml") == read_run_spec(folder / "spec.toml")


def test_neither_workers_nor_batches_change_the_digest(qdgrasp, reference):
    options = ("--workers", 3, "--batch-size", 25, "--out", "run")
    done = qdgrasp("run", *LONG, *options)
    assert done.code == 0, done.err
    assert qdgrasp.digest("run") == reference[1]


def test_another_seed_gives_other_genomes(qdgrasp, reference):
    options = ("--evaluations", 60, "--seed", 1, "--workers", 1, "--out", "run")
    done = qdgrasp("run", *SMALL, *options)
    assert done.code == 0, done.err
    ours, others = (RunFolder.open(path).journal() for path in (qdgrasp.home / "run", reference[0]))
    with ours, others:
        assert not (ours.rows(0, 60)["genome"] == others.rows(0, 60)["genome"]).all(axis=1).any()


def test_an_extended_run_is_the_longer_run(qdgrasp, reference):
    qdgrasp("run", *SMALL, "--evaluations", 100, "--workers", 1, "--out", "run")
    done = qdgrasp("resume", "run", "--evaluations", BUDGET, "--workers", 1)
    assert done.code == 0, done.err
    assert qdgrasp.digest("run") == reference[1]


def test_resuming_a_finished_run_does_nothing_and_says_so(qdgrasp, reference):
    done = qdgrasp("resume", reference[0])
    assert done.code == 0
    assert "is finished" in done.out
    assert qdgrasp.digest(reference[0]) == reference[1]


@pytest.mark.parametrize("evaluations", [0, BUDGET - 1, 2**64])
def test_a_budget_that_cannot_be_leaves_the_run_as_it_is(qdgrasp, reference, evaluations):
    done = qdgrasp("resume", reference[0], "--evaluations", evaluations)
    assert done.code == 2
    assert "Traceback" not in done.err
    assert qdgrasp.info(reference[0])["complete"]


def test_redrawn_overlaps_are_rows_but_no_evaluations(qdgrasp):
    done = qdgrasp(
        "run",
        *SMALL,
        "--method",
        "approach_rand",
        "--overlaps",
        "redraw",
        "--evaluations",
        50,
        "--workers",
        1,
        "--out",
        "run",
    )
    assert done.code == 0, done.err
    info = qdgrasp.info("run")
    assert info["evaluations"] == 50
    assert info["rows"] == info["proposals"] == 50 + info["overlaps"]
    assert info["overlaps"] > 0


def test_commands_that_print_json_print_nothing_else(qdgrasp, reference):
    done = qdgrasp("info", reference[0], "--json")
    wanted = (
        "gripper object method protocol seed evaluations rows simulated proposals overlaps dead_ends "
        "successes grasps robust cells qd_score success_share mean_fitness nu errors cpu_seconds "
        "wall_seconds complete"
    )
    assert set(wanted.split()) <= set(done.json)
    assert done.json == reference[2]
    assert done.json["success_share"] == done.json["successes"] / done.json["evaluations"]
    assert done.json["grasps"] > 0
    assert done.json["cells"] * 2 >= done.json["qd_score"] > 0
    assert sum(done.json["nu"]["bins"]) == done.json["successes"]
    assert done.err == ""


def test_the_digest_command_prints_the_digest_and_nothing_else(qdgrasp, reference):
    done = qdgrasp("digest", reference[0])
    assert (done.code, done.out, done.err) == (0, f"{reference[1]}\n", "")
    assert len(reference[1]) == 64


def test_a_run_folder_is_named_after_what_it_holds(qdgrasp):
    done = qdgrasp("run", *SMALL, "--evaluations", 1, "--seed", 3, "--workers", 1)
    assert done.code == 0, done.err
    assert (Path(qdgrasp.home) / "runs" / "panda-tennis_ball-aimed-s3" / "run.sqlite").is_file()
