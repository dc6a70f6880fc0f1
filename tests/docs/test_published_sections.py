"""Figures of the sections of the page of results, recomputed by other means."""

import re
from pathlib import Path

import numpy as np
import pandas
import pytest
from numpy.typing import NDArray
from tests.docs.test_published_numbers import (
    RESULTS,
    SWEPT,
    TUNING,
    Runs,
    Values,
    benchmark,
    bootstrap,
    counted_runs,
    for_touch,
    lines_with,
    near,
    on_scene,
    part,
    ratio,
    read_runs,
    spread,
    words_of,
)

from qdgrasp_coordinator.metrics.reference_coverage import read_references

COVERAGE_MARKS = {"1,000": "1k", "2,000": "2k", "5,000": "5k", "10,000": "10k"}


def test_the_sweep_is_the_median_over_seeds_and_the_best_setting_stands_out() -> None:
    shown = lines_with(part("Settings of the baselines"), "share of the best")
    if not shown:
        pytest.skip("the sweep is not in yet")
    swept = benchmark(read_runs())
    swept = swept[
        (swept["gripper"] == "panda") & swept["object"].isin(TUNING) & (swept["budget"] == SWEPT)
    ].copy()
    swept["population"] = swept["settings"].str.extract(r"population=(\d+)")[0].fillna("500")
    sigma = swept["settings"].str.extract(r"mutation_sigma=(\S+)")[0].fillna("0.1")
    swept["sigma"] = sigma.where(~swept["method"].str.endswith("cma_mae"), "")
    medians = swept.groupby(["method", "population", "sigma", "object"])["robust_cells"].median().unstack()
    shares = (medians / medians.max())[TUNING].mean(axis=1)
    assert len(shown) == len(shares)
    for line in shown:
        setting = (line["method"].strip("`"), line["population"], line["sigma"])
        assert [line[scene].split()[0] for scene in TUNING] == [
            f"{medians.loc[setting, scene]:.0f}" for scene in TUNING
        ]
        is_best = shares[setting] == shares[setting[0]].max()
        assert line["share of the best"] == (
            f"**{shares[setting]:.0%}**" if is_best else f"{shares[setting]:.0%}"
        )


def test_coverage_is_the_median_over_seeds() -> None:
    runs = read_runs()
    shown = lines_with(part("Coverage of S_G by the search for touch"), "budget")
    assert shown
    for line in shown:
        mine = counted_runs(on_scene(for_touch(runs), line), line, line["budget"])
        mine = mine[(mine["words"] == "`aimed` for touch") & (mine["protocol"] == line["protocol"])]
        assert int(line["runs"].split(" ")[0]) == len(mine)
        for mark, column in COVERAGE_MARKS.items():
            assert line[mark] == spread(100 * mine[f"coverage_{column}"], 1)
        assert line["end"] == spread(100 * mine["coverage"], 1)
        outside = 1 - mine["coverage"] * mine["set_size"] / mine["cells"]
        assert line["outside"] == spread(100 * mine["outside"].fillna(outside), 1)
        assert line["robust"] == spread(100 * mine["robust_share"], 1)
        assert line["mean best fitness"] == spread(mine["mean_best"], 2)
        assert line["orientations"] == spread(mine["orientations"], 2)


def test_the_rate_of_coverage_is_that_of_a_cpu_second() -> None:
    runs = read_runs()
    shown = lines_with(part("Coverage for CPU time"), "a success, ms")
    assert shown
    for line in shown:
        mine = counted_runs(on_scene(for_touch(runs), line), line, line["evaluations"])
        mine = mine[(mine["words"] == line["method"]) & mine["coverage"].notna()]
        assert int(line["runs"].split(" ")[0]) == len(mine)
        assert line["coverage, %"] == spread(100 * mine["coverage"], 1)
        assert line["CPU s"] == spread(mine["cpu_seconds"], 0)
        costs = mine[mine["success_ms"].notna()]
        if len(costs):
            assert line["a success, ms"] == spread(costs["success_ms"], 1)
            costs = costs[costs["success_ms"] > 0]
            ceilings = 100 / (costs["set_size"] * costs["success_ms"] / 1000)
            assert line["ceiling, % a CPU s"] == spread(ceilings, 2)
        assert line["% of S_G a CPU s"] == spread(100 * mine["coverage"] / mine["cpu_seconds"], 3)


