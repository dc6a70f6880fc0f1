"""Evaluations: rows of genomes, whenever a program wants some, and scores of hand poses."""

import signal
import tempfile
import threading
from concurrent.futures import Future, wait
from contextlib import ExitStack
from pathlib import Path
from queue import SimpleQueue
from typing import Self, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qdgrasp.genomes import checked, layout_of
from qdgrasp.places import HERE, Place, Quiet, Stage, opened
from qdgrasp.scenery import Scenery, spec_of
from qdgrasp_assets.catalog import build_scene
from qdgrasp_assets.scene import pack_scene
from qdgrasp_coordinator.campaigns.programme import Extent
from qdgrasp_coordinator.counts.poses import Poses, scores
from qdgrasp_coordinator.counts.scores import sums
from qdgrasp_coordinator.folders.job_folder import RUN
from qdgrasp_coordinator.runs.assignment import Assignment
from qdgrasp_coordinator.runs.pipeline import Pipeline
from qdgrasp_coordinator.runs.preparation import scene_shape
from qdgrasp_coordinator.searches.given import Given
from qdgrasp_coordinator.serving.record import Memory
from qdgrasp_coordinator.serving.service import CoordinatorService
from qdgrasp_protocol.errors import EndedEarly, ImpossibleValue, InputError
from qdgrasp_protocol.genome import GIVEN, NO_SYNERGY, Genomes
from qdgrasp_protocol.lifetime import Stop
from qdgrasp_protocol.rows import Rows
from qdgrasp_protocol.spec import to_toml
from qdgrasp_protocol.trials import trials

GENERATION = 4096
"""Genomes that are handed out before the first result is waited for."""
SHORTEST = 1e-6
"""Quaternions that are shorter name no rotation."""


class Lot:
    """Genomes that were asked for together, and what becomes of them."""

    def __init__(self, assignment: Assignment) -> None:
        self.assignment = assignment
        self.memory = Memory(assignment.shape)
        self.rows: Future[Rows] = Future()
        """Rows as in a journal, trials too."""

    def look(self) -> None:
        """See whether all of them are there."""
        if self.assignment.pipeline.finished is not None and not self.rows.done():
            self.rows.set_result(self.memory.rows)


class Lots:
    """A programme whose runs are made as somebody asks for them, one after the other, until it is closed."""

    def __init__(self) -> None:
        self.extent = Extent.of({})
        self._waiting: SimpleQueue[Assignment | None] = SimpleQueue()

    def put(self, assignment: Assignment) -> None:
        """Have it carried out."""
        self._waiting.put(assignment)

    def close(self) -> None:
        """Ask for no more."""
        self._waiting.put(None)

    def next(self) -> Assignment | None:
        """The next one, waited for; None when there will be none."""
        return self._waiting.get()

    def put_back(self, run: str) -> None:
        """What is kept in memory loses nothing."""


