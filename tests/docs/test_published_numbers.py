"""The figures of the page of results, recomputed from the CSV by other means than those that made it."""

import re
from pathlib import Path

import pandas
import pytest

RESULTS = Path(__file__).resolve().parents[2] / "docs" / "results"
TWO_FINGERS = ["panda", "robotiq_2f", "xarm", "pr2"]
COVERED = ("hand", "object", "protocol", "counting", "budget")
TUNING = ["ycb_rubiks_cube", "ycb_mug", "ycb_power_drill"]
SWEPT = 3000
"""Evaluations of a run of the sweep, which is on the tuning scenes too."""


@pytest.fixture(scope="module")
def runs() -> pandas.DataFrame:
    table = pandas.read_csv(RESULTS / "runs.csv", keep_default_na=False, na_values=[""])
    table["settings"] = table["settings"].fillna("")
    return table


def part(heading: str) -> str:
    """A section of the page, without its heading."""
    page = (RESULTS / "index.md").read_text(encoding="utf-8")
    found = re.search(rf"^## {re.escape(heading)}\n(.*?)(?=^## |\Z)", page, re.MULTILINE | re.DOTALL)
    assert found is not None, heading
    return found[1]


def lines(text: str, first: str) -> list[list[str]]:
    """The lines of tables whose first column begins in a way."""
    cells = ([cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines())
    return [line for line in cells if line[0].startswith(first)]


def group_of(run: pandas.Series) -> str:
    if run["gripper"] == "panda" and run["object"] in TUNING:
        return "tuning"
    return "held out, two fingers" if run["gripper"] in TWO_FINGERS else "held out, more fingers"


def test_the_sums_over_the_benchmark_are_those_of_its_runs(runs: pandas.DataFrame) -> None:
    chosen = runs[
        (runs["protocol"] == "physical in mujoco") & runs["settings"].str.contains("surface_seed=seed")
    ].copy()
    shown = [line for first in ("held out", "tuning") for line in lines(part("Grasps that hold"), first)]
    if chosen.empty:
        assert shown == []
        return
    chosen["group"] = chosen.apply(group_of, axis=1)
    chosen["rate"] = chosen["robust_cells"] / chosen["cpu_seconds"]
    for group, method, hands, objects, count, cells, niches, seconds, rate, *_ in shown:
        name, _, change = method.strip("*").replace("`", "").partition(" ")
        mine = chosen[(chosen["group"] == group) & (chosen["method"] == name)]
        usual = {"aimed": 50, "contact_cma_mae": 540, "antipodal_cma_mae": 540}.get(name, 500)
        population = int(found[1]) if (found := re.search(r"population=(\d+)", change)) else usual
        said = mine["settings"].str.extract(r"population=(\d+)")[0].fillna(500).astype(int)
        is_of_the_sweep = (group == "tuning") & (mine["budget"] == SWEPT)
        mine = mine[(said == population) & ~is_of_the_sweep]
        per_scene = mine.groupby(["gripper", "object", "budget"])
        medians = per_scene[["robust_cells", "robust_niches", "cpu_seconds", "rate"]].median().mean()
        assert (int(hands), int(objects), int(count)) == (
            mine["gripper"].nunique(), mine["object"].nunique(), len(mine)
        )  # fmt: skip
        found_here = [f"{medians['robust_cells']:.0f}", f"{medians['robust_niches']:.0f}"]
        assert [cells, niches] == found_here
        assert [seconds, rate] == [f"{medians['cpu_seconds']:.0f}", f"{medians['rate']:.1f}"]


def test_the_sweep_is_the_median_over_seeds_and_the_best_setting_stands_out(runs: pandas.DataFrame) -> None:
    page = (RESULTS / "index.md").read_text(encoding="utf-8")
    if "## Settings of the baselines" not in page:
        pytest.skip("the sweep is not in yet")
    shown = lines(part("Settings of the baselines"), "`")
    swept = runs[
        (runs["protocol"] == "physical in mujoco") & runs["settings"].str.contains("surface_seed=seed")
        & (runs["gripper"] == "panda") & runs["object"].isin(TUNING) & (runs["budget"] == SWEPT)
    ].copy()  # fmt: skip
    swept["population"] = swept["settings"].str.extract(r"population=(\d+)")[0].fillna("500")
    sigma = swept["settings"].str.extract(r"mutation_sigma=(\S+)")[0].fillna("0.1")
    swept["sigma"] = sigma.where(~swept["method"].str.endswith("cma_mae"), "")
    medians = swept.groupby(["method", "population", "sigma", "object"])["robust_cells"].median().unstack()
    shares = (medians / medians.max())[TUNING].mean(axis=1)
    assert len(shown) == len(shares)
    for method, population, sigma_said, _, *cells, share in shown:
        setting = (method.strip("`"), population, sigma_said)
        assert [cell.split()[0] for cell in cells] == [
            f"{medians.loc[setting, scene]:.0f}" for scene in TUNING
        ]
        is_best = shares[setting] == shares[setting[0]].max()
        assert share == (f"**{shares[setting]:.0%}**" if is_best else f"{shares[setting]:.0%}")


def test_coverage_is_the_median_over_seeds(runs: pandas.DataFrame) -> None:
    section = part("Coverage of S_G by the search for touch")
    shown = [line for line in lines(section, "") if len(line) > len(COVERED)]
    assert shown
    for line in shown[2:]:
        hand, target, protocol, counting, budget = line[: len(COVERED)]
        overlaps = {"overlaps redrawn": "redraw", "every pose counted": "count"}[counting]
        mine = runs[
            (runs["gripper"] == hand) & (runs["object"] == target) & (runs["protocol"] == protocol)
            & (runs["overlaps"] == overlaps) & (runs["budget"] == int(budget.replace(",", "")))
            & (runs["method"] == "aimed") & (runs["settings"] == "population=50")
        ]  # fmt: skip
        assert line[shown[0].index("end")].split(" ")[0] == f"{100 * mine['coverage'].median():.1f}"
