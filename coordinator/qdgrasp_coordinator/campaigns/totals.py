"""Totals: what the tallies of runs come to, added up."""

from dataclasses import dataclass, fields

from qdgrasp_coordinator.campaigns.summary import Summary
from qdgrasp_coordinator.counts.tally import Tally


@dataclass(frozen=True)
class Totals:
    """Sums over runs; see `Tally` for what each counts."""

    evaluations: int = 0
    """Counted evaluations."""
    simulated: int = 0
    proposals: int = 0
    overlaps: int = 0
    dead_ends: int = 0
    successes: int = 0
    grasps: int = 0
    robust: int = 0
    errors: int = 0
    cells: int = 0
    """Distinct 1 cm cells with a success, summed over runs."""
    trials: int = 0

    @classmethod
    def of(cls, found: Tally) -> "Totals":
        """Those of one run."""
        return cls(**{field.name: getattr(found, field.name) for field in fields(cls)})

    @classmethod
    def told(cls, found: Summary) -> "Totals":
        """Those of one run whose rows are not all there any more."""
        return cls(**{field.name: getattr(found, field.name) for field in fields(cls)})

    def __add__(self, other: "Totals") -> "Totals":
        sums = {field.name: getattr(self, field.name) + getattr(other, field.name) for field in fields(self)}
        return Totals(**sums)


NOTHING = Totals()