def chao2(reached: NDArray[np.bool_]) -> float:
    """The estimated number of all cells, from those that each run found (runs, cells)."""
    times, n = reached.sum(axis=0), len(reached)
    seen, once, twice = (int(np.sum(chosen)) for chosen in (times > 0, times == 1, times == 2))
    return seen + (n - 1) / n * once**2 / (2 * twice)


def test_reference_sets_are_those_of_the_files_beside_the_table() -> None:
    section, folder = part("Reference sets of our own"), RESULTS / "reference-sets"
    sizes, shares = lines_with(section, "cells that hold"), lines_with(section, "together, %")
    listed = pandas.read_csv(folder / "runs.csv", keep_default_na=False)
    assert len(sizes) == len([*folder.glob("*.npz")]) > 0
    for line in sizes:
        scene = (line["hand"], line["object"], line["protocol"])
        with np.load(folder / f"{'-'.join(scene).replace(' ', '-')}.npz") as file:
            (key,) = (key.removesuffix(".cm") for key in file if key.endswith(".cm"))
            best, names = file[f"{key}.by_run"], [str(run) for run in file[f"{key}.runs"]]
        holding = best == 3  # 1 + the greatest fitness of a set
        rows = listed.set_index("run").loc[names]
        arms_of = rows.groupby("seed")[["budget", "method", "settings"]].apply(
            lambda one: {*one.itertuples(index=False)}
        )
        whole = [seed for seed, arms in arms_of.items() if arms == set.union(*arms_of)]
        assert (line["runs"], line["seeds"]) == (str(len(names)), str(len(whole)))
        for reached, count, estimate in (
            (best > 0, "cells", "estimated cells"),
            (holding, "cells that hold", "estimated to hold"),
        ):
            assert line[count] == str(reached.any(axis=0).sum())
            units = np.array([reached[rows["seed"] == seed].any(axis=0) for seed in whole])
            seen = reached.any(axis=0).sum()
            if len(units) < 5 or units.any(axis=0).sum() < seen:
                assert not line[estimate]
                continue
            assert line[estimate].startswith(f"{chao2(units):.0f} (")
            assert chao2(units) >= seen
        here = listed["gripper"] + "|" + listed["object"] + "|" + listed["protocol"]
        mine = listed[here == "|".join(scene)]
        assert sorted(mine["run"]) == sorted(names)
        counted = holding if scene[2].startswith("physical") else best > 0
        counted = counted[:, counted.any(axis=0)]
        arms: dict[tuple[str, str], list[int]] = {}
        for budget, method, settings, run in mine[["budget", "method", "settings", "run"]].itertuples(
            index=False
        ):
            arms.setdefault((f"{budget:,}", words_of(method, settings)), []).append(names.index(run))
        covered = [one for one in shares if (one["hand"], one["object"], one["protocol"]) == scene]
        assert len(covered) == len(arms)
        for one in covered:
            places = arms[one["evaluations"], one["method"]]
            others = [n for arm, some in arms.items() if arm[1] != one["method"] for n in some]
            together = counted[places].any(axis=0)
            alone = together & ~counted[others].any(axis=0)
            assert one["coverage, %"] == spread(100 * counted[places].mean(axis=1), 1)
            assert (one["together, %"], one["alone, %"]) == tuple(
                f"{100 * found.mean():.1f}" for found in (together, alone)
            )


def test_sigma_is_that_of_the_runs() -> None:
    every = read_runs()
    is_paper = (every["gripper"] == "panda") & (every["protocol"] == "paper")
    runs = every[is_paper & every["settings"].str.contains("surface_seed=seed")]
    sigma = runs["settings"].str.extract(r"mutation_sigma=(\S+)")[0].fillna("0.1")
    for line in lines_with(part("The mutation's sigma"), "0.1 of the best, %"):
        budget, name = int(line["evaluations"].replace(",", "")), line["method"].strip("`")
        here = runs[
            (runs["object"] == line["object"]) & (runs["method"] == name) & (runs["budget"] == budget)
        ]
        reached = {value: 100 * some["coverage"] for value, some in here[here["seed"] <= 3].groupby(sigma)}
        shown = {value: line[value].strip("*") for value in reached}
        assert shown == {value: spread(some, 2) for value, some in reached.items()}
        medians = {value: some.median() for value, some in reached.items()}
        best = max(medians, key=medians.get)
        assert [value for value in reached if line[value].startswith("**")] == [best]
        assert line["0.1 of the best, %"] == f"{100 * medians['0.1'] / medians[best]:.0f}"


