"""The end of a run that has begun: it may be put off, not taken back below what is recorded."""

from qdgrasp_coordinator.counts.counting import tally
from qdgrasp_coordinator.counts.tally import Tally
from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_coordinator.searches.search import check
from qdgrasp_protocol.spec import RunSpec, run_spec, to_values


def extend(folder: RunFolder, **goals: int) -> None:
    """Give a run a new budget, or other goals: any of the keys `spec.GOALS`.

    Raises
    ------
    ImpossibleValue
        It is none, or the journal is not a beginning of that with it.
    """
    spec = run_spec(to_values(folder.spec) | goals, "resume")
    tally_within(folder, spec, "--evaluations")
    folder.rewrite_spec(spec)


def tally_within(folder: RunFolder, spec: RunSpec, where: str = "evaluations") -> Tally:
    """What the journal of a run adds up to under a budget, whose journal it must be a beginning of.

    Raises
    ------
    ImpossibleValue
        It is not.
    """
    check(spec)
    with folder.journal() as journal:
        found = tally(spec, journal.blocks())
    found.check_budget(spec, where)
    return found
