"""The figures of the page of results, recomputed from the CSV by other means than those that made it."""

import re
from collections import Counter
from collections.abc import Iterator
from itertools import product
from pathlib import Path

import numpy as np
import pandas
import pytest
from numpy.typing import NDArray

RESULTS = Path(__file__).resolve().parents[2] / "docs" / "results"
BENCHMARK, TOUCH = "The benchmark, scene by scene", "Successes: the search for touch against the others"
BEST_OTHER = "best other of each scene"
TWO_FINGERS = ["panda", "robotiq_2f", "xarm", "pr2"]
TUNING = ["ycb_rubiks_cube", "ycb_mug", "ycb_power_drill"]
SEEDS = {False: 5, True: 10}
"""Seeds of a method on a scene, by whether that is a tuning scene."""
SWEPT = 3000
"""Evaluations of a run of the sweep, which is on the tuning scenes too."""
COUNTINGS = {"overlaps redrawn": "redraw", "every pose counted": "count"}
USUAL_POPULATION = {"aimed": "50"} | dict.fromkeys(
    (f"{prior}cma_mae" for prior in ("", "contact_", "approach_", "antipodal_")), "540"
)
CPU_MARKS = (320, 224, 160, 112, 80, 56, 40, 28, 20, 14, 10, 7, 5)
"""Seconds, the most first."""
DRAWS = 2000
LEAST_P_VALUE = 2 / 10_001
"""The least that the page's 10,000 resamples can give."""

Runs = pandas.DataFrame
Values = NDArray[np.float64]
Groups = dict[str, Runs]
Lines = list[dict[str, str]]
Scenes = list[tuple[Values, Values]]
"""For each scene the values of the runs of the default and of another method."""


@pytest.fixture(scope="module")
def runs() -> Runs:
    return read_runs()


def read_runs() -> Runs:
    """The table of runs, with the words for a method and figures that follow from others."""
    table = pandas.read_csv(RESULTS / "runs.csv", keep_default_na=False, na_values=[""])
    table["settings"] = table["settings"].fillna("")
    table["words"] = [words_of(*pair) for pair in zip(table["method"], table["settings"], strict=True)]
    table["screened"] = table["proposals"] / table["evaluations"]
    table["rate"] = table["robust_cells"] / table["cpu_seconds"]
    table["of_poses"] = 1000 * table["robust_cells"] / table["proposals"]
    return table


def words_of(method: str, settings: str) -> str:
    """The name of a method on the page, with the settings that differ from its own."""
    said = dict(word.split("=") for word in settings.split())
    name = f"`{method}`" + (" for touch" if method == "aimed" and "aim_for" not in said else "")
    usual = {"population": USUAL_POPULATION.get(method, "500"), "aim_for": "hold", "in_flight": "400"}
    said = {"population": "500"} | said
    other = [
        f"{key}={said[key]}" for key in sorted(said) if key != "surface_seed" and said[key] != usual.get(key)
    ]
    return name + (f" ({', '.join(other)})" if other else "")


def benchmark(runs: Runs) -> Runs:
    """The runs of the benchmark."""
    is_its = runs["settings"].str.contains("surface_seed=seed") & (runs["protocol"] == "physical in mujoco")
    return runs[is_its].copy()


def for_touch(runs: Runs) -> Runs:
    """The runs neither of the benchmark nor of the paper's claims, whose seeds choose the surface cloud."""
    return runs[
        (runs["protocol"] != "physical in mujoco") & ~runs["settings"].str.contains("surface_seed=seed")
    ]


def part(heading: str) -> str:
    """A section of the page, without its heading; empty if it is not there."""
    page = (RESULTS / "index.md").read_text(encoding="utf-8")
    found = re.search(rf"^## {re.escape(heading)}\n(.*?)(?=^## |\Z)", page, re.MULTILINE | re.DOTALL)
    return found[1] if found else ""


