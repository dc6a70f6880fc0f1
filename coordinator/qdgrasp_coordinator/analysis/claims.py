"""Claims: what Huber et al. 2024, section V, say of their methods, held against the runs at hand."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import product

from qdgrasp_coordinator.analysis.bootstrap import Interval
from qdgrasp_coordinator.analysis.entries import Entry
from qdgrasp_coordinator.analysis.findings import Finding, Scenes, by_scene, late, near, reached

CLOSE = 1.25
"""Two methods are close when neither reaches this many times what the other does."""
FAR = 0.5
"""A method lags far behind when it reaches less than this share of what the other does."""
FLAT = 0.1
"""A method plateaus when the second half of its evaluations adds less than this share of its end."""
MOST = 0.5
"""Successes concentrate where more than this share of them is."""


class Agreement(Enum):
    """Whether the runs agree with a claim."""

    AGREES = "agrees"
    DOES_NOT = "does not"
    UNKNOWN = "cannot be said"
    ABSENT = "not in this campaign"


@dataclass(frozen=True)
class Band:
    """The values that agree with a claim, finite ends excluded."""

    low: float
    high: float

    def verdict(self, found: Interval) -> Agreement:
        """Whether the whole interval is in the band, outside of it, or neither."""
        if not found.is_known:
            return Agreement.UNKNOWN
        if found.low > self.low and (found.high < self.high or math.isinf(self.high)):
            return Agreement.AGREES
        outside = found.high <= self.low or found.low >= self.high
        return Agreement.DOES_NOT if outside else Agreement.UNKNOWN


@dataclass(frozen=True)
class Claim:
    """What the paper says, and how it is held against runs."""

    letter: str
    words: str
    find: Callable[..., Finding | None]
    methods: tuple[tuple[str, ...], ...]
    """What `find` is called with after the scenes, for each number."""
    band: Band
    criterion: str
    """What the band means."""
    beside: tuple[tuple[str, ...], ...] = ()
    """The same for other methods, to compare with; not judged."""


@dataclass(frozen=True)
class Judged:
    """A claim and what the runs say."""

    claim: Claim
    findings: tuple[Finding, ...]
    beside: tuple[Finding, ...]

    @property
    def absent(self) -> int:
        """How many of its numbers lack a method in this campaign."""
        return len(self.claim.methods) - len(self.findings)

    @property
    def is_of_few(self) -> bool:
        """Whether one of its numbers has so few runs behind it that its interval is too narrow."""
        return any(finding.is_of_few for finding in self.findings)

    @property
    def words(self) -> str:
        """The verdict for a person."""
        return f"{self.verdict.value}{' (of few runs)' if self.is_of_few else ''}"

    @property
    def verdict(self) -> Agreement:
        """All numbers agree, one does not, or neither can be said."""
        verdicts = {self.claim.band.verdict(finding.interval) for finding in self.findings}
        if not verdicts:
            return Agreement.ABSENT
        if Agreement.DOES_NOT in verdicts:
            return Agreement.DOES_NOT
        return Agreement.UNKNOWN if Agreement.UNKNOWN in verdicts else Agreement.AGREES


def judged(entries: Sequence[Entry]) -> list[Judged]:
    """Hold every claim against the runs at hand."""
    scenes = by_scene(entries)
    return [
        Judged(claim, _found(claim, claim.methods, scenes), _found(claim, claim.beside, scenes))
        for claim in CLAIMS
    ]


def _found(claim: Claim, methods: Sequence[tuple[str, ...]], scenes: Scenes) -> tuple[Finding, ...]:
    return tuple(filter(None, (claim.find(scenes, *names) for names in methods)))


WITH_PRIOR = ("contact_me_scs", "approach_me_scs")
RANDOM = ("contact_rand", "approach_rand", "antipodal_rand")
CLAIMS = (
    Claim(
        "a",
        "ME_scs with priors beats every random scheme",
        reached,
        tuple(product(WITH_PRIOR, RANDOM)),
        Band(1.0, math.inf),
        "every ratio above 1",
    ),
    Claim(
        "b",
        "contact and approach variants of ME_scs end close together",
        reached,
        (WITH_PRIOR,),
        Band(1 / CLOSE, CLOSE),
        f"ratio between {1 / CLOSE:g} and {CLOSE:g}",
    ),
    Claim(
        "c",
        "antipodal plateaus",
        late,
        (("antipodal_rand",), ("antipodal_me_scs",)),
        Band(-math.inf, FLAT),
        f"the second half of the evaluations adds less than {FLAT:.0%} of the end",
        (("contact_me_scs",), ("approach_me_scs",)),
    ),
    Claim(
        "d",
        "nu of contact_me_scs concentrates below pi/4",
        near,
        (("contact_me_scs",),),
        Band(MOST, math.inf),
        "more than half of the successes",
        (("contact_me_rand",), ("contact_rand",)),
    ),
    Claim(
        "e",
        "plain me_scs lags far behind",
        reached,
        (("me_scs", "contact_me_scs"), ("me_scs", "approach_me_scs")),
        Band(-math.inf, FAR),
        f"every ratio below {FAR:g}",
    ),
)
