"""Claims of Huber et al. 2024, section V, held against runs, with bootstrap intervals.

Means and ratios are resampled over scenes and over the runs on each scene: a hierarchical bootstrap with
percentile intervals (Efron and Tibshirani 1993, chapters 8 and 13). With one scene they speak of that scene
alone, and with few runs they are too narrow: of two runs, the interval of the mean reaches from one to the
other.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import product

import numpy as np
from numpy.typing import NDArray

from qdgrasp_coordinator.report.run_groups import RunGroup, SceneName, default_groups, measure_of

RESAMPLES = 5000
CONFIDENCE_LEVEL = 0.95
RESAMPLING_SEED = 0
RunValues = NDArray[np.float64]
ScenesOfRuns = Sequence[RunValues]  # For each scene the values of its runs (n,)


@dataclass(frozen=True)
class ConfidenceInterval:
    """A number with its bootstrap interval."""

    value: float
    low: float
    """NaN, as `high`, where a single run on a single scene, or nothing, is there to draw from."""
    high: float
    scenes: int
    runs: tuple[int, ...]
    """Of each arm, over all scenes."""

    @property
    def is_known(self) -> bool:
        """True if there is an interval at all."""
        return not np.isnan(self.low)


def mean_interval(values: ScenesOfRuns, seed: int = RESAMPLING_SEED) -> ConfidenceInterval:
    """Mean over scenes of the means over runs; scenes without a run are left out."""
    some = [found for found in values if len(found)]
    return _interval([(found,) for found in some], lambda arms: arms[..., 0].mean(axis=-1), 1, seed)


def ratio_interval(
    upper: ScenesOfRuns, lower: ScenesOfRuns, seed: int = RESAMPLING_SEED
) -> ConfidenceInterval:
    """Ratio of two arms, their means in each scene scaled to a mean of 1 over both.

    So each scene weighs the same, however large its numbers are, and exchanging the arms gives the
    reciprocal. Scenes where an arm has no run, or where both found nothing, are left out. Infinite where the
    lower arm found nothing.
    """
    some = [
        (a, b) for a, b in zip(upper, lower, strict=True) if len(a) and len(b) and a.mean() + b.mean() > 0
    ]
    scaled = [tuple(2 * arm / (a.mean() + b.mean()) for arm in (a, b)) for a, b in some]

    def quotient(arms: RunValues) -> RunValues:
        above, below = np.moveaxis(arms.sum(axis=-2), -1, 0)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where((above == 0) & (below == 0), 1.0, above / below)

    return _interval(scaled, quotient, 2, seed)


def _interval(
    scenes: Sequence[tuple[RunValues, ...]], statistic: Callable[[RunValues], RunValues], arms: int, seed: int
) -> ConfidenceInterval:
    runs = tuple(sum(len(scene[arm]) for scene in scenes) for arm in range(arms))
    if not scenes:
        return ConfidenceInterval(np.nan, np.nan, np.nan, 0, runs)
    means = np.array([[arm.mean() for arm in scene] for scene in scenes])
    value = float(statistic(means))
    if len(scenes) == 1 and min(runs) < 2:
        return ConfidenceInterval(value, np.nan, np.nan, 1, runs)
    tail = (1 - CONFIDENCE_LEVEL) / 2
    drawn = statistic(resample(scenes, RESAMPLES, np.random.default_rng(seed)))
    low, high = np.quantile(drawn, (tail, 1 - tail), method="inverted_cdf")  # of infinite ones too
    return ConfidenceInterval(value, float(low), float(high), len(scenes), runs)


def resample(
    scenes: Sequence[tuple[RunValues, ...]], resamples: int, random: np.random.Generator
) -> RunValues:
    """Draw scenes, and runs in each: means of each arm (resamples, scenes, arms)."""
    chosen = random.integers(len(scenes), size=(resamples, len(scenes)))
    means = np.empty((*chosen.shape, len(scenes[0])))
    for number, scene in enumerate(scenes):
        places = chosen == number
        for arm, values in enumerate(scene):
            drawn = random.integers(len(values), size=(int(places.sum()), len(values)))
            means[..., arm][places] = values[drawn].mean(axis=1)
    return means


FEW_RUNS = 5  # With fewer runs than this in an arm, a bootstrap interval is narrower than it should be
GroupsByScene = dict[SceneName, dict[str, RunGroup]]  # On each scene, the entry of each method


@dataclass(frozen=True)
class ClaimEvidence:
    """One number that a claim is held against."""

    subject: str
    """The methods, such as `contact_me_scs / contact_rand`."""
    statistic: str
    interval: ConfidenceInterval
    evaluations: tuple[int, ...]
    """Counted evaluations after which it is taken, on each scene."""

    @property
    def has_few_runs(self) -> bool:
        """True if so few runs are behind it that its interval is too narrow."""
        return min(self.interval.runs, default=0) < FEW_RUNS


def groups_by_scene(groups: Sequence[RunGroup]) -> GroupsByScene:
    """Choose the groups with any row that evidence is made of, the most usual variant of each."""
    return default_groups(group for group in groups if group.finished_runs)


def reached_ratio(scenes: GroupsByScene, *methods: str) -> ClaimEvidence | None:
    """Compare what two methods reached after as many evaluations; None: no scene has both."""
    upper, lower = list[RunValues](), list[RunValues]()
    after, measures = list[int](), list[str]()
    for pair in _groups_of(scenes, methods):
        measure = measure_of(pair)
        measures.append(measure.name)
        after.append(min(run.evaluations for group in pair for run in group.finished_runs))
        for arm, group in zip((upper, lower), pair, strict=True):
            arm.append(np.array([measure.values(run, after[-1]) for run in group.finished_runs]))
    if not after:
        return None
    statistic = f"ratio of {' and of '.join(dict.fromkeys(measures))}"
    return ClaimEvidence(" / ".join(methods), statistic, ratio_interval(upper, lower), tuple(after))


def late_share(scenes: GroupsByScene, method: str) -> ClaimEvidence | None:
    """Share of what a method reached that the second half of its evaluations added."""
    return _mean_evidence(
        scenes,
        method,
        "share added by the second half",
        lambda groups: mean_interval([*map(_late_shares, groups)]),
    )


def _late_shares(group: RunGroup) -> RunValues:
    values, runs = measure_of([group]).values, group.finished_runs
    ends, halves = (np.array([values(run, run.evaluations // part) for run in runs]) for part in (1, 2))
    return np.asarray(1 - halves[ends > 0] / ends[ends > 0])


def near_nu_share(scenes: GroupsByScene, method: str) -> ClaimEvidence | None:
    """Share of a method's successes with nu below pi / 4."""
    return _mean_evidence(scenes, method, "share of successes with nu < pi/4", near_nu_interval)