class Evaluations:
    """Evaluates genomes whenever a program wants that: a context manager.

    The coordinator, the bus and the workers are those of a run; there is no recorder and no folder. What a
    genome gives depends on scene, prior and genome alone: not on the workers, on how genomes are grouped, or
    on what was asked before.

    Parameters
    ----------
    prior
        How genomes are decoded: "contact", "approach", "antipodal", "spherical", "aimed" or "given"
        (docs/methods.md).
    place
        Where it is done.
    **scenery
        `gripper` and `object`, and where need be `mass`, `scale`, `friction`, `protocol`, `surface_seed`.

    Raises
    ------
    InputError
        A name that is not known, a value that cannot be, or a file that cannot be used.

    Examples
    --------
    >>> with qdgrasp.Evaluations(prior="approach", gripper="panda", object="mug") as evaluations:
    ...     genomes = np.random.default_rng(0).uniform(-1, 1, (100, len(evaluations.layout)))
    ...     rows = evaluations.evaluate(genomes)
    >>> rows["fitness"].max(), rows["base_to_object"].shape
    (2.0, (100, 7))
    """

    def __init__(self, *, prior: str = "contact", place: Place = HERE, **scenery: Unpack[Scenery]) -> None:
        self.spec = spec_of(scenery)
        self.scene = build_scene(self.spec)
        """The gripper and the object as they are simulated."""
        self.prior = prior
        self.layout = layout_of(self.scene, prior)
        """The genes: names, and what -1 and 1 stand for."""
        self._bundle = pack_scene(self.scene)
        self._shape = scene_shape(self.scene, prior)
        self.endpoint = ""
        """Where its bus is, within the with-block: other workers may join there, and `qdgrasp jobs` looks."""
        self._place = place
        self._lots = Lots()
        self._lot: Lot | None = None
        self._stop = Stop()
        self._doors: ExitStack | None = None
        self._end: BaseException | None = None

    def __enter__(self) -> Self:
        with ExitStack() as doors:
            logs = Path(doors.enter_context(tempfile.TemporaryDirectory(prefix="qdgrasp-")))
            stage = doors.enter_context(opened(self._place, logs, Quiet()))
            stage.hire_workers()
            self.endpoint = stage.endpoint
            thread = threading.Thread(target=self._serve, args=(stage,), name="evaluations", daemon=True)
            thread.start()
            doors.callback(thread.join)
            doors.callback(self._leave)
            self._doors = doors.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        if self._doors is not None:
            self._doors.close()
            self._doors = None

    def evaluate(self, genomes: ArrayLike, timeout: float | None = None) -> Rows:
        """Evaluate genomes, in the order that they have.

        Parameters
        ----------
        genomes
            (n, d) in [-1, 1], d = len(layout); of the prior `given` poses as they are: x y z [m], qx qy qz qw
            in the object's centre-of-mass frame, then synergy and free joints where the hand has them.
        timeout
            Seconds; None: as long as it takes, also until a worker comes.

        Returns
        -------
        rows
            (n,) structured: `outcome`, `fitness`, `base_to_object` (7), `joints`, `descriptor` and more
            (docs/run-folder.md). Where the protocol has trials, `fitness` is the sum over those of a success.

        Raises
        ------
        ImpossibleValue
            They have another shape, or hold what a genome cannot.
        TimeoutError
            The time is over; what was asked is evaluated all the same.
        EndedEarly
            Somebody cancelled the job, or workers die again and again.
        """
        rows = self.journal(genomes, timeout)
        nominal: Rows = rows[rows["trial"] == 0]
        nominal["fitness"] = sums(rows, trials(self.spec.protocol))
        return nominal

    def journal(self, genomes: ArrayLike, timeout: float | None = None) -> Rows:
        """The same with every row that a journal would have, trials too, and nominal fitness."""
        if self._doors is None:
            raise InputError("Evaluations are opened by a with-block: `with qdgrasp.Evaluations(...) as e:`.")
        asked = checked(genomes, self.layout)
        if not len(asked):
            return self._shape.empty(0)
        if self._lot is not None:
            wait([self._lot.rows], timeout)  # one that somebody has stopped waiting for
        lot = self._lot = Lot(self._assignment(asked))
        self._lots.put(lot.assignment)
        if self._end is not None:
            raise self._end
        return lot.rows.result(timeout)

    def _assignment(self, genomes: Genomes) -> Assignment:
        pipeline = Pipeline(
            Given(genomes, GENERATION),
            self._shape,
            evaluations=len(genomes),
            overlaps="count",
            generations_in_flight=2,
            trials=trials(self.spec.protocol),
        )
        spec = to_toml(self.spec).encode()
        return Assignment(RUN, spec, self._bundle, self.prior, self._shape, pipeline, len(genomes))

    # What follows runs in a thread of its own.

    def _serve(self, stage: Stage) -> None:
        """Be the coordinator until the with-block is left."""
        service = CoordinatorService(
            stage.bus,
            self._stop,
            job=stage.job,
            programme=self._lots,
            make_record=self._record,
            batch_size=self._place.batch_size,
        )

        def look(now: float) -> None:
            stage.watch.progressed(service.figures(now))
            stage.watch.look(now)
            if self._lot is not None:
                self._lot.look()

        try:
            service.run(look)
        except BaseException as error:  # noqa: BLE001  # it is raised where somebody waits
            self._end = error
        else:
            self._end = EndedEarly("The job has ended.")
        if self._lot is not None and not self._lot.rows.done():
            self._lot.rows.set_exception(self._end)

    def _record(self, assignment: Assignment) -> Memory:
        """Where the rows of a lot go."""
        lot = self._lot
        if lot is None or lot.assignment is not assignment:
            return Memory(assignment.shape)  # of one that nobody waits for any more
        return lot.memory

    def _leave(self) -> None:
        self._stop.set(signal.SIGTERM)
        self._lots.close()


