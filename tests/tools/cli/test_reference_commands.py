"""`reference build` and `info`, and `coverage` of the sets that they make."""

import json
from pathlib import Path

import numpy as np
import pytest
from tests.coordinator.recorded_runs import random_rows, record
from tests.coordinator.scenes import made_scene
from typer.testing import CliRunner

from qdgrasp_coordinator.metrics.cells import cells
from qdgrasp_protocol.errors import ImpossibleValue, InputError
from qdgrasp_protocol.rows import Outcome
from qdgrasp_tools.cli.main import app

REACH = 0.02  # Positions lie so far from the object's centre [m]: in 125 cells


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Four runs on one object, that find some of the same cells."""
    monkeypatch.chdir(tmp_path)
    for seed in range(4):
        record(Path(f"s{seed}"), made_scene(), random_rows(80, seed, REACH), seed=seed)
    return tmp_path


def said(*arguments: str) -> str:
    done = CliRunner().invoke(app, [*arguments], catch_exceptions=False)
    assert done.exit_code == 0
    return done.output


def told(*arguments: str) -> dict:
    return json.loads(said(*arguments, "--json"))


def total(found: dict) -> str:
    return f"an estimated {found['total']:.0f} ({found['low']:.0f} to {found['high']:.0f}) or more"


def build(*runs: str) -> dict:
    return told("reference", "build", *runs, "--out", "own.npz")["objects"]["block"]


@pytest.mark.usefixtures("home")
def test_each_run_that_is_added_brings_the_set_nearer_to_the_estimate() -> None:
    first, *more = (build(f"s{seed}") for seed in range(4))
    assert (first["runs"], first["estimate"], first["robust_estimate"]) == (1, None, None)
    assert [one["estimate"]["runs"] for one in more] == [2, 3, 4]
    shares = [one["estimate"]["sample_coverage"] for one in more]
    assert shares == sorted(shares)
    assert all(one["size"] == one["estimate"]["seen"] < one["estimate"]["low"] for one in more)
    assert all(one["robust_size"] == one["robust_estimate"]["seen"] for one in more)
    assert told("reference", "info", "own.npz")["objects"]["block"] == more[-1]


@pytest.mark.usefixtures("home")
def test_info_says_how_complete_the_set_is_and_what_is_lacking() -> None:
    values = build("s0", "s1", "s2", "s3")
    found, held = values["estimate"], values["robust_estimate"]
    first, *lines = said("reference", "info", "own.npz").splitlines()
    assert (
        first
        == f"own.npz holds {values['size']} cells of 'block', {held['seen']} of them robust, from 4 runs."
    )
    for name, one, line in zip(("All", "Robust"), (found, held), lines, strict=True):
        assert (one["complete_enough"], one["further_runs"] > 1) == (False, True)
        assert line == (
            f"  {name} cells: {one['seen']} of {total(one)}, {one['completeness']:.1%}: not complete enough; "
            f"95% would take about {one['further_runs']} more runs like these."
        )
    reached = int(100 * found["completeness"])
    line = said("reference", "info", "own.npz", "--complete", str(reached / 100)).splitlines()[1]
    assert line.endswith(f": complete enough for {reached}%.")


@pytest.mark.usefixtures("home")
def test_cells_that_hold_nowhere_are_said_to_be_none() -> None:
    rows = random_rows(80, 9, REACH)
    rows["outcome"] = Outcome.DROPPED
    for seed in (10, 11):
        record(Path(f"loose{seed}"), made_scene(), rows, seed=seed)
    n = len(np.unique(cells(rows["base_to_object"][:, :3]), axis=0))
    assert said("reference", "build", "loose10", "loose11", "--out", "loose.npz").splitlines()[1:] == [
        f"  All cells: {n} of an estimated {n} or more, 100.0%: complete enough for 95%.",
        "  Robust cells: none so far.",
    ]


@pytest.mark.usefixtures("home")
def test_the_estimate_stands_beside_coverage_and_so_does_that_the_run_helped() -> None:
    found = build("s0", "s1", "s2")
    asked = ("--reference", "own.npz", "--object", "block")
    for run, helped in (("s2", True), ("s3", False)):
        values = told("coverage", run, *asked)
        assert values["estimate"].items() < found["estimate"].items()
        assert values["robust_estimate"].items() < found["robust_estimate"].items()
        assert values["built_from"] == helped
        sentence = said("coverage", run, *asked)
        assert (
            f" Of {total(found['estimate'])} graspable cells, the set has {values['size']}. Of "
            f"{total(found['robust_estimate'])} in which a grasp holds, it has {values['robust_size']}."
        ) in sentence
        assert sentence.endswith("The set was built from this run too.\n") == helped


@pytest.mark.usefixtures("home")
def test_a_published_set_has_no_estimate_and_that_is_said_once() -> None:
    arrays = {"cm": np.array([[0, 0, 0], [1, 0, 0]], np.int16), "fitness": np.array([0, 2], np.uint8)}
    np.savez("S_G.npz", **{f"{name}.{key}": arrays[key] for name in ("block", "mug") for key in arrays})
    assert said("reference", "info", "S_G.npz") == (
        "S_G.npz holds 2 cells of 'block', 1 of them robust.\n"
        "S_G.npz holds 2 cells of 'mug', 1 of them robust.\n"
        "The file does not say in how many runs each cell was found, so that there is no estimate of the "
        "cells that it lacks.\n"
    )
    values = {"size": 2, "robust_size": 1, "runs": None, "estimate": None, "robust_estimate": None}
    assert told("reference", "info", "S_G.npz")["objects"] == {"block": values, "mug": values}


@pytest.mark.usefixtures("home")
@pytest.mark.parametrize("share", ["0", "1", "95"])
def test_a_share_that_is_none_is_refused_before_anything_is_built(share: str) -> None:
    with pytest.raises(ImpossibleValue, match=r"--complete .*more than 0 and at most 0.999"):
        said("reference", "build", "s0", "--out", "own.npz", "--complete", share)
    assert not Path("own.npz").exists()


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="No reference set can be read at"):
        said("reference", "info", str(tmp_path / "none.npz"))
