"""The entry of a run: what it is, and what its rows add up to, for whoever lists runs."""

from msgspec import Struct, structs

from qdgrasp_coordinator.counts.curve import Curve
from qdgrasp_coordinator.counts.tally import Tally
from qdgrasp_coordinator.counts.totals import Totals, totals
from qdgrasp_protocol.spec import RunSpec

PAGE = 256
"""The most entries in one answer."""


class RunEntry(Totals, frozen=True, kw_only=True):
    """What a run is, and what its rows add up to: of one in progress, or of one in a job's folder."""

    run: str
    """Its name in its job."""
    gripper: str
    """As the spec names it: built in, or a file."""
    object: str
    """As the spec names it: built in, on the asset path, or a file."""
    method: str
    """The search with its prior."""
    protocol: str
    """The evaluation protocol."""
    seed: int
    """Of the search."""
    scene: str
    """sha256 of the scene bundle."""
    budget: int
    """Counted evaluations after which it is over."""
    rows: int
    """Journal rows: genomes and trials."""
    outcomes: dict[str, int]
    """Genomes by how their nominal evaluation ended: each `Outcome` by its name in lower case."""
    finished: str = ""
    """Why the run is over, in words; empty while it is not."""
    folder: str = ""
    """Its folder on the recorder's machine, absolute; empty where a coordinator tells of it."""

    @classmethod
    def of(cls, run: str, spec: RunSpec, scene: str, found: Tally) -> "RunEntry":
        """That of a run by its name, spec, scene and the tally of its rows."""
        return RunEntry(
            **structs.asdict(totals(found)),
            run=run,
            gripper=spec.gripper,
            object=spec.object,
            method=spec.method,
            protocol=spec.protocol,
            seed=spec.seed,
            scene=scene,
            budget=found.budget,
            rows=found.rows,
            outcomes=found.outcomes,
            finished=found.finished or "",
        )


class RunEntries(Struct, frozen=True, kw_only=True):
    """Runs in a job's folder, also finished ones, by name. JSON, the answer to a query on `rec/runs`."""

    runs: list[RunEntry]
    """Those whose rows are counted."""
    next: int = 0
    """Ask with `from=<next>` for the runs behind these; 0: there are none."""
    uncounted: int = 0
    """Runs left out because their rows are still being counted: ask again in a while."""
    host: str = ""
    """The recorder's machine."""
    curve: Curve | None = None
    """How the one run grew that was asked for; None where all were, or where its rows are not all there."""
