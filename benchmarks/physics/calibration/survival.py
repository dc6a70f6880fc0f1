"""Survival under disturbances, and how well it is predicted, with bootstrap intervals.

Grasps are compared within a scene alone, a hand and an object: survival differs more between objects than
between the grasps of one. Intervals are percentiles over grasps, of fixed scenes. Those of
report/bootstrap.py divide each draw by its own standard error, which is 0 in many draws of shares of which
most are 1.
"""

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from benchmarks.physics.calibration.study import SCENES, SEEN, UNSEEN, Disturbance
from benchmarks.physics.calibration.table import GraspRow, Group
from numpy.typing import NDArray

from qdgrasp_tools.report.bootstrap import CONFIDENCE_LEVEL, RESAMPLES, RESAMPLING_SEED

Floats = NDArray[np.float64]
Rows = Sequence[GraspRow]
Scene = tuple[str, str]
"""A hand and an object."""
TAILS = ((1 - CONFIDENCE_LEVEL) / 2, (1 + CONFIDENCE_LEVEL) / 2)
ETA_EDGES = (0.0, 0.5, 0.8, 0.95, 1.0)
"""Edges of the bins of eta: each is without its upper edge, except the last."""
THIRDS = ("lowest third", "middle third", "highest third")
PREDICTORS: dict[str, Callable[[GraspRow], float]] = {
    "eta": lambda row: row.eta,
    "margin": lambda row: row.margin,
    "both engines": lambda row: float(row.holds_in_both),
    "both engines, then eta": lambda row: row.holds_in_both + row.eta / 2,
    "pushes in MuJoCo": lambda row: float(row.fitness),
    "little penetration": lambda row: -row.penetration_mm,
    "little motion": lambda row: -row.motion_mm,
}
"""Figures that are known of a grasp before it is disturbed; a greater one promises more."""


class Interval(NamedTuple):
    """A number with its bootstrap interval; NaN: there is none."""

    value: float
    low: float
    high: float

    @property
    def words(self) -> str:
        """To two decimals; empty without a number."""
        if np.isnan(self.value):
            return ""
        return f"{self.value:.2f} ({self.low:.2f} to {self.high:.2f})"


UNKNOWN = Interval(np.nan, np.nan, np.nan)


def by_scene(rows: Rows) -> dict[Scene, list[GraspRow]]:
    """Rows by hand and object, those of the study first and in its order."""
    found: dict[Scene, list[GraspRow]] = {scene: [] for scene in SCENES}
    for row in rows:
        found.setdefault((row.gripper, row.object), []).append(row)
    return {scene: some for scene, some in found.items() if some}


def by_hand(rows: Rows) -> dict[str, list[GraspRow]]:
    """Rows by hand, in the order of `by_scene`."""
    found: dict[str, list[GraspRow]] = {}
    for (hand, _), some in by_scene(rows).items():
        found.setdefault(hand, []).extend(some)
    return found


def drawn(rows: Rows) -> list[GraspRow]:
    """The rows of grasps that were drawn at random."""
    return of_group(rows, "held", "success")


def of_group(rows: Rows, *groups: Group) -> list[GraspRow]:
    """The rows of some groups."""
    return [row for row in rows if row.group in groups]


def survival(rows: Rows, disturbances: Sequence[Disturbance] = UNSEEN) -> Floats:
    """The share (n,) of disturbances through which each grasp was held."""
    shares = [[getattr(row, each.name) for each in disturbances] for row in rows]
    means: Floats = np.array(shares, dtype=np.float64).reshape(len(rows), len(disturbances)).mean(axis=1)
    return means


def mean_interval(scenes: Sequence[Floats]) -> Interval:
    """The mean over scenes of the means over their grasps; scenes without one are left out."""
    return _interval([(values,) for values in scenes if len(values)], lambda first: first)


def difference_interval(pairs: Sequence[tuple[Floats, Floats]]) -> Interval:
    """The mean over scenes of the mean of the first group less that of the second."""
    some = [pair for pair in pairs if all(map(len, pair))]
    return _interval(some, lambda first, second: first - second)


