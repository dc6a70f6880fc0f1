"""Success models: logistic regression, candidate ranking, and the threshold to simulate.

Screening candidates costs less than simulating one, so that it pays to draw more of them and to refuse many;
the limit is a share of genomes that are simulated. A cell that gave no candidate is asked again, with a lower
threshold each time.
"""

from collections.abc import Sequence

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from qdgrasp_assets.genes import STEEPEST_VALUE, VALUE_FEATURES
from qdgrasp_assets.geometry.rotation import Floats
from qdgrasp_protocol.errors import ImpossibleValue
from qdgrasp_protocol.spec import FirstWeights, RunSpec, Weights

EXAMPLES_KEPT = 2048  # Number of the last examples, which a fit uses
FIT_INTERVAL = 256  # Examples between two fits
LEAST_EXAMPLES = 10  # Least number of successes, and of failures, among the examples of a fit
NEWTON_STEPS = 5
RIDGE = 1.0
"""Precision of the weights' prior, N(mean, 1 / RIDGE), features in their units.

It keeps a fit finite where features separate successes from failures.
"""
LEAST_VARIANCE = 1e-9  # The variance below which a feature is taken for constant
WEIGHT_GRAIN = 64
"""Weights are whole multiples of 1 / GRAIN.

So the last bits of a fit, which differ between processors, do not change the genomes.
"""


class LogisticRegression:
    """Probability of success, or mean of a quality from 0 to 1, given features.

    The last feature is constant.

    `start` (features,) are the weights until the first fit, and the mean of their prior in all fits; there is
    one after every `interval` examples (None: `FIT_INTERVAL`). With `own_units` the unit of each feature is
    its standard deviation, instead of 1: small features then count as much as large ones.
    """

    def __init__(self, start: ArrayLike, *, own_units: bool = False, interval: int | None = None) -> None:
        self._start = _quantised(np.asarray(start, np.float64))
        self.weights: Floats = self._start  # One weight for each feature, a multiple of 1 / `WEIGHT_GRAIN`
        self.own_units = own_units
        self._interval = interval or FIT_INTERVAL
        self._features = np.zeros((EXAMPLES_KEPT, len(self._start)))
        self._successes = np.zeros(EXAMPLES_KEPT)
        self._seen = 0
        self._fitted = 0

    def learn(self, features: Floats, successes: Floats | NDArray[np.bool_]) -> None:
        """Learn from examples: features (n, k) and successes (n,), True and False or 0 to 1."""
        features, successes = features[-EXAMPLES_KEPT:], successes[-EXAMPLES_KEPT:]
        places = (self._seen + np.arange(len(features))) % EXAMPLES_KEPT
        self._features[places], self._successes[places] = features, successes
        self._seen += len(features)
        known = min(self._seen, EXAMPLES_KEPT)
        found = float(self._successes[:known].sum())
        if self._seen - self._fitted >= self._interval and min(found, known - found) >= LEAST_EXAMPLES:
            self._fitted = self._seen
            features, examples = self.examples
            precision = RIDGE * (_variances(features) if self.own_units else np.ones(len(self._start)))
            self.weights = _quantised(fit(features, examples, self._start, precision))

    @property
    def examples(self) -> tuple[Floats, Floats]:
        """The examples that a fit uses: features (n, k), and successes (n,) from 0 to 1."""
        known = min(self._seen, EXAMPLES_KEPT)
        return self._features[:known], self._successes[:known]

    def likely(self, features: Floats) -> Floats:
        """The probability (n,) of success for features (n, k)."""
        return _likely(features, self.weights)


FIRST_TOUCH_WEIGHTS = (1.0, -5.0, 3.0, 0.0, 1.0, 2.0)
"""Weights of a cell's features for P(touch) before the first fit."""
FIRST_QUALITY_WEIGHTS = (0.0, 0.0, 0.0, 3.0, -0.5, -1.0)
"""The same for the quality of a grasp that touches."""
STARTS = {
    "touch": (0.0,) * len(VALUE_FEATURES),
    "quality": (0.0,) * len(VALUE_FEATURES),
    "cell_touch": FIRST_TOUCH_WEIGHTS,
    "cell_quality": FIRST_QUALITY_WEIGHTS,
}
"""First weights of models, by their names in `FirstWeights`, where a spec has none for them."""
DOUBT_INTERVAL = 64
"""Examples between two fits of a model that begins with weights of other runs, which may mislead."""
NO_WEIGHTS = FirstWeights()


