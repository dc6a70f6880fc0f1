"""What a run is and has found: the figures that `info` prints, counted from its journal."""

import msgspec
from msgspec import Struct

from qdgrasp_coordinator.folder import RunFolder
from qdgrasp_coordinator.pipeline import BARREN
from qdgrasp_coordinator.tally import Tally, counted
from qdgrasp_protocol.rows import Rows
from qdgrasp_protocol.spec import RunSpec


class Summary(Struct, frozen=True, kw_only=True):
    """The figures of a run."""

    gripper: str
    object: str
    method: str
    protocol: str
    seed: int
    overlaps_mode: str
    """Whether overlaps count as evaluations."""
    evaluations: int
    """Counted evaluations so far."""
    budget: int
    rows: int
    """Rows in the journal, overlaps included."""
    proposals: int
    """Poses that decoding screened."""
    overlaps: int
    dead_ends: int
    successes: int
    """A finger touches the object after closing."""
    grasps: int
    """Fitness 1 or more."""
    robust: int
    """Fitness 2."""
    cells: int
    """Distinct 1 cm cells with a success."""
    errors: int
    cpu_seconds: float
    wall_seconds: float
    complete: bool
    ended: str
    """Why the run ended, in words; empty while it has not."""
    collision_source: str
    """Where the object's convex parts came from."""
    scene: str
    """sha256 of the scene bundle."""
    platform: dict[str, str]

    @property
    def words(self) -> str:
        """One sentence for a person."""
        return (
            f"{self.evaluations} evaluations of {self.method} with {self.gripper} on {self.object}: "
            f"{self.successes} successes in {self.cells} cells, {self.grasps} grasps, {self.robust} robust."
        )

    @property
    def table(self) -> str:
        """All figures, one to a line."""
        values = msgspec.structs.asdict(self)
        platform = values.pop("platform")
        lines = [f"{name.replace('_', ' '):<16} {_text(value)}" for name, value in values.items()]
        lines += [f"{'platform':<16} {name} {value[:24]}" for name, value in sorted(platform.items())]
        return "\n".join(lines)


def summary(folder: RunFolder) -> Summary:
    """Count what is in a run's folder, also while the run goes on."""
    spec = folder.spec
    with folder.journal() as journal:
        tally, end = Tally(spec.overlaps), End(spec)
        for rows in journal.blocks():
            tally.add(rows)
            end.add(rows)
        ended = end.reason(tally)
        return Summary(
            gripper=spec.gripper,
            object=spec.object,
            method=spec.method,
            protocol=spec.protocol,
            seed=spec.seed,
            overlaps_mode=spec.overlaps,
            evaluations=tally.evaluations,
            budget=spec.evaluations,
            rows=tally.rows,
            proposals=tally.proposals,
            overlaps=tally.overlaps,
            dead_ends=tally.dead_ends,
            successes=tally.successes,
            grasps=tally.grasps,
            robust=tally.robust,
            cells=tally.cells,
            errors=tally.errors,
            cpu_seconds=journal.cpu_seconds,
            wall_seconds=journal.wall_seconds,
            complete=bool(ended),
            ended=ended,
            collision_source=folder.scene().object.collision_source,
            scene=journal.scene,
            platform=journal.platform,
        )


class End:
    """Whether a journal is that of a run that has ended: its budget is spent, or it counted nothing for long."""

    def __init__(self, spec: RunSpec) -> None:
        self._spec = spec
        self._generations = 0
        """Complete generations in the journal."""
        self._counted = 0
        """Generations up to the last that counted something."""

    def add(self, rows: Rows) -> None:
        """Hear the next rows."""
        if not len(rows):
            return
        last = rows[-1]
        is_whole = int(last["index"]) == self._spec.population - 1
        self._generations = int(last["generation"]) + is_whole
        numbers = rows["generation"][counted(rows, self._spec.overlaps)]
        if len(numbers):
            self._counted = int(numbers.max()) + 1

    def reason(self, tally: Tally) -> str:
        """Why the run has ended, in words; empty while it has not."""
        if tally.evaluations >= self._spec.evaluations:
            return f"the budget of {self._spec.evaluations} evaluations is spent"
        if self._generations - self._counted >= BARREN:
            return f"the last {BARREN} generations counted no evaluation"
        return ""


def _text(value: object) -> str:
    return f"{value:.1f}" if isinstance(value, float) else str(value)
