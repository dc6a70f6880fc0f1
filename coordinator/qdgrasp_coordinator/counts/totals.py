"""Totals: what the rows of runs add up to, whoever shows it of one run or of many."""

from typing import Annotated

from msgspec import Meta, Struct

from qdgrasp_coordinator.counts.tally import Tally
from qdgrasp_protocol.phrases import counted


class Totals(Struct, frozen=True, kw_only=True):
    """What counts of a run add up to its job's, and the first part of whatever shows them."""

    evaluations: Annotated[int, Meta(description="Counted evaluations.")]
    simulated: Annotated[int, Meta(description="Genomes whose hand closed.")]
    proposals: Annotated[int, Meta(description="Poses that decoding screened, simulated or not.")]
    overlaps: Annotated[
        int,
        Meta(
            description="Genomes whose open hand overlapped the object; "
            "where a genome has candidates, all of them."
        ),
    ]
    dead_ends: Annotated[
        int, Meta(description="Genomes for which there was no pose, or none worth a simulation.")
    ]
    successes: Annotated[int, Meta(description="A finger touches the object after closing.")]
    grasps: Annotated[int, Meta(description="Successes that survived a shake: fitness 1 or more.")]
    robust: Annotated[int, Meta(description="Successes that survived both shakes: fitness 2.")]
    errors: Annotated[
        int, Meta(description="Rows on which the simulator failed three times, trials included.")
    ]
    cells: Annotated[
        int, Meta(description="Distinct 1 cm cells with a success; of a job their sum over its runs.")
    ]
    trials: Annotated[
        int, Meta(description="Rows that are trials of successes; 0 where no protocol has them.")
    ]

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
