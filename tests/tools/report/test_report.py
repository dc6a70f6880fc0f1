import csv
import json
import re
import shutil
from itertools import product
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
from msgspec.structs import replace
from tests.coordinator.recorded_runs import random_rows, record
from tests.coordinator.scenes import made_scene
from typer.testing import CliRunner

from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.errors import FolderError, OutputError, UnknownName
from qdgrasp_protocol.rows import TRIALS, Outcome
from qdgrasp_tools.campaign.summary import run_summary
from qdgrasp_tools.cli.main import app
from qdgrasp_tools.report.reference_builder import build_reference_sets
from qdgrasp_tools.report.report import CampaignReport, write_report

METHODS = ("contact_me_scs", "contact_rand", "me_scs")


@pytest.fixture(autouse=True)
def few_pixels(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("qdgrasp_tools.report.figures.VOXEL_PIXELS", 60)
    monkeypatch.setattr("qdgrasp_tools.report.figure_grid.FIGURE_DPI", 60)


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


def table(file: Path) -> list[dict[str, str]]:
    with file.open() as lines:
        return list(csv.DictReader(lines))


def analysed(campaign: Path, **settings: object) -> CampaignReport:
    return write_report(campaign, campaign / "analysis", **settings)  # type: ignore[arg-type]


def test_the_paper_s_figures_with_their_data_and_the_tables_are_written(campaign: Path) -> None:
    found = analysed(campaign)
    assert (found.runs, found.unfinished, set(found.left_out)) == (6, 2, {"settings"})
    for name in ("comparison", "variants", "nu", "voxels", "coverage", "priors"):
        picture = matplotlib.image.imread(found.out / f"{name}.png")
        assert (picture[..., :3].min(axis=-1) < 0.9).mean() > 0.005
        assert "<svg" in (found.out / f"{name}.svg").read_text()
        assert len(table(found.out / f"{name}.csv")) > 3
    assert len(table(found.out / "runs.csv")) == 6
    assert {row["method"] for row in table(found.out / "methods.csv")} == set(METHODS)
    assert {row["claim"] for row in table(found.out / "claims.csv")} == set("abcdefgh")


def test_the_tables_have_the_figures_of_info(campaign: Path) -> None:
    out = analysed(campaign).out
    for row in table(out / "runs.csv"):
        said = run_summary(RunFolder.open(campaign / "runs" / row["run"]))
        for name in ("evaluations", "simulated", "proposals", "overlaps", "dead_ends", "successes", "cells"):
            assert int(row[name]) == getattr(said, name)
        assert float(row["qd_score"]) == said.qd_score
        assert row["finished"] == ("yes" if said.complete else "no")
        assert row["overlaps_mode"] == said.overlaps_mode == "count"


def test_medians_are_over_the_runs_that_have_begun(campaign: Path) -> None:
    out = analysed(campaign).out
    cells = {row["run"]: int(row["cells"]) for row in table(out / "runs.csv")}
    medians = {row["method"]: float(row["cells"]) for row in table(out / "methods.csv")}
    assert medians["me_scs"] == cells["jaw-block-me_scs-s0"]
    assert medians["contact_rand"] == np.median([cells[f"jaw-block-contact_rand-s{seed}"] for seed in (0, 1)])


def test_the_page_names_what_is_unfinished_and_why_there_is_no_coverage(campaign: Path) -> None:
    page = (analysed(campaign).out / "tables.md").read_text()
    assert "`jaw-block-me_scs-s0` (70 of 100), `jaw-block-me_scs-s1` (0 of 100)" in page
    assert "No coverage: no S_G of jaw and block." in page
    assert "| me_scs | 2, 2 unfinished | every genome |" in page
    claim = "contact and approach variants of a search end close together (Figure 2)"
    assert f"| b | {claim} | **not in this campaign** |" in page
    assert "nan" not in page


def test_the_same_runs_give_the_same_bytes(campaign: Path) -> None:
    first, second = (write_report(campaign, campaign / name) for name in ("one", "two"))
    names = sorted(file.name for file in first.out.iterdir())
    assert len(names) == 6 * 3 + 4
    for name in names:
        assert (first.out / name).read_bytes() == (second.out / name).read_bytes(), name


def test_coverage_is_drawn_where_there_is_a_set(campaign: Path) -> None:
    own = campaign / "own.npz"
    build_reference_sets([RunFolder.open(campaign / "runs/jaw-block-contact_me_scs-s0")], own)
    out = analysed(campaign, references=[own]).out
    assert {row["measure"] for row in table(out / "coverage.csv")} == {"coverage"}
    (whole,) = [row for row in table(out / "runs.csv") if row["run"] == "jaw-block-contact_me_scs-s0"]
    assert (float(whole["coverage"]), float(whole["robust_coverage"])) == (1.0, 1.0)


def test_the_estimate_of_a_set_of_ones_own_stands_beside_coverage(campaign: Path) -> None:
    own, runs = campaign / "own.npz", [campaign / f"runs/jaw-block-contact_rand-s{seed}" for seed in (0, 1)]
    known = build_reference_sets(map(RunFolder.open, runs), own)["block"]
    found = known.estimate
    out = analysed(campaign, references=[own]).out
    assert (
        f"S_G has {len(known):,} entries. Of an estimated {found.total:,.0f} ("
        in (out / "tables.md").read_text()
    )
    for row in table(out / "runs.csv"):
        columns = [float(row[f"{name}_estimate"]) for name in ("set", "robust_set")]
        assert columns == [found.total, known.robust.estimate.total]
        assert float(row["set_low"]) < found.total < float(row["set_high"])


def test_figures_without_anything_to_draw_are_left_out_and_earlier_ones_removed(tmp_path: Path) -> None:
    rows = random_rows(30)
    rows["outcome"] = Outcome.MISSED
    record(tmp_path / "runs/a", made_scene(), rows, method="contact_rand", evaluations=30)
    earlier = tmp_path / "analysis"
    earlier.mkdir()
    (earlier / "tables.md").write_text(
        "# a\n\n## What the paper claims\n\n![nu](nu.png)\n![hands](hands.png)\n"
    )
    for name in ("nu.png", "nu.csv", "hands.png", "voxels.csv"):
        (earlier / name).touch()
    found = analysed(tmp_path)
    assert set(found.left_out) == {"variants", "nu", "voxels", "priors", "settings"}
    assert sorted(file.name for file in found.out.glob("*.png")) == ["comparison.png", "coverage.png"]
    assert not (earlier / "nu.csv").exists()
    assert (earlier / "voxels.csv").exists(), "no earlier analysis says that it drew it"
    assert "Not drawn: nothing was found." in (found.out / "tables.md").read_text()


def test_what_an_analysis_wrote_is_what_the_next_one_replaces(campaign, monkeypatch) -> None:
    first = analysed(campaign).out
    (first / "notes").write_text("mine")
    monkeypatch.setattr("qdgrasp_tools.report.report.run_voxels", lambda *_: [])
    assert "voxels" in analysed(campaign).left_out
    assert not [*first.glob("voxels.*")]
    assert (first / "notes").read_text() == "mine"


def test_a_folder_with_files_of_others_is_left_as_it_is(campaign: Path) -> None:
    mine = campaign / "mine"
    mine.mkdir()
    for name in ("nu.csv", "runs.csv", "tables.md"):
        (mine / name).write_text("mine")
    with pytest.raises(OutputError, match=r"holds other files \(nu.csv, runs.csv, tables.md\)"):
        write_report(campaign, mine)
    assert {file.read_text() for file in mine.iterdir()} == {"mine"}
    with pytest.raises(OutputError, match="holds other files"):
        write_report(campaign, campaign / "runs/jaw-block-contact_me_scs-s0")


def test_cells_of_robust_runs_have_an_eta(tmp_path: Path) -> None:
    nominal = random_rows(10)
    trials = np.repeat(nominal[nominal["outcome"] >= Outcome.DROPPED], TRIALS)
    trials["trial"], trials["fitness"] = 1 + np.arange(len(trials)) % TRIALS, 1
    rows = np.concatenate([nominal, trials])
    record(tmp_path / "runs/a", made_scene(), rows, protocol="robust", evaluations=10)
    out = analysed(tmp_path).out
    assert {row["eta"] for row in table(out / "voxels.csv")} == {"0.5"}
    assert table(out / "runs.csv")[0]["eta"] == "0.5"


@pytest.mark.parametrize(
    ("found", "drawn"),
    [
        ({"aimed": 30, "contact_me_scs": 90, "approach_me_scs": 90}, {"aimed", "contact_me_scs"}),
        ({"me_scs": 0, "contact_me_scs": 30}, {"contact_me_scs"}),
        ({"me_rand": 90, "approach_me_scs": 30}, {"me_rand"}),
    ],
)
def test_the_cells_are_those_of_the_compared_methods_or_of_what_found_the_most(found, drawn, tmp_path):
    for method, rows in found.items():
        record(tmp_path / method, made_scene(), random_rows(rows), method=method, evaluations=100)
    assert {row["method"] for row in table(analysed(tmp_path).out / "voxels.csv")} == drawn


def test_with_many_hands_the_cells_are_drawn_on_one_object_or_on_those_that_are_named(tmp_path: Path) -> None:
    scenes = [*product(("panda", "allegro", "jaw"), ("mug", "bowl", "can")), ("jaw", "bowl-2")]
    for (hand, thing), method in product(scenes, ("contact_rand", "approach_rand")):
        spec = {"gripper": hand, "object": f"{thing}.stl", "method": method, "evaluations": 20}
        scene = replace(made_scene(hand), object=replace(made_scene().object, name=thing))
        record(tmp_path / "runs" / f"{hand}-{thing}-{method}", scene, random_rows(20), **spec)
    assert {row["object"] for row in table(analysed(tmp_path).out / "voxels.csv")} == {"bowl"}
    lone = table(analysed(tmp_path, methods=["contact_rand"]).out / "voxels.csv")
    assert {(row["gripper"], row["object"]) for row in lone} == set(scenes)
    rows = table(analysed(tmp_path, objects=["can", "bowl-2"]).out / "voxels.csv")
    assert {(row["gripper"], row["object"], row["method"]) for row in rows} == {
        (hand, thing, method)
        for hand, thing in scenes if thing in ("can", "bowl-2")
        for method in ("contact_rand", "approach_rand")
    }  # fmt: skip


def test_a_setting_that_differs_is_drawn_and_tabled_by_its_value(tmp_path: Path) -> None:
    for sigma, n in ((0.05, 60), (0.1, 40), (0.4, 80)):
        for seed in (0, 1):
            settings = {"method": "me_scs", "mutation_sigma": sigma, "seed": seed, "evaluations": 80}
            rows = random_rows(80, seed=seed)
            rows["outcome"][n:] = Outcome.MISSED
            record(tmp_path / f"runs/{sigma}-{seed}", made_scene(), rows, **settings)
    out = analysed(tmp_path).out
    rows = table(out / "settings.csv")
    assert [(row["value"], row["is_default"], row["runs"]) for row in rows] == [
        ("0.05", "no", "2"), ("0.1", "yes", "2"), ("0.4", "no", "2"),
    ]  # fmt: skip
    assert matplotlib.image.imread(out / "settings.png")[..., :3].min() < 0.5
    page = (out / "tables.md").read_text()
    assert "| mutation_sigma | 0.05 | 0.1 | 0.4 | best | default over best |" in page
    default, best = (float(rows[place]["median"]) for place in (1, 2))
    assert f"| 0.4 | {default / best:.2f}, ranges do not overlap |" in page


def test_a_sweep_of_runs_that_found_nothing_has_no_best_value(tmp_path: Path) -> None:
    rows = random_rows(20)
    rows["outcome"] = Outcome.MISSED
    for sigma in (0.1, 0.2):
        settings = {"method": "me_scs", "mutation_sigma": sigma, "evaluations": 20}
        record(tmp_path / f"runs/{sigma}", made_scene(), rows, **settings)
    page = (analysed(tmp_path).out / "tables.md").read_text()
    assert "| me_scs | 0 [0, 0] default | 0 [0, 0] |  | nothing was found |" in page


def test_a_claim_on_methods_that_found_nothing_has_no_interval_and_says_why(tmp_path: Path) -> None:
    rows = random_rows(20)
    rows["outcome"] = Outcome.MISSED
    for method in ("contact_rand", "contact_me_scs"):
        record(tmp_path / "runs" / method, made_scene(), rows, method=method, evaluations=20)
    page = (analysed(tmp_path).out / "tables.md").read_text()
    assert re.search(r"`contact_me_scs / contact_rand`.*nan \| none: nothing was found", page)


def test_a_search_of_a_program_s_own_is_drawn_beside_the_others(tmp_path: Path) -> None:
    for method in ("contact_rand", "custom_contact", "custom_aimed"):
        record(tmp_path / "runs" / method, made_scene(), random_rows(20), method=method, evaluations=20)
    found = analysed(tmp_path)
    assert set(found.left_out) == {"settings"}
    assert [*dict.fromkeys(row["method"] for row in table(found.out / "variants.csv"))] == [
        "contact_rand", "custom_aimed", "custom_contact",
    ]  # fmt: skip


def test_what_cannot_be_drawn_is_refused(tmp_path: Path, campaign: Path) -> None:
    with pytest.raises(UnknownName, match="method in this campaign 'approach_rand'"):
        analysed(campaign, methods=["contact_rand", "approach_rand"])
    with pytest.raises(UnknownName, match="object in this campaign 'mug'"):
        analysed(campaign, objects=["mug"])
    record(tmp_path / "empty/a", made_scene(), random_rows(0))
    with pytest.raises(FolderError, match="has recorded an evaluation yet"):
        analysed(tmp_path / "empty")


def test_the_command_prints_the_verdicts(campaign: Path) -> None:
    said = CliRunner().invoke(app, ["analyse", str(campaign), "--log"]).stdout
    assert "(c) antipodal ME_scs plateaus (Figure 2): not in this campaign." in said
    assert "6 runs, 2 of them unfinished." in said
    done = CliRunner().invoke(app, ["analyse", str(campaign), "--json", "--method", "contact_rand"])
    values = json.loads(done.stdout)
    assert (values["runs"], values["claims"]["c"]) == (6, "not in this campaign")
    assert set(values["left_out"]) == {"settings"}
    assert {row["method"] for row in table(campaign / "analysis/voxels.csv")} == {"contact_rand"}


def test_a_copy_of_a_run_and_a_shorter_run_of_its_search_are_no_runs_of_their_own(campaign: Path) -> None:
    home, before = campaign / "runs", analysed(campaign)
    shutil.copytree(home / "jaw-block-contact_rand-s0", home / "another")
    rows = random_rows(50, seed=10 * METHODS.index("me_scs"))
    record(home / "shorter", made_scene(), rows, method="me_scs", seed=0, evaluations=50)
    after = analysed(campaign)
    assert (after.runs, after.repeats) == (before.runs, ["jaw-block-contact_rand-s0", "shorter"])
    said = "2 runs are left out, as other runs are of the same search, and as long or longer: "
    assert said in (campaign / "analysis" / "tables.md").read_text()
