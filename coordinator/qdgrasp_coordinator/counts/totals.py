"""Totals: what the rows of runs add up to, whoever shows it of one run or of many."""

from msgspec import Struct

from qdgrasp_coordinator.counts.tally import Tally
from qdgrasp_protocol.phrases import counted


class Totals(Struct, frozen=True, kw_only=True):
    """What counts of a run add up to its job's, and the first part of whatever shows them."""

    evaluations: int
    """Counted evaluations."""
    simulated: int
    """Genomes whose hand closed."""
    proposals: int
    """Poses that decoding screened, simulated or not."""
    overlaps: int
    """Genomes whose open hand overlapped the object; where a genome has candidates, all of them."""
    dead_ends: int
    """Genomes for which there was no pose, or none worth a simulation."""
    successes: int
    """A finger touches the object after closing."""
    grasps: int
    """Successes that survived a shake: fitness 1 or more."""
    robust: int
    """Successes that survived both shakes: fitness 2."""
    errors: int
    """Rows on which the simulator failed three times, trials included."""
    cells: int
    """Distinct 1 cm cells with a success; of a job their sum over its runs."""
    trials: int
    """Rows that are trials of successes; 0 where no protocol has them."""

    @property
    def found(self) -> str:
        """What was found, in words."""
        return f"{counted(self.successes, 'success', 'successes')} in {counted(self.cells, 'cell')}"

    @property
    def screened(self) -> str:
        """The other counting, beside evaluations, in words: how much was screened for them."""
        return (
            f"{self.simulated} simulated of {counted(self.proposals, 'proposal')}, "
            f"{counted(self.overlaps, 'overlap')}, {counted(self.dead_ends, 'dead end')}"
        )

    def __add__(self, other: "Totals") -> "Totals":
        return Totals(**{name: getattr(self, name) + getattr(other, name) for name in NAMES})


NAMES = Totals.__struct_fields__
"""Of all that is added up."""
NOTHING = Totals(**dict.fromkeys(NAMES, 0))


def totals(found: Tally | Totals) -> Totals:
    """What was counted of one run."""
    return Totals(**{name: getattr(found, name) for name in NAMES})