def test_the_page_on_coverage_says_how_low_the_estimate_of_the_drill_is(reference_data: Path) -> None:
    (line,) = (
        one
        for one in lines_with(part("Reference sets of our own"), "cells that hold")
        if (one["hand"], one["object"], one["protocol"]) == ("panda", "ycb_power_drill", "paper")
    )
    (own,) = read_references(RESULTS / "reference-sets/panda-ycb_power_drill-paper.npz").values()
    published = read_references(reference_data / "reference/S_G_panda_2f.npz")["power_drill"]
    known = len(np.unique(np.concatenate([own.cells, published.cells]), axis=0))
    page = " ".join((RESULTS.parent / "coverage.md").read_text(encoding="utf-8").split())
    found, estimate = line["cells"], line["estimated cells"].split()[0]
    assert f"{line['runs']} short runs found {found} cells, and the estimate is of {estimate}." in page
    assert f"at least {known:,} cells are known".replace(",", " ") in page


BANDS = {
    "a": (1, np.inf), "b": (0.8, 1.25), "c": (-np.inf, 0.1), "d": (0.5, np.inf), "e": (-np.inf, 0.5),
    "f": (1, np.inf), "g": (1, np.inf), "h": (1, np.inf),
}  # fmt: skip
COVERAGE_AT = {500: "500", 1000: "1k", 2000: "2k", 5000: "5k", 10_000: "10k", 50_000: "50k"}