def check_first_weights(spec: RunSpec) -> None:
    """Check that the weights which a spec begins with fit the models, in whole grains."""
    for name, weights in msgspec.structs.asdict(spec.first_weights or NO_WEIGHTS).items():
        key, n = f"first_weights.{name}", len(STARTS[name])
        if weights is not None and len(weights) != n:
            raise ImpossibleValue(key, f"{len(weights)} of them", f"{n} numbers, one for each feature")
        grains = WEIGHT_GRAIN * np.asarray(weights or (), np.float64)
        if not ((np.abs(grains) <= WEIGHT_GRAIN * STEEPEST_VALUE) & (grains == np.rint(grains))).all():
            expected = f"multiples of 1/{WEIGHT_GRAIN} from {-STEEPEST_VALUE:g} to {STEEPEST_VALUE:g}"
            raise ImpossibleValue(key, weights, expected)


def first_model(name: str, first: Weights | None, *, own_units: bool = False) -> LogisticRegression:
    """Return a model that begins with weights of other runs; None: with its own in `STARTS`."""
    if first is None:
        return LogisticRegression(STARTS[name], own_units=own_units)
    return LogisticRegression(first, own_units=own_units, interval=DOUBT_INTERVAL)


def pooled_weights(models: Sequence[LogisticRegression], start: ArrayLike) -> Floats | None:
    """Return weights (k,) of one fit to the examples of several models of the same features.

    Each model has a constant of its own, so that different success rates of objects are not attributed to
    features in which they differ as well; the last weight is the mean of these. `start` (k,) is the mean of
    their prior. None: successes or failures are too few.
    """
    features, successes = (np.concatenate([model.examples[i] for model in models]) for i in range(2))
    if min(successes.sum(), len(successes) - successes.sum()) < LEAST_EXAMPLES:
        return None
    m, first = len(models), np.asarray(start, np.float64)
    constants = np.repeat(np.eye(m), [len(model.examples[1]) for model in models], axis=0)
    units = _variances(features) if models[0].own_units else np.ones(len(first))
    weights = fit(
        np.concatenate([features[:, :-1], constants], axis=1),
        successes,
        np.append(first[:-1], np.repeat(first[-1], m)),
        RIDGE * np.append(units[:-1], np.ones(m)),
    )
    return _quantised(np.append(weights[:-m], weights[-m:].mean()))


def fit(features: Floats, successes: Floats, mean: Floats, precision: Floats) -> Floats:
    """The weights (k,) of features (n, k), by Newton's method from zero.

    Mean and precision (k,) are those of their prior. Sums are einsum's own loops: no matrix library with
    threads, for so little.
    """
    weights = np.zeros(features.shape[1])
    for _ in range(NEWTON_STEPS):
        likely = _likely(features, weights)
        gradient = np.einsum("nk,n->k", features, successes - likely) - precision * (weights - mean)
        scaled = features * (likely * (1.0 - likely))[:, None]
        curvature = np.einsum("nk,nl->kl", scaled, features) + np.diag(precision)
        weights = weights + np.linalg.solve(curvature, gradient)
    return weights


def _variances(features: Floats) -> Floats:
    """Return the variances of features (n, k): (k,); 1 for constants."""
    variances = features.var(axis=0)
    return np.where(variances > LEAST_VARIANCE, variances, 1.0)


def _quantised(weights: Floats) -> Floats:
    return np.rint(weights * WEIGHT_GRAIN) / WEIGHT_GRAIN


def _likely(features: Floats, weights: Floats) -> Floats:
    likely: Floats = 1.0 / (1.0 + np.exp(-np.einsum("nk,k->n", features, weights)))
    return likely


DEAD_END_DISCOUNT = 0.5  # Reduction for each dead end: wanted / (dead ends * this + 1)
WANTED_STEP = 0.9  # Factor by which a generation changes the demand
LEAST_WANTED = 1e-3  # Least value that is demanded of a candidate


class ValueThreshold:
    """Threshold on the value of candidates, adapted to the share of genomes that pass it.

    `most` is demanded of a cell's first candidates: a probability of success, or a search's own value.
    It is lowered while less than `least_share` of the genomes are simulated.
    """

    def __init__(self, most: float, least_share: float) -> None:
        self._most = self._wanted = most
        self._least_share = least_share
        self.share = 1.0
        """The share of the last generation's genomes that passed, at least `least_share`."""

    def wanted(self, dead_ends: NDArray[np.int32]) -> Floats:
        """Return the value demanded in cells with `dead_ends` (n,)."""
        wanted: Floats = np.maximum(
            LEAST_WANTED, self._wanted / (DEAD_END_DISCOUNT * dead_ends.astype(np.float64) + 1.0)
        )
        return wanted

    def update(self, through: NDArray[np.bool_]) -> None:
        """Adapt the threshold; `through` (n,) says which genomes became evaluations."""
        is_narrow = np.count_nonzero(through) < self._least_share * len(through)
        self.share = max(self._least_share, float(through.mean()))
        wanted = self._wanted * WANTED_STEP if is_narrow else self._wanted / WANTED_STEP
        self._wanted = min(self._most, max(LEAST_WANTED, wanted))
