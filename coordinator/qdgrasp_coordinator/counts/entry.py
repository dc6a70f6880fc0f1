"""The entry of a run: what it is, and what its rows add up to, for whoever lists runs."""

from msgspec import Struct

from qdgrasp_coordinator.counts.tally import Tally
from qdgrasp_protocol.spec import RunSpec

PAGE = 256
"""The most entries in one answer."""


class RunEntry(Struct, frozen=True, kw_only=True):
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
    evaluations: int
    """Counted evaluations."""
    budget: int
    """Counted evaluations after which it is over."""
    rows: int
    """Journal rows: genomes and trials."""
    trials: int
    """Journal rows that are trials of successes; 0 where the protocol has none."""
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
    """Distinct 1 cm cells with a success."""
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
            run=run,
            gripper=spec.gripper,
            object=spec.object,
            method=spec.method,
            protocol=spec.protocol,
            seed=spec.seed,
            scene=scene,
            evaluations=found.evaluations,
            budget=found.budget,
            rows=found.rows,
            trials=found.trials,
            simulated=found.simulated,
            proposals=found.proposals,
            overlaps=found.overlaps,
            dead_ends=found.dead_ends,
            successes=found.successes,
            grasps=found.grasps,
            robust=found.robust,
            errors=found.errors,
            cells=found.cells,
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
