"""Plans of runs, and the queue of a job's runs.

A plan turns a user's spec into a run that can be carried out: spec, scene, search and pipeline.
"""

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from msgspec import structs

from qdgrasp_assets.asset_paths import named_path, path_problem
from qdgrasp_assets.catalog import build_scene, check_object
from qdgrasp_assets.genes import layout
from qdgrasp_assets.geometry.collision_parts import Tell, ignore_progress
from qdgrasp_assets.object_model import check_mesh
from qdgrasp_assets.object_shape import ObjectShape, is_in_catalog
from qdgrasp_assets.scene import Bundle, Scene, pack_scene
from qdgrasp_coordinator.metrics.run_stats import NO_TOTALS, RunCounter, RunTotals
from qdgrasp_coordinator.scheduler.pipeline import Generation, Pipeline
from qdgrasp_coordinator.search.base import SearchAlgorithm, search_space
from qdgrasp_coordinator.search.fixed_poses import FixedPoseSearch, check_spec_poses
from qdgrasp_coordinator.search.registry import check_spec, method, prior_of
from qdgrasp_coordinator.storage.job_folder import RUN
from qdgrasp_coordinator.storage.journal import JournalSlice
from qdgrasp_coordinator.storage.run_folder import PreparedScene
from qdgrasp_protocol.build_messages import ShapeTask
from qdgrasp_protocol.errors import AssetError
from qdgrasp_protocol.messages import Failure, OpenRun
from qdgrasp_protocol.rows import Genomes, Rows, RowShape
from qdgrasp_protocol.spec import RunSpec, run_spec, to_toml, usual_engine

CompareRow = Callable[[int, np.void, str], None]
"""Takes a row's place among the recorded ones, the row as evaluated now, and its error."""


class ReevaluationPlan:
    """Recorded rows that are evaluated once more; no row becomes final.

    They are `recorded` in any order, by a run of a spec: (n,). Each travels under another key: generation 0,
    its place among the recorded rows as index, and its trial. `compare` is called once for each row.
    """

    def __init__(self, spec: RunSpec, recorded: Rows, compare: CompareRow) -> None:
        self.tally = RunCounter(_spec_of_all(spec, len(recorded)))
        """Rows evaluated so far; trials count as evaluations."""
        self._recorded = recorded
        self._compare = compare
        self._is_due = True
        self._is_missing = np.ones(len(recorded), dtype=bool)

    @property
    def finished(self) -> str | None:
        """Reason why it is over; None while rows are missing."""
        return None if self._is_missing.any() else "all rows were evaluated again"

    def ask(self) -> Generation | None:
        """Return all rows at the first call, then None."""
        if not self._is_due:
            return None
        self._is_due = False
        indices = np.arange(len(self._recorded), dtype=np.uint32)
        return Generation(0, indices, self._recorded["trial"], self._recorded["genome"])

    def settle(
        self, rows: Rows, cpu_seconds: float = 0.0, failures: Sequence[Failure] = (), maker: str = ""
    ) -> JournalSlice:
        """Compare evaluated rows with the recorded ones; returns no rows."""
        reasons = {failure.row: failure.reason for failure in failures}
        fresh = np.flatnonzero(self._is_missing[rows["index"]])
        self._is_missing[rows["index"]] = False
        for place in fresh.tolist():
            self._compare(int(rows["index"][place]), rows[place], reasons.get(place, ""))
        counted = rows[fresh]
        counted["trial"] = 0
        self.tally.count(counted)
        return JournalSlice(0, rows[:0])

    def replay(self, rows: Rows) -> None:
        """Do nothing: no row is recorded."""


def _spec_of_all(spec: RunSpec, rows: int) -> RunSpec:
    """Return the spec of a run that ends when so many rows were evaluated."""
    return structs.replace(spec, evaluations=rows, overlaps="count", grasps=None, saturation=None)


EvaluationPlan = Pipeline | ReevaluationPlan
"""Rows to evaluate in a run, in the order in which they count."""


@dataclass(frozen=True)
class RunPlan:
    """One run that a coordinator carries out."""

    run: str
    spec: RunSpec
    """The full spec."""
    bundle: Bundle
    prior: str
    shape: RowShape
    pipeline: EvaluationPlan

    @classmethod
    def of(
        cls,
        spec: RunSpec,
        prepared: PreparedScene,
        plan: Callable[[RowShape], EvaluationPlan],
        prior: str = "",
        run: str = RUN,
    ) -> "RunPlan":
        """Return a run of a spec; `plan` makes what it evaluates, for rows of a shape.

        The rows are of `prior`; empty: of the method's.
        """
        prior = prior or prior_of(spec)
        shape = row_shape(prepared.scene, prior)
        return cls(run, spec, prepared.bundle, prior, shape, plan(shape))

    @property
    def open_request(self) -> OpenRun:
        """Message that opens the run at a recorder."""
        spec = to_toml(self.spec).encode()
        return OpenRun(run=self.run, spec=spec, scene=self.bundle.digest, **asdict(self.shape))