class ClaimLine:
    """A line of the table of numbers, with the runs that it is of."""

    def __init__(self, line: dict[str, str], runs: Runs) -> None:
        self.line, self.letter = line, line[""]
        self.names = re.findall(r"`\w+`", line["number"])
        self.budget = int(line["evaluations"].replace(",", ""))
        is_here = runs["words"].isin(self.names) & (runs["budget"] == self.budget)
        here = runs[is_here & (runs["gripper"] == line["hand"])]
        self.scenes = [
            [scene[scene["words"] == name].sort_values("seed") for name in self.names]
            for _, scene in here.groupby("object")
            if set(scene["words"]) == set(self.names)
        ]
        self.scenes = [scene for scene in self.scenes if min(map(len, scene)) >= 5] or self.scenes
        self.seeds = min(len(arm) for scene in self.scenes for arm in scene)

    def interval(self, budget: int, seeds: int) -> tuple[float, float, float]:
        """The number after so many evaluations, of the first seeds alone, and its interval."""
        arms = [[arm.iloc[:seeds] for arm in scene] for scene in self.scenes]
        if len(self.names) == 2:
            value = (lambda arm, _: arm["near_nu"].to_numpy()) if self.letter == "h" else self.reached
            pairs = [tuple(value(arm, budget) for arm in scene) for scene in arms]
            if not any(upper.any() for upper, _ in pairs):
                return 0.0, 0.0, 0.0
            low, high, _ = bootstrap(pairs, is_ratio=True)
            return ratio(pairs), np.exp(low), np.exp(high)
        values = [self.share(arm, budget) for (arm,) in arms]
        low, high, _ = bootstrap([(some, np.zeros(2)) for some in values], is_ratio=False)
        return float(np.mean([some.mean() for some in values])), max(low, 0.0), min(high, 1.0)

    def alone(self, scene: list[Runs]) -> float:
        """The number of one object alone; nan where nothing was found."""
        arms = [arm.iloc[: self.seeds] for arm in scene]
        if len(arms) == 1:
            return float(self.share(arms[0], self.budget).mean())
        upper, lower = (
            (arm["near_nu"] if self.letter == "h" else pandas.Series(self.reached(arm, self.budget))).mean()
            for arm in arms
        )
        return upper / lower if lower else np.nan

    def share(self, arm: Runs, budget: int) -> Values:
        if self.letter == "d":
            return arm["near_nu"].dropna().to_numpy()
        return 1 - self.reached(arm, budget // 2) / self.reached(arm, budget)

    def reached(self, arm: Runs, budget: int) -> Values:
        """Coverage after so many evaluations, in the end cells where there is no set."""
        column = "coverage" if budget == self.budget else f"coverage_{COVERAGE_AT[budget]}"
        return (arm["cells"] if arm["coverage"].isna().all() else arm[column]).to_numpy(float)

    def verdicts(self, budget: int, seeds: int) -> set[str]:
        """The verdicts that an interval of other draws may give."""
        _, low, high = self.interval(budget, seeds)
        slack = 0.15 * (high - low)
        ends = [(low + a * slack, high + b * slack) for a in (-1, 0, 1) for b in (-1, 0, 1)]
        return {verdict_of(self.letter, *one) for one in ends}

    def check_stability(self, budgets: list[int]) -> None:
        """Check from where on the verdict stays, over budgets with all seeds, and over seeds at the end."""
        by_budget = {budget: self.verdicts(budget, self.seeds) for budget in budgets}
        by_seeds = {seeds: self.verdicts(self.budget, seeds) for seeds in range(5, self.seeds + 1)}
        for column, known in (("stable from evaluations", by_budget), ("from seeds", by_seeds)):
            if len(known) == 1:
                assert not self.line[column]
                continue
            first = int(self.line[column].replace(",", ""))
            assert all(self.line["verdict"] in some for at, some in known.items() if at >= first)
            before = [some for at, some in known.items() if at < first]
            assert not before or before[-1] != {self.line["verdict"]}


def verdict_of(letter: str, low: float, high: float) -> str:
    least, most = BANDS[letter]
    if low > least and high < most:
        return "agrees"
    return "does not" if high <= least or low >= most else "cannot be said"


def test_the_page_on_the_papers_experiment_says_what_the_runs_say() -> None:
    page = " ".join((RESULTS.parent / "experiment.md").read_text(encoding="utf-8").split())
    every = read_runs()
    runs = every[(every["protocol"] == "paper") & (every["settings"] == "surface_seed=seed")]
    long = runs[(runs["method"] == "antipodal_me_scs") & (runs["budget"] == 100_000)]
    long = long.assign(late=1 - long["coverage_50k"] / long["coverage"])
    means = 100 * long.groupby("object")[["coverage", "late"]].mean()
    (cube, late), (mug, late_on_mug) = (means.loc[name] for name in ("ycb_rubiks_cube", "ycb_mug"))
    assert f"covers {cube:.0f} and {mug:.0f} % of S_G" in page
    assert f"still added {late:.0f} and {late_on_mug:.0f} % of that" in page
    assert (long.groupby("object").size() == 2).all()
    assert long["late"].min() > 0.15  # "no run is near" 10 %
    is_like = (every["protocol"] == "paper") & (every["settings"] == "") & (every["overlaps"] == "count")
    on_mug = every[is_like & (every["budget"] == 5000) & (every["object"] == "ycb_mug")]
    on_mug = 100 * on_mug[on_mug["gripper"] == "panda"].groupby("method")["coverage"].mean()
    contact, drawn, antipodal = on_mug[["contact_me_scs", "antipodal_rand", "antipodal_me_scs"]]
    assert (
        f"`contact_me_scs` covers {contact:.1f} % after 5000 evaluations, `antipodal_rand` {drawn:.1f} %"
        in page
    )
    assert f"and `antipodal_me_scs` {antipodal:.1f} %" in page
    short = runs[(runs["gripper"] == "panda") & (runs["budget"] == 5000)]
    near = short[short["method"] == "contact_me_scs"].groupby("object")["near_nu"].mean()
    cube_and_drill = f"{100 * near['ycb_rubiks_cube']:.0f} and {100 * near['ycb_power_drill']:.0f} %"
    assert f"With the Panda {cube_and_drill} of the successes of `contact_me_scs` on cube and drill" in page
    assert f"it is {100 * near['ycb_mug']:.0f} %. With" in page
    others = runs[(runs["gripper"] != "panda") & (runs["budget"] == 5000)]
    least, most = (
        others[others["method"] == "contact_me_scs"].groupby("gripper")["near_nu"].mean().agg(["min", "max"])
    )
    assert f"With the other hands, of one seed, {100 * least:.0f} to {100 * most:.0f} % do" in page
    least, most = (
        others[others["method"] == "contact_rand"].groupby("gripper")["near_nu"].mean().agg(["min", "max"])
    )
    assert f"and of `contact_rand` {100 * least:.0f} to {100 * most:.0f} %" in page


def test_the_papers_claims_are_judged_from_the_runs() -> None:
    section, every = part("The paper's claims"), read_runs()
    runs = every[(every["protocol"] == "paper") & every["settings"].str.contains("surface_seed=seed")]
    numbers = [ClaimLine(line, runs) for line in lines_with(section, "number")]
    if not numbers:
        pytest.skip("no runs of the claims' campaigns are in")
    for one in numbers:
        line = one.line
        assert (line["objects"], line["seeds"]) == (str(len(one.scenes)), str(one.seeds))
        value, low, high = one.interval(one.budget, one.seeds)
        assert line["value"] == f"{value:.3g}"
        alone = sorted(one.alone(scene) for scene in one.scenes)
        alone = [single for single in alone if not np.isnan(single)]
        assert line["of single objects"] == (f"{alone[0]:.3g} to {alone[-1]:.3g}" if len(alone) > 1 else "")
        if not value:  # no run of the first method has found anything: there is nothing to draw
            assert (line["95% interval"], line["verdict"]) == ("0 to 0", verdict_of(one.letter, 0, 0))
            continue
        if one.seeds < 5:
            assert (line["95% interval"], line["stable from evaluations"]) == ("", "")
            continue
        said = [float(end) for end in line["95% interval"].split(" to ")]
        ends = np.array([said, [low, high]])
        if not said[0]:  # draws of a method that has found nothing in some runs
            assert low == 0
            ends[:, 0] = ends[:, 1] / 10
        ends = np.log(ends) if len(one.names) == 2 else ends  # a ratio's is formed on its logarithm
        width = 1.2 * (ends[0, 1] - ends[0, 0])  # of five runs, draws differ more
        assert near(ends[0, 0], ends[1, 0], width), line
        assert near(ends[0, 1], ends[1, 1], width), line
        if line["verdict"] == "to compare with":
            continue
        assert line["verdict"] == verdict_of(one.letter, *said)
        milestones = [at for at in COVERAGE_AT if at < one.budget]
        if one.letter == "c":
            milestones = [at for at in milestones if at // 2 in COVERAGE_AT]
        one.check_stability([*([] if one.letter in "dh" else milestones), one.budget])
    for line in lines_with(section, "outside, %"):
        mine = runs[(runs["gripper"] == line["hand"]) & (runs["object"] == line["object"])]
        mine = mine[
            (mine["words"] == line["method"]) & (mine["budget"] == int(line["evaluations"].replace(",", "")))
        ]
        assert line["runs"].split(" of ")[0] == str(len(mine))
        assert line["coverage, %"] == spread(100 * mine["coverage"], 2)
        outside = 1 - mine["coverage"] * mine["set_size"] / mine["cells"]
        assert line["outside, %"] == spread(100 * mine["outside"].fillna(outside).dropna(), 1)
    for line in lines_with(section, "agrees when"):
        for column, cell in [*line.items()][3:]:
            hand, budget, _ = column.split(", ")
            found = [
                one.line["verdict"]
                for one in numbers
                if (one.letter, one.line["hand"], one.line["evaluations"]) == (line[""], hand, budget)
                and one.line["verdict"] != "to compare with"
            ]
            agreeing, wanted = map(int, re.search(r"(\d+) of (\d+)|$", cell).groups("0"))
            assert (agreeing, bool(cell)) == (found.count("agrees"), bool(found))
            if "does not" in found:
                assert cell.startswith("**does not**")
            elif cell:
                assert len(found) <= wanted
                assert cell.startswith("**agrees**") == (agreeing == wanted)
