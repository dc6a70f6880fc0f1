"""The figures of the calibration study's page, recomputed from its table by other means."""

import re
from collections.abc import Callable

import numpy as np
import pandas
import pytest
from tests.docs.test_published_numbers import DRAWS, RESULTS, Runs, Values, near

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