def evaluate(
    positions: ArrayLike,
    quaternions_xyzw: ArrayLike,
    *,
    synergies: ArrayLike | None = None,
    spreads: ArrayLike | None = None,
    place: Place = HERE,
    **scenery: Unpack[Scenery],
) -> dict[str, NDArray[np.generic]]:
    """Score hand poses; what `qdgrasp evaluate` does, for arrays.

    Parameters
    ----------
    positions
        (n, 3) [m]: of the hand's root link, in the object's centre-of-mass frame.
    quaternions_xyzw
        (n, 4): of the same; brought to length one.
    synergies
        (n,): labels of the synergies that close, -1 for none; None: none.
    spreads
        (n, k): positions of the free joints [rad], NaN for open; None: open.
    place
        Where it is done.
    **scenery
        `gripper` and `object`, and where need be `mass`, `scale`, `friction`, `protocol`, `surface_seed`.

    Returns
    -------
    scores
        Arrays of n by name: `valid`, `touched`, `success` (bool), `fitness` (0 to 2), `outcome` (`Outcome`),
        `base_position`, `base_quaternion_xyzw`, `joints` (n, j), `contacts`, `penetration` [m]; with a
        protocol that has trials also `eta`.

    Raises
    ------
    InputError
        A name that is not known, a value that cannot be, or a file that cannot be used.

    Examples
    --------
    >>> scores = qdgrasp.evaluate([[0.0, 0.0, 0.15]], [[1.0, 0.0, 0.0, 0.0]], gripper="panda", object="mug")
    >>> scores["success"], scores["fitness"]
    (array([ True]), array([2], dtype=uint8))
    """
    poses = _poses(positions, quaternions_xyzw, synergies, spreads)
    if not len(poses):
        raise InputError("There are no poses to score.")
    with Evaluations(prior=GIVEN, place=place, **scenery) as evaluations:
        rows = evaluations.journal(poses.genomes(evaluations.scene))
    return scores(rows, trials(evaluations.spec.protocol))


def _poses(
    positions: ArrayLike, quaternions: ArrayLike, synergies: ArrayLike | None, spreads: ArrayLike | None
) -> Poses:
    places = _array("positions", positions, (None, 3))
    n = len(places)
    turns = _array("quaternions_xyzw", quaternions, (n, 4))
    if (np.linalg.norm(turns, axis=1) < SHORTEST).any():
        raise ImpossibleValue("quaternions_xyzw", "one of length zero", "rotations")
    labels = np.full(n, NO_SYNERGY) if synergies is None else _array("synergies", synergies, (n,))
    free = np.full((n, 0), np.nan) if spreads is None else np.asarray(spreads, dtype=np.float64)
    if free.ndim != 2 or len(free) != n or np.isinf(free).any():
        raise ImpossibleValue("spreads", free.shape, f"numbers of shape ({n}, k)")
    return Poses(places, turns, labels.astype(np.int64), free)


def _array(name: str, values: ArrayLike, shape: tuple[int | None, ...]) -> NDArray[np.float64]:
    array = np.asarray(values, dtype=np.float64)
    fits = len(array.shape) == len(shape) and all(
        wanted in (None, came) for wanted, came in zip(shape, array.shape, strict=True)
    )
    if not fits or not np.isfinite(array).all():
        expected = ", ".join("n" if wanted is None else str(wanted) for wanted in shape)
        raise ImpossibleValue(name, array.shape, f"finite numbers of shape ({expected})")
    return array