def tables(text: str) -> Iterator[Lines]:
    """The tables of a text, each as a list of lines by column."""
    for table in re.findall(r"(?:^\|.*\n)+", text, re.MULTILINE):
        head, _, *lines = (
            [cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines()
        )
        yield [dict(zip(head, line, strict=True)) for line in lines]


def lines_with(text: str, column: str) -> Lines:
    """The lines of all tables that have a column."""
    return [line for table in tables(text) for line in table if column in line]


def spread(values: Values | pandas.Series, digits: int) -> str:
    """Median and range as on the page."""
    low, middle, high = (f"{value:.{digits}f}" for value in np.quantile(values, (0, 0.5, 1)))
    return middle if len(values) == 1 else f"{middle} ({low} to {high})"


def bootstrap(scenes: Scenes, is_ratio: bool) -> tuple[float, float, float]:
    """Return the ends of the studentised interval of the mean effect over scenes, and its p-value.

    Of a ratio they are those of its logarithm. With ten scenes these are drawn too.
    """
    n = len(scenes)
    if min(len(arm) for scene in scenes for arm in scene) < 2:  # one run has no variance
        return np.nan, np.nan, np.nan

    def estimate(means: Values, variances: Values) -> tuple[Values, Values]:
        (a, b), (of_a, of_b) = np.moveaxis(means, -1, 0), np.moveaxis(variances, -1, 0)
        effects, spread = a - b, of_a + of_b
        if is_ratio:
            effects, spread = a / (a + b), (b**2 * of_a + a**2 * of_b) / (a + b) ** 4
        among = effects.var(axis=-1, ddof=1) / n if n >= 10 else 0.0
        mean, error = effects.mean(axis=-1), np.sqrt(np.maximum(spread.mean(axis=-1) / n, among))
        if is_ratio:
            with np.errstate(divide="ignore", invalid="ignore"):
                return np.log(mean / (1 - mean)), np.where(mean > 0, error / (mean * (1 - mean)), 0.0)
        return mean, error

    random = np.random.default_rng(1)
    chosen = random.integers(n, size=(DRAWS, n)) if n >= 10 else np.tile(np.arange(n), (DRAWS, 1))
    means, variances = np.zeros((2, DRAWS, n, 2))
    for number, arm in product(range(n), (0, 1)):
        values, places = scenes[number][arm], chosen == number
        drawn = random.choice(values, (places.sum(), len(values)))
        means[places, arm] = drawn.mean(axis=1)
        variances[places, arm] = drawn.var(axis=1, ddof=1) / len(values)
    of_runs = (np.array([[of(arm) for arm in scene] for scene in scenes]) for of in (np.mean, _variance))
    value, error = estimate(*of_runs)
    found, errors = estimate(means, variances)
    with np.errstate(divide="ignore", invalid="ignore"):
        pivots = np.where(found == value, 0.0, (found - value) / errors)
    low, high = value - np.quantile(pivots, (0.975, 0.025)) * error
    if np.mean(errors == 0) > 0.025:  # draws of runs that are mostly 0
        low, high = np.quantile(found, (0.025, 0.975), method="inverted_cdf")
    beyond = min(np.mean(pivots >= value / error), np.mean(pivots <= value / error))
    return low, high, min(1.0, 2 * beyond)


def _variance(values: Values) -> float:
    """The variance of a mean."""
    return float(np.var(values, ddof=1) / len(values))


def scenes_of(ours: Runs, theirs: Runs, figure: str) -> Scenes:
    """A figure of the runs of two methods, for each scene that both have."""
    by = ["gripper", "object", "budget"]
    other = {scene: found[figure].to_numpy() for scene, found in theirs.groupby(by)}
    return [(found[figure].to_numpy(), other[scene]) for scene, found in ours.groupby(by) if scene in other]


def ratio(scenes: Scenes) -> float:
    """The default over the other, each scene weighing the same."""
    share = np.mean([a.mean() / (a.mean() + b.mean()) for a, b in scenes])
    return share / (1 - share)


def near(found: float, expected: float, width: float) -> bool:
    """Whether an end of an interval is where other draws put it."""
    return abs(found - expected) <= 0.15 * width


@pytest.fixture(scope="module")
def groups(runs: Runs) -> Groups:
    chosen = benchmark(runs)
    chosen["is_tuning"] = (chosen["gripper"] == "panda") & chosen["object"].isin(TUNING)
    chosen = chosen.groupby(["gripper", "object", "budget", "words"]).filter(
        lambda arm: len(arm) == SEEDS[arm["is_tuning"].iloc[0]]
    )
    chosen = chosen.groupby(["gripper", "object", "budget"]).filter(
        lambda scene: "`aimed`" in set(scene["words"])
    )
    is_tuning = chosen["is_tuning"]
    has_jaw = chosen["gripper"].isin(TWO_FINGERS)
    is_new = ~chosen["object"].str.startswith("ycb_") | chosen["gripper"].isin(["xarm", "pr2"])
    return {
        "tuning": chosen[is_tuning & (chosen["budget"] != SWEPT)],
        "held out, two fingers": chosen[~is_tuning & has_jaw],
        "held out, more fingers": chosen[~is_tuning & ~has_jaw],
        "new hands and objects": chosen[is_new],
    }


def both(group: Runs, method: str) -> tuple[Runs, Runs]:
    """The runs of the default and of a method on the scenes that have runs of both."""
    scenes = ["gripper", "object", "budget"]
    names = {"`aimed`", method}
    shared = group.groupby(scenes).filter(lambda scene: names <= set(scene["words"]))
    return shared[shared["words"] == "`aimed`"], shared[shared["words"] == method]


@pytest.fixture(scope="module")
def summary() -> Lines:
    lines = lines_with(part("Grasps that hold"), "niches that hold")
    return [line for line in lines if line["method"] != BEST_OTHER]


def test_sums_are_means_over_scenes_of_medians_over_runs(groups: Groups, summary: Lines) -> None:
    for line in summary:
        group, method = groups[line["scenes"]], line["method"].strip("*")
        mine = both(group, method)[1] if method != "`aimed`" else group[group["words"] == method]
        assert (int(line["hands"]), int(line["objects"]), int(line["runs"])) == (
            mine["gripper"].nunique(), mine["object"].nunique(), len(mine)
        )  # fmt: skip
        figures = {
            "cells that hold": ("robust_cells", 0), "niches that hold": ("robust_niches", 0),
            "QD score": ("qd_score", 0), "poses screened": ("screened", 1), "CPU s": ("cpu_seconds", 0),
            "cells that hold a CPU s": ("rate", 1), "cells that hold for 1,000 poses": ("of_poses", 0),
        }  # fmt: skip
        for name, (column, digits) in figures.items():
            mean = mine.groupby(["gripper", "object", "budget"])[column].median().mean()
            assert line[name] == f"{mean:.{digits}f}"


def test_ratios_over_scenes_and_their_intervals(groups: Groups, summary: Lines) -> None:
    for line in summary:
        if line["method"].strip("*") == "`aimed`":
            continue
        ours, theirs = both(groups[line["scenes"]], line["method"])
        check_ratio(line["default over it, equal evaluations"], scenes_of(ours, theirs, "robust_cells"))
        check_ratio(line["default over it, niches"], scenes_of(ours, theirs, "robust_niches"))
        timed = [
            at
            for scene in ours.groupby(["gripper", "object"]).groups
            if (at := equal_cpu(ours, theirs, scene))
        ]
        check_ratio(line["default over it, equal CPU"], [pair for _, pair in timed])


def test_the_best_other_of_each_scene_is_the_one_that_the_readme_names(groups: Groups) -> None:
    summed = lines_with(part("Grasps that hold"), "QD score")
    lines = [line for line in summed if line["method"] == BEST_OTHER]
    readme = " ".join((RESULTS.parents[1] / "README.md").read_text(encoding="utf-8").split())
    for line in lines:
        group, found = groups[line["scenes"]], []
        for scene in set(group[["gripper", "object"]].itertuples(index=False, name=None)):
            ours, *others = (found for _, found in at(group, scene).groupby("words"))
            pairs, niches = (
                [scenes_of(ours, other, figure)[0] for other in others]
                for figure in ("robust_cells", "robust_niches")
            )
            timed = [later[1] for other in others if (later := equal_cpu(ours, other, scene))]
            found.append([min(some, key=lambda pair: ratio([pair])) for some in (pairs, timed, niches)])
        shown = [line[f"default over it, {words}"] for words in ("equal evaluations", "equal CPU", "niches")]
        for said, pairs in zip(shown, zip(*found, strict=True), strict=True):
            check_ratio(said, list(pairs))
        ahead, later, apart = (f"{float(said.split()[0]):.1f}" for said in shown)
        sentences = {
            "held out, two fingers": (
                f"so far {len(found)} with hands of two fingers, it has found grasps that hold in {ahead} ",
                f"in {later} times as many after as much CPU time",
                f"With orientations told apart the first number is {apart}.",
            ),
            "held out, more fingers": (
                f"With hands of more fingers, so far {line['hands']} hands on {line['objects']} object, "
                f"it is {ahead} times as many, and {later} times",
            ),
        }
        assert all(words in readme for words in sentences.get(line["scenes"], ()))
    assert lines


def test_the_page_on_methods_says_how_many_generations_map_elites_has(runs: Runs) -> None:
    held = benchmark(runs)
    held = held[
        held["method"].str.endswith("me_scs")
        & (held["budget"] == 3000)
        & ~held["settings"].str.contains("population")
    ]
    least, most = (f"{of(held['proposals'] / 500):.0f}" for of in (min, max))
    assert f"has {least} to {most} generations in 3000" in (RESULTS / "methods.md").read_text(
        encoding="utf-8"
    )


def test_drawn_grasps_weigh_the_cells_of_their_runs(runs: Runs, groups: Groups) -> None:
    scenes = ["gripper", "object", "budget"]
    for line in lines_with(part("Grasps that hold"), "grasps drawn"):
        group, method = groups[line["scenes"]].copy(), line["method"].strip("*")
        group["both"] = group["robust_cells"] * group["drawn_in_bullet"].fillna(0)
        if method == "`aimed`":
            mine = group[(group["words"] == method) & group["drawn"].notna()]
        else:
            ours, mine = both(group, method)
            missing = pandas.concat([found[found["drawn"].isna()] for found in (ours, mine)])
            left_out = pandas.MultiIndex.from_frame(missing[scenes])
            ours, mine = (
                found[~pandas.MultiIndex.from_frame(found[scenes]).isin(left_out)] for found in (ours, mine)
            )
            check_ratio(line["default over it"], scenes_of(ours, mine, "both"))
        assert int(line["grasps drawn"]) == mine["drawn"].sum()
        means = mine.groupby(scenes)[["drawn_in_bullet", "drawn_eta", "both"]].mean().mean()
        assert int(line["hold in Bullet too, %"]) == pytest.approx(
            100 * means["drawn_in_bullet"], abs=0.500001
        )
        assert line["eta"] == f"{means['drawn_eta']:.2f}"
        assert line["cells that hold in both"] == f"{means['both']:.0f}"


def check_ratio(said: str, scenes: Scenes) -> None:
    """Check a ratio and, where there are several scenes, its interval."""
    value, *ends = re.findall(r"\d+\.\d+|inf", said)
    assert value == f"{ratio(scenes):.2f}"
    if ends:
        low, high, _ = bootstrap(scenes, is_ratio=True)
        assert all(
            near(np.log(float(a)), b, high - low + 0.01) for a, b in zip(ends, (low, high), strict=True)
        )


def equal_cpu(ours: Runs, theirs: Runs, scene: tuple[str, str]) -> tuple[int, tuple[Values, Values]] | None:
    """The most seconds that all runs on a scene took, and cells that hold after them."""
    for seconds in CPU_MARKS:
        columns = [at(found, scene)[f"robust_cells_{seconds}s"] for found in (ours, theirs)]
        if all(column.notna().all() for column in columns):
            return seconds, tuple(column.to_numpy() for column in columns)
    return None


def test_the_first_sentence_counts_where_the_default_is_behind(groups: Groups, summary: Lines) -> None:
    section, compared, timed, behind = part("Grasps that hold"), 0, 0, [0, 0]
    for name in ("tuning", "held out, two fingers", "held out, more fingers"):
        for method in {line["method"] for line in summary if line["scenes"] == name}:
            ours, theirs = both(groups[name], method)
            for scene in ours.groupby(["gripper", "object"]).groups if method != "**`aimed`**" else ():
                (pair,) = scenes_of(*(at(found, scene) for found in (ours, theirs)), "robust_cells")
                later = equal_cpu(ours, theirs, scene)
                compared, timed = compared + 1, timed + (later is not None)
                behind[0] += ratio([pair]) < 1
                behind[1] += later is not None and ratio([later[1]]) < 1
    said = [
        0 if found == "none" else int(found)
        for found in re.findall(r"in (none|\d+) of \d+ comparison", section)
    ]
    assert said == behind
    assert [int(found) for found in re.findall(r"of (\d+) comparison", section)] == [compared, timed]
    assert len(lines_with(section, "after")) == sum(behind)


def at(runs: Runs, scene: tuple[str, str]) -> Runs:
    """The runs on a scene."""
    return runs[(runs["gripper"] == scene[0]) & (runs["object"] == scene[1])]


@pytest.mark.parametrize("heading", [BENCHMARK, TOUCH])
def test_comparisons_are_those_of_the_runs(heading: str, runs: Runs) -> None:
    known, default = (
        (benchmark(runs), "`aimed`") if heading == BENCHMARK else (for_touch(runs), "`aimed` for touch")
    )
    for title, text in re.findall(r"^### (.*?)\n(.*?)(?=^###|\Z)", part(heading), re.MULTILINE | re.DOTALL):
        budget, counting = title.split(" evaluations, ")
        is_here = (known["budget"] == int(budget.replace(",", ""))) & (
            known["overlaps"] == COUNTINGS[counting]
        )
        ours, theirs = (
            known[is_here & (known["words"] == default)],
            known[is_here & (known["words"] != default)],
        )
        compared = lines_with(text, "seeds")
        p_values = [
            compare(line, on_scene(ours, line), on_scene(theirs[theirs["words"] == line["against"]], line))
            for line in compared
        ]
        check_adjusted([line["adjusted p"] for line in compared], p_values)
        if compared:
            verdicts = Counter(line["verdict"] for line in compared)
            said = re.findall(r"(wins|losses|undecided|of few seeds) (\d+)", text)
            assert dict(said) == {VERDICTS[verdict]: str(number) for verdict, number in verdicts.items()}
        for line in lines_with(text, "objects"):
            mine = [found[found["gripper"] == line["hand"]] for found in (ours, theirs)]
            compare_over_objects(line, mine[0], mine[1][mine[1]["words"] == line["against"]])
        for line in lines_with(text, "behind in"):
            shown = re.findall(r"(`\w+`(?: \([^)]*\))?) (\d[\d.]*)", line["by a loss to"] + line["else to"])
            assert shown
            for method, by in shown:
                column, scale, digits = ({name.removesuffix(", %"): of for name, of in BESIDE.items()})[
                    line["behind in"]
                ]
                a, b = (
                    on_scene(found, line)[column].mean()
                    for found in (ours, theirs[theirs["words"] == method])
                )
                assert by == f"{scale * (b - a):.{digits}f}"


def on_scene(runs: Runs, line: dict[str, str]) -> Runs:
    """The runs on the scene of a line."""
    return at(runs, (line["hand"], line["object"]))


def counted_runs(runs: Runs, line: dict[str, str], budget: str) -> Runs:
    """The runs with the counting of a line and a budget."""
    return runs[
        (runs["overlaps"] == COUNTINGS[line["counting"]]) & (runs["budget"] == int(budget.replace(",", "")))
    ]


VERDICTS = {"win": "wins", "loss": "losses", "undecided": "undecided", "few seeds": "of few seeds"}
FIGURES = {
    "coverage, %": ("coverage", 100, 1),
    "cells": ("cells", 1, 0),
    "cells that hold": ("robust_cells", 1, 0),
}
BESIDE = {
    "robust share of S_G, %": ("robust_share", 100, 1),
    "niches that hold": ("robust_niches", 1, 0),
    "QD score": ("qd_score", 1, 0),
    "poses screened": ("screened", 1, 1),
    "mean best fitness": ("mean_best", 1, 2),
    "orientations": ("orientations", 1, 2),
    "niches": ("niches", 1, 0),
}


def compare(line: dict[str, str], ours: Runs, theirs: Runs) -> float:
    """Check a line that compares two methods on a scene, and return its p-value; NaN with too few seeds."""
    counts = {str(len(ours)), str(len(theirs))}
    assert set(line["seeds"].split(" / ")) == counts
    figure, scale, digits = FIGURES[line["of"]]
    a, b = (scale * found[figure].to_numpy() for found in (ours, theirs))
    assert [line["default"], line["other"]] == [spread(a, digits), spread(b, digits)]
    assert line["difference"] == f"{a.mean() - b.mean():+.{digits}f}"
    for name, (column, scale_here, digits_here) in BESIDE.items():
        if name not in line:
            continue
        medians = (scale_here * found[column].median() for found in (ours, theirs))
        assert line[name] == " / ".join("-" if np.isnan(m) else f"{m:.{digits_here}f}" for m in medians)
    if "equal CPU" in line:
        later = equal_cpu(ours, theirs, (line["hand"], line["object"]))
        assert line["equal CPU"] == (f"{ratio([later[1]]):.2f} at {later[0]} s" if later else "")
    if min(len(a), len(b)) < 5:
        assert (line["95% interval"], line["verdict"]) == ("", "few seeds")
        return np.nan
    low, high, p_value = bootstrap([(a, b)], is_ratio=False)
    shown = map(float, line["95% interval"].split(" to "))
    assert all(near(x, y, high - low + 1) for x, y in zip(shown, (low, high), strict=True))
    adjusted = float(line["adjusted p"].removeprefix("≤ "))
    assert line["verdict"] == ("undecided" if adjusted > 0.05 else "win" if a.mean() > b.mean() else "loss")
    return p_value


def check_adjusted(said: list[str], p_values: list[float]) -> None:
    """Check the p-values of a family that are adjusted by the method of Holm."""
    assert ["" if np.isnan(p) else "known" for p in p_values] == [words and "known" for words in said]
    known = sorted(p for p in p_values if not np.isnan(p))
    steps = {p: min(1.0, (len(known) - place) * p) for place, p in reversed([*enumerate(known)])}
    for words, p_value in zip(said, p_values, strict=True):
        if words.startswith("≤"):
            assert words == f"≤ {len(known) * LEAST_P_VALUE:.2g}"
        elif words:
            adjusted = max(step for p, step in steps.items() if p <= p_value)
            assert float(words) == pytest.approx(adjusted, abs=0.05 + 0.25 * adjusted)


def compare_over_objects(line: dict[str, str], ours: Runs, theirs: Runs) -> None:
    """Check a line that compares two methods over the objects of a hand."""
    figure, scale, digits = FIGURES[line["of"]]
    scenes = [(scale * a, scale * b) for a, b in scenes_of(ours, theirs, figure)]
    assert int(line["objects"]) == len(scenes)
    assert line["difference"] == f"{np.mean([a.mean() - b.mean() for a, b in scenes]):+.{digits}f}"
    if line["95% interval"]:
        low, high, _ = bootstrap(scenes, is_ratio=False)
        shown = map(float, line["95% interval"].split(" to "))
        assert all(near(x, y, high - low + 1) for x, y in zip(shown, (low, high), strict=True))


def test_the_runs_that_are_in_are_those_of_the_table(runs: Runs) -> None:
    section = part("Which runs are in")
    counted = {line["evaluation code"].strip("`"): int(line["rows"]) for line in lines_with(section, "rows")}
    assert counted == dict(runs["code"].value_counts())
    assert section.strip().startswith(f"{len(runs)} of the ")
