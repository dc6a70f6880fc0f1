"""Claims of Huber et al. 2024, section V, held against runs, with bootstrap intervals."""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import product

import numpy as np

from qdgrasp_tools.report.bootstrap import ConfidenceInterval, RunValues, ratio_interval, share_interval
from qdgrasp_tools.report.run_groups import RunGroup, SceneName, default_groups, measure_of

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
        lambda groups: share_interval([*map(_late_shares, groups)]),
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
    return share_interval([_near_shares(group) for group in groups])


def _near_shares(group: RunGroup) -> RunValues:
    shares = [run.near_share for run in group.finished_runs if run.near_share is not None]
    return np.array(shares, dtype=np.float64)


def near_nu_ratio(scenes: GroupsByScene, *methods: str) -> ClaimEvidence | None:
    """Compare two methods' shares of nu below pi / 4; None: no scene has successes of both."""
    every = [*_groups_of(scenes, methods)]
    pairs = [pair for pair in every if all(len(_near_shares(group)) for group in pair)]
    upper, lower = ([_near_shares(pair[place]) for pair in pairs] for place in (0, 1))
    after = tuple(min(run.evaluations for group in pair for run in group.finished_runs) for pair in pairs)
    statistic = "ratio of shares of successes with nu < pi/4"
    return (
        ClaimEvidence(" / ".join(methods), statistic, ratio_interval(upper, lower), after) if pairs else None
    )


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


def agreement_of_all(verdicts: Iterable[ClaimAgreement]) -> ClaimAgreement:
    """Verdict on a claim: all its numbers agree, one does not, or neither can be said."""
    found = {*verdicts}
    if not found:
        return ClaimAgreement.ABSENT
    by_weight = (ClaimAgreement.DOES_NOT, ClaimAgreement.UNKNOWN, ClaimAgreement.AGREES)
    return next(one for one in by_weight if one in found)


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
    def verdict(self) -> ClaimAgreement:
        """Verdict on all its numbers."""
        return agreement_of_all(self.claim.band.verdict(number.interval) for number in self.evidence)


def judge_claims(groups: Sequence[RunGroup]) -> list[JudgedClaim]:
    """Hold every claim against the runs at hand."""
    scenes = groups_by_scene(groups)

    def evidence(claim: PaperClaim, methods: Sequence[tuple[str, ...]]) -> tuple[ClaimEvidence, ...]:
        return tuple(filter(None, (claim.measure(scenes, *names) for names in methods)))

    return [JudgedClaim(one, evidence(one, one.methods), evidence(one, one.beside)) for one in CLAIMS]


PRIORS, SEARCHES = ("contact", "approach", "antipodal"), ("me_scs", "me_rand", "cma_mae")
RANDOM_SCHEMES = tuple(f"{prior}_rand" for prior in PRIORS)
CONTACT_SEARCHES = tuple(f"contact_{search}" for search in SEARCHES)
OTHER_SEARCHES_WITH_PRIOR = tuple(f"{prior}_{search}" for search in SEARCHES for prior in PRIORS)[1:]
"""All but the first of `CONTACT_SEARCHES`."""
CLAIMS = (
    PaperClaim(
        "a",
        "ME_scs with the contact prior beats every random scheme (Figure 1)",
        reached_ratio,
        tuple(product(CONTACT_SEARCHES[:1], RANDOM_SCHEMES)),
        AgreementBand(1.0, math.inf),
        "every ratio above 1",
    ),
    PaperClaim(
        "b",
        "contact and approach variants of a search end close together (Figure 2)",
        reached_ratio,
        tuple((f"contact_{search}", f"approach_{search}") for search in SEARCHES),
        AgreementBand(1 / CLOSE_RATIO, CLOSE_RATIO),
        f"every ratio between {1 / CLOSE_RATIO:g} and {CLOSE_RATIO:g}",
    ),
    PaperClaim(
        "c",
        "antipodal ME_scs plateaus (Figure 2)",
        late_share,
        (("antipodal_me_scs",),),
        AgreementBand(-math.inf, PLATEAU_SHARE),
        f"the second half of the evaluations adds less than {PLATEAU_SHARE:.0%} of the end",
        (("antipodal_rand",), ("contact_me_scs",), ("approach_me_scs",)),
    ),
    PaperClaim(
        "d",
        "nu of contact variants of searches concentrates below pi/4 (Figure 3)",
        near_nu_share,
        tuple((search,) for search in CONTACT_SEARCHES),
        AgreementBand(MAJORITY_SHARE, math.inf),
        "more than half of the successes of each",
        (("contact_rand",),),
    ),
    PaperClaim(
        "e",
        "plain ME_scs lags far behind the contact variant (Figure 1)",
        reached_ratio,
        (("me_scs", "contact_me_scs"),),
        AgreementBand(-math.inf, FAR_RATIO),
        f"the ratio is below {FAR_RATIO:g}",
    ),
    PaperClaim(
        "f",
        "all other searches with a prior beat every random scheme (Figure 2)",
        reached_ratio,
        tuple(product(OTHER_SEARCHES_WITH_PRIOR, RANDOM_SCHEMES)),
        AgreementBand(1.0, math.inf),
        "every ratio above 1",
    ),
    PaperClaim(
        "g",
        "of the searches with one prior ME_scs is the best (Figure 2)",
        reached_ratio,
        tuple((f"{prior}_me_scs", f"{prior}_{other}") for prior in PRIORS for other in SEARCHES[1:]),
        AgreementBand(1.0, math.inf),
        "every ratio above 1",
    ),
    PaperClaim(
        "h",
        "searches find that concentration: random sampling with the contact prior has less (Figure 3)",
        near_nu_ratio,
        tuple(product(CONTACT_SEARCHES, RANDOM_SCHEMES[:1])),
        AgreementBand(1.0, math.inf),
        "every ratio of these shares above 1",
    ),
)