def near_nu_interval(groups: Sequence[RunGroup]) -> ConfidenceInterval:
    """Share of successes with nu below pi / 4: mean over scenes of the mean over runs."""
    shares = [
        [run.near_share for run in group.finished_runs if run.near_share is not None] for group in groups
    ]
    return mean_interval([np.array(found, dtype=np.float64) for found in shares])


def _mean_evidence(
    scenes: GroupsByScene,
    method: str,
    statistic: str,
    interval: Callable[[Sequence[RunGroup]], ConfidenceInterval],
) -> ClaimEvidence | None:
    """Take a statistic of one method over the scenes that have it; None: no scene has."""
    groups = [group for (group,) in _groups_of(scenes, (method,))]
    after = tuple(min(run.evaluations for run in group.finished_runs) for group in groups)
    return ClaimEvidence(method, statistic, interval(groups), after) if groups else None


def _groups_of(scenes: GroupsByScene, methods: tuple[str, ...]) -> Iterator[tuple[RunGroup, ...]]:
    for groups in scenes.values():
        if all(method in groups for method in methods):
            yield tuple(groups[method] for method in methods)


CLOSE_RATIO = 1.25  # Two methods are close when neither reaches this many times what the other does
FAR_RATIO = 0.5  # A method lags far behind when it reaches less than this share of what the other does
PLATEAU_SHARE = 0.1
"""A method plateaus when the second half of its evaluations adds less than this share."""
MAJORITY_SHARE = 0.5  # Successes concentrate where more than this share of them is


class ClaimAgreement(Enum):
    """Agreement of the runs with a claim."""

    AGREES = "agrees"
    DOES_NOT = "does not"
    UNKNOWN = "cannot be said"
    ABSENT = "not in this campaign"


@dataclass(frozen=True)
class AgreementBand:
    """The values that agree with a claim, finite ends excluded."""

    low: float
    high: float

    def verdict(self, found: ConfidenceInterval) -> ClaimAgreement:
        """Judge whether the whole interval is in the band, outside of it, or neither."""
        if not found.is_known:
            return ClaimAgreement.UNKNOWN
        if found.low > self.low and (found.high < self.high or math.isinf(self.high)):
            return ClaimAgreement.AGREES
        outside = found.high <= self.low or found.low >= self.high
        return ClaimAgreement.DOES_NOT if outside else ClaimAgreement.UNKNOWN