@dataclass(frozen=True)
class JobExtent:
    """Size of a job, counted before its first run is opened."""

    runs: int
    evaluations: int
    """Sum of the budgets of all runs."""
    budgets: Mapping[str, int]
    """Budgets of the runs that are to be carried out, by name."""
    runs_done: int = 0
    """Runs that were finished before; they are not opened again."""
    done: RunTotals = NO_TOTALS
    """Totals of the runs that were finished before."""

    @classmethod
    def of(cls, budgets: Mapping[str, int]) -> "JobExtent":
        """Return the extent of runs with these budgets, by name, none of them finished."""
        return cls(runs=len(budgets), evaluations=sum(budgets.values()), budgets=budgets)

    def with_done(self, found: Mapping[str, RunTotals]) -> "JobExtent":
        """Return the same extent, where these runs, by name, were finished before."""
        return replace(
            self,
            budgets={run: budget for run, budget in self.budgets.items() if run not in found},
            runs_done=self.runs_done + len(found),
            done=sum(found.values(), self.done),
        )


@dataclass(frozen=True)
class WantedShape:
    """A shape that is not built yet, and the mesh that it is made of."""

    task: ShapeTask
    mesh: Path

    @property
    def paths(self) -> dict[str, Path]:
        """Its files by sha256: the mesh, and those that it names beside it."""
        mesh, *others = self.task.files
        return {mesh.sha256: self.mesh} | {file.sha256: self.mesh.parent / file.name for file in others}


@dataclass(frozen=True)
class BuildReply:
    """The end of a build: its shape, or the reason why it cannot be built."""

    key: str
    """The task's."""
    pieces: tuple[bytes, ...] = ()
    """The deflated shape; empty if it cannot be built."""
    reason: str = ""
    cpu_seconds: float = 0.0


class ShapeWarning(NamedTuple):
    """A fault of a shape that is used all the same, or was left aside."""

    object: str
    """Its name in specs."""
    words: str


@dataclass(frozen=True)
class WantedShapes:
    """Shapes that are to be built before runs can be made."""

    shapes: tuple[WantedShape, ...]
    is_last: bool
    """No run is left that was not looked at."""
    warnings: tuple[ShapeWarning, ...] = ()
    """About shapes that were built."""


class ShapesMissing(Exception):  # a state of the queue, not an error
    """Runs are left, and all of them wait for shapes."""


class RunQueue(Protocol):
    """Interface of the queue of a job's runs; its methods are called in the loader's thread."""

    extent: JobExtent
    has_shapes: bool = False
    """True if runs may wait for shapes."""

    def next(self) -> RunPlan | None:
        """Return the next run to carry out; None when no run is left.

        Raises RunFailed if it cannot be made, while the one behind it may; DiskFull if there is no room for
        it now: it is made when `next` is called again and there is; ShapesMissing if every run that is left
        waits for a shape that was wanted.
        """

    def put_back(self, run: str) -> None:
        """Have `next` make a run again, before any other: it goes on from its records.

        May be called in another thread than `next`.
        """

    def object_of(self, run: str) -> str:
        """Return the object of a run, as its spec names it; empty: not known. In any thread."""
        return ""

    def wanted_shapes(self, most: int) -> "WantedShapes":
        """Return shapes, each once, that the next runs need and that are not built yet."""
        return WantedShapes((), is_last=True)

    @property
    def ready_runs(self) -> int:
        """Number of runs known to be left that wait for no shape; in any thread."""
        return 0

    def take_shape(self, reply: BuildReply) -> ShapeWarning | None:
        """Take the end of a build of a shape that was wanted.

        Without a shape or a reason it is left to `next` to build it.
        """
        return None


class NamedRunQueue(RunQueue):
    """The queue of a job with a few runs; `make` makes each by its name, at its very beginning."""

    def __init__(self, make: Callable[[str], RunPlan], budgets: Mapping[str, int]) -> None:
        self.extent = JobExtent.of(budgets)
        self._make = make
        self._left = deque(budgets)

    def next(self) -> RunPlan | None:
        """Return the next run; None when all were given."""
        return self._make(self._left.popleft()) if self._left else None

    def put_back(self, run: str) -> None:
        """Have a run made again, before any other."""
        self._left.appendleft(run)


RUN_DEFAULTS = {"protocol": "physical"}
"""Defaults of a run or a campaign of meshes that flags ask for; a campaign's file has those of the paper."""
FLIGHT_KEYS = ("population", "generations_in_flight", "in_flight")
"""Keys of a spec that say how much is in flight: where one is given, the method decides none of them anew."""