def _interval(scenes: Sequence[tuple[Floats, ...]], of: Callable[..., Floats]) -> Interval:
    if not scenes:
        return UNKNOWN
    random = np.random.default_rng(RESAMPLING_SEED)
    value = np.mean([of(*(group.mean() for group in groups)) for groups in scenes])
    again = [of(*(_resampled_means(group, random) for group in groups)) for groups in scenes]
    low, high = np.quantile(np.mean(again, axis=0), TAILS)
    return Interval(float(value), float(low), float(high))


def _resampled_means(values: Floats, random: np.random.Generator) -> Floats:
    means: Floats = values[random.integers(len(values), size=(RESAMPLES, len(values)))].mean(axis=1)
    return means


def concordance(scenes: Sequence[tuple[Floats, Floats]]) -> Interval:
    """How often the grasp with the greater predictor survives more: (n,), (n,) in each scene.

    Counted are the pairs of grasps of one scene that survive unequally, over all scenes; equal predictors
    count half. Where survival is 0 or 1 it is the area under the ROC curve; 0.5 is chance.
    """
    random = np.random.default_rng(RESAMPLING_SEED)
    right, pairs = np.zeros(RESAMPLES + 1), np.zeros(RESAMPLES + 1)
    for predictor, survived in scenes:
        n = len(predictor)
        if not n:
            continue
        more = (survived[:, None] > survived[None]).astype(np.float64)
        ahead = np.sign(predictor[:, None] - predictor[None]) / 2 + 0.5
        times = random.multinomial(n, np.full(n, 1 / n), size=RESAMPLES)  # that each grasp is resampled
        weights = np.vstack([np.ones(n), times])
        right += ((weights @ (more * ahead)) * weights).sum(axis=1)
        pairs += ((weights @ more) * weights).sum(axis=1)
    if not pairs[0]:
        return UNKNOWN
    shares = right[1:][pairs[1:] > 0] / pairs[1:][pairs[1:] > 0]
    return Interval(float(right[0] / pairs[0]), *map(float, np.quantile(shares, TAILS)))


def predicted(rows: Rows, predictor: str, disturbances: Sequence[Disturbance] = UNSEEN) -> Interval:
    """The concordance of a predictor with survival, within scenes."""
    of = PREDICTORS[predictor]
    return concordance(
        [
            (np.array([of(row) for row in some]), survival(some, disturbances))
            for some in by_scene(rows).values()
        ]
    )


class Bin(NamedTuple):
    """Grasps with about the same value of a predictor."""

    name: str
    rows: list[GraspRow]

    @property
    def eta(self) -> float:
        """Their mean eta."""
        return float(np.mean([row.eta for row in self.rows]))

    @property
    def unseen(self) -> Interval:
        """Their survival of disturbances that the ranking does not know."""
        return mean_interval([survival(self.rows)])

    @property
    def seen(self) -> Interval:
        """Their survival of disturbances of the ranking's kind."""
        return mean_interval([survival(self.rows, SEEN)])


def eta_bins(rows: Rows) -> list[Bin]:
    """The grasps in each bin of eta that has some."""
    edges = ETA_EDGES[1:-1]
    places = np.digitize([row.eta for row in rows], edges)
    names = [f"{low:g} to {high:g}" for low, high in pairwise(ETA_EDGES)]
    found = [
        Bin(name, [row for row, at in zip(rows, places, strict=True) if at == i])
        for i, name in enumerate(names)
    ]
    return [each for each in found if each.rows]


def margin_bins(rows: Rows) -> list[Bin]:
    """The thirds of the grasps of each scene by margin, over all scenes."""
    thirds: list[list[GraspRow]] = [[], [], []]
    for some in by_scene(rows).values():
        order = np.argsort([row.margin for row in some], kind="stable").tolist()
        for third, places in zip(thirds, np.array_split(order, len(thirds)), strict=True):
            third += [some[place] for place in places]
    return [Bin(name, third) for name, third in zip(THIRDS, thirds, strict=True) if third]


def engine_bins(rows: Rows) -> list[Bin]:
    """The grasps that hold in both engines, in MuJoCo alone, in Bullet alone, and in neither."""
    names = {(True, True): "both", (True, False): "MuJoCo alone", (False, True): "Bullet alone"}
    found: dict[str, list[GraspRow]] = {name: [] for name in (*names.values(), "neither")}
    for row in rows:
        found[names.get((row.holds, row.bullet == 1.0), "neither")].append(row)
    return [Bin(name, some) for name, some in found.items() if some]
