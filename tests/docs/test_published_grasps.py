"""Figures of the calibration study and of the reference sets, recomputed by other means."""

import re
from collections.abc import Callable

import numpy as np
import pandas
import pytest
from numpy.typing import NDArray
from tests.docs.test_published_numbers import (
    DRAWS,
    RESULTS,
    Runs,
    Values,
    lines_with,
    near,
    part,
    spread,
    words_of,
)

UNSEEN = (
    "friction_050", "weight_200", "weight_500", "torsion_017", "effort_070", "together", "paper_bullet"
)  # fmt: skip
FOUND = r"(\d\.\d\d) \((-?\d\.\d\d) to (-?\d\.\d\d)\)"
"""A number with its interval."""
FINDING = (
    rf"- \*\*{{hand}}\*\*, \d objects?: the (\d+) best-ranked grasps survive {FOUND} of the unseen "
    rf"disturbances, (\d+) random ones that hold {FOUND}; the difference is {FOUND}\. Of pairs of random "
    rf"ones that hold, the one that survives more is told by eta in {FOUND}, by margin in {FOUND}, by both "
    rf"engines in {FOUND}\."
)
"""A sentence of the page."""


@pytest.fixture(scope="module")
def ranked() -> Runs:
    """The grasps of the calibration study."""
    table = pandas.read_csv(RESULTS / "calibration.csv")
    table["survival"] = table[[*UNSEEN]].mean(axis=1)
    table["both"] = (table["fitness"] == 6) & (table["bullet"] == 1)
    return table


def of_scenes(grasps: Runs) -> list[Values]:
    """The survival of the grasps of each scene."""
    return [scene["survival"].to_numpy() for _, scene in grasps.groupby("object")]


def percentiles(draw: Callable[[np.random.Generator], float]) -> tuple[float, float]:
    random = np.random.default_rng(2)
    return tuple(np.quantile([draw(random) for _ in range(DRAWS)], (0.025, 0.975)))


def concordance(grasps: Runs, figure: str) -> float:
    """How often the grasp with the greater figure survives more, of two of a scene that survive unequally."""
    right = pairs = 0.0
    for _, scene in grasps.groupby("object"):
        values, survived = scene[figure].to_numpy(float), scene["survival"].to_numpy()
        more = survived[:, None] > survived
        right += np.sum(more * (np.sign(values[:, None] - values) + 1) / 2)
        pairs += np.sum(more)
    return right / pairs


def test_the_survival_of_ranked_grasps_is_that_of_the_table(ranked: Runs) -> None:
    page = " ".join((RESULTS / "calibration.md").read_text(encoding="utf-8").split())
    for hand, grasps in ranked.groupby("gripper"):
        best, held = (of_scenes(grasps[grasps["group"] == group]) for group in ("best", "held"))
        said = re.search(FINDING.format(hand=hand), page)
        assert said
        count, *numbers = said.groups()
        assert (int(count), int(numbers.pop(3))) == (sum(map(len, best)), sum(map(len, held)))
        means = [np.mean([scene.mean() for scene in group]) for group in (best, held)]
        drawn = grasps[(grasps["group"] != "best") & (grasps["fitness"] == 6)]
        values = [
            *means,
            means[0] - means[1],
            *(concordance(drawn, name) for name in ("eta", "margin", "both")),
        ]
        assert numbers[::3] == [f"{value:.2f}" for value in values]
        for place, scenes in ((0, [best]), (1, [held]), (2, [best, held])):
            ends = percentiles(lambda random, scenes=scenes: again(random, scenes))
            low, high = map(float, numbers[3 * place + 1 : 3 * place + 3])
            assert near(low, ends[0], high - low + 0.02)
            assert near(high, ends[1], high - low + 0.02)


def again(random: np.random.Generator, groups: list[list[Values]]) -> float:
    """The mean over scenes of resampled grasps, of a group, or of the first less the second."""
    means = [np.mean([random.choice(scene, len(scene)).mean() for scene in group]) for group in groups]
    return means[0] if len(means) == 1 else means[0] - means[1]


def chao2(reached: NDArray[np.bool_]) -> tuple[int, float]:
    """The cells that some of the runs found, and the estimated number of all, of (runs, cells)."""
    times, n = reached.sum(axis=0), len(reached)
    seen, once, twice = (int(np.sum(chosen)) for chosen in (times > 0, times == 1, times == 2))
    return seen, seen + (n - 1) / n * once**2 / (2 * twice)


def test_reference_sets_are_those_of_the_files_beside_the_table() -> None:
    section, folder = part("Reference sets of our own"), RESULTS / "reference-sets"
    sizes, shares = lines_with(section, "cells that hold"), lines_with(section, "complete, %")
    listed = pandas.read_csv(folder / "runs.csv", keep_default_na=False)
    assert len(sizes) == len(shares) == len([*folder.glob("*.npz")]) > 0
    for line, covered in zip(sizes, shares, strict=True):
        name = f"{line['hand']}-{line['object']}-{line['protocol'].replace(' ', '-')}"
        with np.load(folder / f"{name}.npz") as file:
            (key,) = (key.removesuffix(".cm") for key in file if key.endswith(".cm"))
            best, names = file[f"{key}.by_run"], [str(run) for run in file[f"{key}.runs"]]
        assert line["runs"] == str(len(names))
        holding = best == 3  # 1 + the greatest fitness of a set
        (seen, total), (held, of_held) = chao2(best > 0), chao2(holding)
        assert (line["cells"], line["cells that hold"]) == (str(seen), str(held))
        assert line["estimated cells"].startswith(f"{total:.0f} (")
        assert line["estimated to hold"].startswith(f"{of_held:.0f} (")
        counted, all_of_it = (
            (holding, of_held) if line["protocol"].startswith("physical") else (best > 0, total)
        )
        assert covered["complete, %"] == f"{100 * counted.any(axis=0).sum() / all_of_it:.0f}"
        mine = listed[(listed["run"].isin(names)) & (listed["object"] == line["object"])]
        assert sorted(mine["run"]) == sorted(names)
        found: dict[str, list[float]] = {}
        for method, settings, run in zip(mine["method"], mine["settings"], mine["run"], strict=True):
            its_own = counted[names.index(run)]
            others = np.delete(counted, names.index(run), axis=0).any(axis=0)
            found.setdefault(words_of(method, settings), []).append(100 * its_own[others].mean())
        assert {name: spread(np.array(values), 1) for name, values in found.items()} == {
            name: cell.strip("*") for name, cell in list(covered.items())[4:] if cell
        }
        assert next(name for name, cell in covered.items() if "**" in cell) == max(
            found, key=lambda name: np.median(found[name])
        )