def asked_spec(values: dict[str, Any], where: str = "spec") -> RunSpec:
    """Return the complete spec of a run that is asked for here, with the defaults of runs.

    Raises as `full_spec`.
    """
    values = RUN_DEFAULTS | values
    return full_spec(usual_engine(values["protocol"]) | values, where)


def full_spec(values: dict[str, Any], where: str = "spec") -> RunSpec:
    """Return the complete spec: files as absolute paths, defaults of the method filled in.

    Raises InputError if a key, value or name is not valid, or not with this method; valid ones are named.
    """
    spec = complete_spec(values, where)
    files = {key: absolute_asset(getattr(spec, key)) for key in ("gripper", "object", "scene")}
    regions = {key: tuple(map(absolute_asset, getattr(spec, key) or ())) or None for key in ("on", "avoid")}
    return structs.replace(spec, **files, **regions)


def complete_spec(values: dict[str, Any], where: str = "spec") -> RunSpec:
    """Return the spec with its method's defaults; gripper and object stay as they are named.

    Raises as `full_spec`.
    """
    chosen = method(run_spec(values, where).method)
    usual = {
        name: getattr(chosen, name) for name in ("aim_for", "overlaps", "population", "generations_in_flight")
    }
    spec = run_spec(usual | values, where)
    if spec.overlaps == "redraw" and values.keys().isdisjoint(FLIGHT_KEYS):
        spec = structs.replace(spec, in_flight=chosen.in_flight)
    check_spec(spec)
    return spec


USUAL_DENSITY = 500.0  # Of a mesh file's object whose mass is not said [kg/m3]


def with_mass(spec: RunSpec) -> RunSpec:
    """Return the spec with the mass of its mesh file at `USUAL_DENSITY`, unless a mass is known.

    Raises InputError if there is no such object, or the mesh cannot be used.
    """
    check_object(spec.object)
    if spec.mass is not None or is_in_catalog(spec.object):
        return spec
    found = check_mesh(named_path(spec.object), spec.scale, spec.mesh)
    if found.faults:
        raise AssetError(f"The mesh '{spec.object}' cannot be used: {'; and '.join(found.faults)}.")
    return structs.replace(spec, mass=float(f"{USUAL_DENSITY * found.volume:.3g}"))


def absolute_asset(name: Any) -> Any:
    """Return a gripper or object: a file as its absolute path, anything else as it is."""
    path = named_path(name) if isinstance(name, str) else Path()
    return str(path.resolve()) if path.suffix and not path_problem(path) else name


def default_run_name(spec: RunSpec) -> str:
    """Return the name of a run's folder when it has none."""
    return f"{Path(spec.gripper).stem}-{Path(spec.object).stem}-{spec.method}-s{spec.seed}"


def prepare_scene(
    spec: RunSpec, shape: ObjectShape | None = None, tell: Tell = ignore_progress
) -> PreparedScene:
    """Build the scene of a spec; `shape` is that of its object, where it was built elsewhere.

    `tell` is called with a sentence before each slow step. Raises InputError if it cannot be built, or the
    method's prior is not for such a hand.
    """
    scene = build_scene(spec, tell, shape)
    check_spec_poses(spec, scene.gripper, row_shape(scene, prior_of(spec)).genes)
    return PreparedScene(scene, pack_scene(scene))


def plan_run(
    spec: RunSpec, prepared: PreparedScene, run: str = RUN, search: SearchAlgorithm | None = None
) -> RunPlan:
    """Return a run as its spec asks; a `search` of one's own asks genomes of the method's prior.

    Raises InputError if the spec has poses that its hand cannot take.
    """
    if search is None:
        check_spec_poses(spec, prepared.scene.gripper, row_shape(prepared.scene, prior_of(spec)).genes)
        search = method(spec.method).build(spec, search_space(prepared.scene, prior_of(spec)))
    return RunPlan.of(spec, prepared, lambda shape: Pipeline(search, shape, spec), run=run)


GENOMES_AT_ONCE = 4096  # Given genomes of a generation; two generations are handed out ahead of results


def plan_genomes(
    spec: RunSpec, prepared: PreparedScene, prior: str, genomes: Genomes, run: str = RUN
) -> RunPlan:
    """Return a run that evaluates given genomes (n, d) of a prior, each once, in their order."""
    search = FixedPoseSearch(genomes, GENOMES_AT_ONCE)
    whole = structs.replace(_spec_of_all(spec, len(genomes)), generations_in_flight=2, in_flight=None)
    return RunPlan.of(spec, prepared, lambda shape: Pipeline(search, shape, whole), prior, run)


def row_shape(scene: Scene, prior: str) -> RowShape:
    """Return the shape of a scene's rows."""
    joints = len(scene.gripper.joints)
    return RowShape(len(layout(scene, prior)), joints, scene.contact_slots)
