"""`analyse`: tables and figures of a campaign."""

import re
import shutil
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
from tests.coordinator.recorded_runs import random_rows, record
from tests.coordinator.scenes import made_scene

from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_coordinator.storage.tables import read_csv
from qdgrasp_protocol.build_messages import MeshPreparation
from qdgrasp_protocol.errors import FolderError, OutputError
from qdgrasp_protocol.rows import TRIALS, Outcome
from qdgrasp_tools.report.report import FIGURES, CampaignReport, write_report
from qdgrasp_tools.report.run_groups import mean_interval
from qdgrasp_tools.report.run_report import run_summary

METHODS = ("contact_me_scs", "contact_rand", "me_scs")


@pytest.fixture(autouse=True)
def few_pixels(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("qdgrasp_tools.report.figures.VOXEL_PIXELS", 60)
    monkeypatch.setattr("qdgrasp_tools.report.figures.FIGURE_DPI", 60)


@pytest.fixture
def campaign(tmp_path: Path) -> Path:
    """Three methods with two seeds each, one of them unfinished and one not begun."""
    home = tmp_path / "small" / "runs"
    home.mkdir(parents=True)
    for method in METHODS:
        for seed in (0, 1):
            rows = random_rows(100, seed=10 * METHODS.index(method) + seed)
            rows = rows[: {("me_scs", 0): 70, ("me_scs", 1): 0}.get((method, seed), 100)]
            settings = {"method": method, "seed": seed, "evaluations": 100}
            record(home / f"jaw-block-{method}-s{seed}", made_scene(), rows, **settings)
    return home.parent


def analysed(campaign: Path, **settings: object) -> CampaignReport:
    return write_report(campaign, campaign / "analysis", **settings)  # type: ignore[arg-type]


def test_the_paper_s_figures_and_the_tables_are_written_the_same_each_time(campaign: Path) -> None:
    found = analysed(campaign)
    assert (len(found.runs), found.unfinished, found.left_out) == (6, 2, [])
    for name in FIGURES:
        picture = matplotlib.image.imread(found.out / f"{name}.png")
        assert (picture[..., :3].min(axis=-1) < 0.9).mean() > 0.005
    files = {file.name: file.read_bytes() for file in found.out.iterdir()}
    assert len(files) == 2 * len(FIGURES) + 2
    assert {file.name: file.read_bytes() for file in analysed(campaign).out.iterdir()} == files


def test_a_run_s_row_has_the_figures_of_info(campaign: Path) -> None:
    for row in read_csv(analysed(campaign).out / "runs.csv"):
        known = run_summary(RunFolder.open(campaign / "runs" / row["run"]))
        for name in ("evaluations", "simulated", "steps", "overlaps", "dead_ends", "successes", "cells"):
            assert int(row[name]) == getattr(known, name)
        assert float(row["qd_score"]) == known.qd_score
        assert row["finished"] == ("yes" if known.complete else "no")


def test_a_curve_is_the_median_of_the_runs_that_have_got_that_far(campaign: Path) -> None:
    out = analysed(campaign).out
    cells = {row["run"]: int(row["cells"]) for row in read_csv(out / "runs.csv")}
    ends = {row["method"]: row for row in read_csv(out / "curves.csv")}
    assert (ends["me_scs"]["runs"], ends["contact_rand"]["runs"]) == ("1", "2")
    assert float(ends["me_scs"]["median"]) == cells["jaw-block-me_scs-s0"]
    whole = [cells[f"jaw-block-contact_rand-s{seed}"] for seed in (0, 1)]
    assert float(ends["contact_rand"]["median"]) == np.median(whole)


def test_coverage_is_drawn_where_there_is_a_set_over_the_objects_that_have_one(tmp_path: Path) -> None:
    rows = random_rows(60, reach=0.02)
    cells = np.unique(np.rint(100 * rows["base_to_object"][:, :3]).astype(np.int16), axis=0)
    fitness = np.zeros(len(cells), np.uint8)
    sets = {
        f"{name}.{key}": value
        for name in ("block", "can")
        for key, value in (("cm", cells), ("fitness", fitness))
    }
    np.savez(tmp_path / "S_G_jaw.npz", **sets)
    scene = made_scene()
    for name in ("block", "can", "mug"):
        body = type(scene.object)(
            **{key: getattr(scene.object, key) for key in scene.object.__struct_fields__} | {"name": name}
        )
        there = type(scene)(
            **{key: getattr(scene, key) for key in scene.__struct_fields__} | {"object": body}
        )
        record(tmp_path / "runs" / name, there, rows, object=name, method="contact_rand", evaluations=60)
    out = analysed(tmp_path, references=[tmp_path / "S_G_jaw.npz"]).out
    measures = {(row["object"], row["measure"]) for row in read_csv(out / "curves.csv")}
    assert measures == {
        ("block", "coverage"), ("can", "coverage"), ("mug", "cells"), ("2 objects", "coverage"),
    }  # fmt: skip


def test_figures_without_anything_to_draw_are_left_out_and_earlier_ones_removed(tmp_path: Path) -> None:
    rows = random_rows(30)
    record(tmp_path / "runs/a", made_scene(), rows, method="contact_rand", evaluations=30)
    out = analysed(tmp_path).out
    assert (out / "figure4-cells.png").exists()
    shutil.rmtree(tmp_path / "runs")
    rows["outcome"] = Outcome.MISSED
    record(tmp_path / "runs/a", made_scene(), rows, method="contact_rand", evaluations=30)
    assert analysed(tmp_path).left_out == [*FIGURES[1:]]
    assert sorted(file.name for file in out.glob("*.png")) == ["figure1-comparison.png"]


def test_a_folder_with_files_of_others_is_left_as_it_is(campaign: Path) -> None:
    mine = campaign / "mine"
    mine.mkdir()
    (mine / "runs.csv").write_text("mine")
    with pytest.raises(OutputError, match="holds other files"):
        write_report(campaign, mine)
    assert (mine / "runs.csv").read_text() == "mine"


def test_cells_of_robust_runs_have_an_eta(tmp_path: Path) -> None:
    nominal = random_rows(10)
    trials = np.repeat(nominal[nominal["outcome"] >= Outcome.DROPPED], TRIALS)
    trials["trial"], trials["fitness"] = 1 + np.arange(len(trials)) % TRIALS, 1
    rows = np.concatenate([nominal, trials])
    record(tmp_path / "runs/a", made_scene(), rows, protocol="robust", evaluations=10)
    assert read_csv(analysed(tmp_path).out / "runs.csv")[0]["eta"] == "0.5"


@pytest.mark.parametrize(
    ("key", "values", "words"),
    [
        ("mutation_sigma", (0.05, 0.1), ["mutation sigma 0.05", "mutation sigma 0.1"]),
        ("mesh", (None, MeshPreparation(hull=True)), ["mesh None", "mesh hull=True"]),
    ],
)
def test_runs_whose_settings_differ_are_no_samples_of_one_group(tmp_path, key, values, words) -> None:
    for number, value in enumerate(values):
        for seed in (0, 1):
            settings = {"method": "me_scs", key: value, "seed": seed, "evaluations": 20}
            record(tmp_path / f"runs/{number}-{seed}", made_scene(), random_rows(20), **settings)
    variants = {row["variant"] for row in read_csv(analysed(tmp_path).out / "runs.csv")}
    assert len(variants) == 2
    assert all(any(re.fullmatch(one, found) for found in variants) for one in words)


def test_a_copy_of_a_run_and_a_shorter_run_of_its_search_are_no_runs_of_their_own(campaign: Path) -> None:
    home = campaign / "runs"
    shutil.copytree(home / "jaw-block-contact_rand-s0", home / "later-copy")
    rows = random_rows(50, seed=10 * METHODS.index("me_scs"))
    record(home / "shorter", made_scene(), rows, method="me_scs", seed=0, evaluations=50)
    found = analysed(campaign)
    assert (len(found.runs), found.repeats) == (6, ["later-copy", "shorter"])


def test_what_cannot_be_drawn_is_refused(tmp_path: Path) -> None:
    record(tmp_path / "empty/a", made_scene(), random_rows(0))
    with pytest.raises(FolderError, match="has recorded an evaluation yet"):
        analysed(tmp_path / "empty")


def test_few_runs_have_no_interval_and_many_have_one_around_their_mean() -> None:
    assert mean_interval([1.0] * 4) is None
    assert mean_interval([1.0] * 5) == (1.0, 1.0)
    low, high = mean_interval([1.0, 2.0, 4.0, 5.0, 8.0]) or (0.0, 0.0)
    assert 1.0 < low < 4.0 < high < 8.0