@dataclass(frozen=True)
class PaperClaim:
    """A claim of the paper, and the way it is held against runs."""

    letter: str
    words: str
    measure: Callable[..., ClaimEvidence | None]
    methods: tuple[tuple[str, ...], ...]
    """Arguments of `measure` after the scenes, for each number."""
    band: AgreementBand
    criterion: str
    """Meaning of the band."""
    beside: tuple[tuple[str, ...], ...] = ()
    """The same for other methods, to compare with; not judged."""


@dataclass(frozen=True)
class JudgedClaim:
    """A claim and its evidence."""

    claim: PaperClaim
    evidence: tuple[ClaimEvidence, ...]
    beside: tuple[ClaimEvidence, ...]

    @property
    def numbers(self) -> list[tuple[ClaimEvidence, bool]]:
        """Its numbers, those to compare with at the end; True: it is judged."""
        return [(found, True) for found in self.evidence] + [(found, False) for found in self.beside]

    @property
    def absent_count(self) -> int:
        """Numbers that lack a method in this campaign."""
        return len(self.claim.methods) - len(self.evidence)

    @property
    def has_few_runs(self) -> bool:
        """True if one of its numbers has so few runs that its interval is too narrow."""
        return any(number.has_few_runs for number in self.evidence)

    @property
    def words(self) -> str:
        """The verdict for a person."""
        return f"{self.verdict.value}{' (of few runs)' if self.has_few_runs else ''}"

    @property
    def verdict(self) -> ClaimAgreement:
        """All numbers agree, one does not, or neither can be said."""
        verdicts = {self.claim.band.verdict(number.interval) for number in self.evidence}
        if not verdicts:
            return ClaimAgreement.ABSENT
        if ClaimAgreement.DOES_NOT in verdicts:
            return ClaimAgreement.DOES_NOT
        return ClaimAgreement.UNKNOWN if ClaimAgreement.UNKNOWN in verdicts else ClaimAgreement.AGREES


def judge_claims(groups: Sequence[RunGroup]) -> list[JudgedClaim]:
    """Hold every claim against the runs at hand."""
    scenes = groups_by_scene(groups)

    def evidence(claim: PaperClaim, methods: Sequence[tuple[str, ...]]) -> tuple[ClaimEvidence, ...]:
        return tuple(filter(None, (claim.measure(scenes, *names) for names in methods)))

    return [JudgedClaim(one, evidence(one, one.methods), evidence(one, one.beside)) for one in CLAIMS]


SEARCHES_WITH_PRIOR = ("contact_me_scs", "approach_me_scs")
RANDOM_SCHEMES = ("contact_rand", "approach_rand", "antipodal_rand")
CLAIMS = (
    PaperClaim(
        "a",
        "ME_scs with priors beats every random scheme",
        reached_ratio,
        tuple(product(SEARCHES_WITH_PRIOR, RANDOM_SCHEMES)),
        AgreementBand(1.0, math.inf),
        "every ratio above 1",
    ),
    PaperClaim(
        "b",
        "contact and approach variants of ME_scs end close together",
        reached_ratio,
        (SEARCHES_WITH_PRIOR,),
        AgreementBand(1 / CLOSE_RATIO, CLOSE_RATIO),
        f"ratio between {1 / CLOSE_RATIO:g} and {CLOSE_RATIO:g}",
    ),
    PaperClaim(
        "c",
        "antipodal plateaus",
        late_share,
        (("antipodal_rand",), ("antipodal_me_scs",)),
        AgreementBand(-math.inf, PLATEAU_SHARE),
        f"the second half of the evaluations adds less than {PLATEAU_SHARE:.0%} of the end",
        (("contact_me_scs",), ("approach_me_scs",)),
    ),
    PaperClaim(
        "d",
        "nu of contact_me_scs concentrates below pi/4",
        near_nu_share,
        (("contact_me_scs",),),
        AgreementBand(MAJORITY_SHARE, math.inf),
        "more than half of the successes",
        (("contact_me_rand",), ("contact_rand",)),
    ),
    PaperClaim(
        "e",
        "plain me_scs lags far behind",
        reached_ratio,
        (("me_scs", "contact_me_scs"), ("me_scs", "approach_me_scs")),
        AgreementBand(-math.inf, FAR_RATIO),
        f"every ratio below {FAR_RATIO:g}",
    ),
)
