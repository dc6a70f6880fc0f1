"""Evaluates genomes and hand poses whenever a program wants that."""

import signal
import tempfile
import threading
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import ExitStack
from itertools import count
from pathlib import Path
from queue import SimpleQueue
from typing import Self, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qdgrasp.arguments import SceneArguments, check_genomes, layout_of, spec_from_arguments
from qdgrasp.backend import HERE, Place, SilentProgress, check_process, open_place
from qdgrasp_coordinator.metrics.successes import TrialPlan, all_successes
from qdgrasp_coordinator.scheduler.recorder_client import RowSink
from qdgrasp_coordinator.scheduler.run_plan import (
    JobExtent,
    RunPlan,
    RunQueue,
    plan_genomes,
    prepare_scene,
)
from qdgrasp_coordinator.search.fixed_poses import HandPoses, check_given, scores
from qdgrasp_protocol.errors import EndedEarly, InputError
from qdgrasp_protocol.process import Stop
from qdgrasp_protocol.rows import GIVEN, Outcome, Rows
from qdgrasp_tools.local.supervisor import LocalSession, check_engines


class GenomeRequest(RowSink):
    """Genomes that were asked for together, and their rows as in a journal, trials too."""

    def __init__(self, plan: RunPlan, finish: Callable[[Rows], Rows]) -> None:
        super().__init__(plan.shape)
        self.plan = plan
        self.finish = finish
        self.answer: Future[Rows] = Future()
        """What `finish` makes of all rows."""
        self.answer.set_running_or_notify_cancel()  # it cannot be cancelled


class GenomeRequests(RunQueue):
    """A run queue that is filled while it is being worked off, until it is closed."""

    def __init__(self) -> None:
        self.extent = JobExtent.of({})
        self._waiting: SimpleQueue[RunPlan | None] = SimpleQueue()

    def put(self, plan: RunPlan) -> None:
        """Add a run."""
        self._waiting.put(plan)

    def close(self) -> None:
        """End the queue."""
        self._waiting.put(None)

    def next(self) -> RunPlan | None:
        """Wait for the next run; None when the queue is closed."""
        return self._waiting.get()

    def put_back(self, run: str) -> None:
        """Do nothing: rows in memory are not lost."""


class Evaluations:
    """Evaluates genomes whenever a program wants that: a context manager.

    The coordinator, the bus and the workers are those of a run; there is no recorder and no folder. The row
    of a genome depends on scene, prior and genome alone: not on the workers, on how genomes are grouped, or
    on earlier genomes.

    Parameters
    ----------
    prior
        The rule that decodes genomes: "contact", "approach", "antipodal", "spherical" or "given"
        (docs/methods.md).
    place
        Where the workers run.
    pool
        Other evaluations, whose with-block and workers serve this scene too; None: it has its own.
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

    def __init__(
        self,
        *,
        prior: str = "contact",
        place: Place = HERE,
        pool: "Evaluations | None" = None,
        **scenery: Unpack[SceneArguments],
    ) -> None:
        self._place = place
        self._pool = pool or self
        self.spec = spec_from_arguments(scenery)
        check_engines([self.spec], self._pool._place.hands)
        self._prepared = prepare_scene(self.spec)
        self.scene = self._prepared.scene
        """The gripper and the object as they are simulated."""
        self.prior = prior
        self.layout = layout_of(self.scene, prior)
        """The genes: names, and what -1 and 1 stand for."""
        self.endpoint = ""
        """Endpoint of its bus within the with-block; other workers and `qdgrasp jobs` may connect."""
        self._count = count(1)
        self._open: ExitStack | None = None
        self._begin()

    def _begin(self) -> None:
        self._queue = GenomeRequests()
        self._pending: list[GenomeRequest] = []
        self._stop = Stop()
        self._end: BaseException | None = None

    def __enter__(self) -> Self:
        if self._pool is not self:
            raise InputError("Evaluations with a pool are open in the with-block of the pool.")
        self._begin()
        with ExitStack() as stack:
            logs = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="qdgrasp-")))
            session = stack.enter_context(open_place(self._place, logs, SilentProgress()))
            session.start_workers(self._place.hands)
            self.endpoint = session.endpoint
            thread = threading.Thread(target=self._serve, args=(session,), name="evaluations", daemon=True)
            thread.start()
            stack.callback(thread.join)
            stack.callback(self._leave)
            self._open = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        if self._open is not None:
            self._open.close()
            self._open = None

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
            The genomes have another shape, or values that a genome, a pose or the hand cannot have.
        TimeoutError
            The time is over. The genomes are still evaluated, and their rows are dropped.
        EndedEarly
            The job was cancelled, or workers die again and again.
        """
        try:
            return self.submit(genomes).result(timeout)
        except TimeoutError:
            raise TimeoutError(f"After {timeout:g} s there are not all rows of the genomes.") from None

    def submit(self, genomes: ArrayLike) -> "Future[Rows]":
        """Have genomes evaluated, and return at once a future of what `evaluate` returns.

        Several may be under way, of one scene or of several in a pool. None can be cancelled. Raises as
        `evaluate` does, in part when the result is asked for.
        """
        return self._submit(genomes, self._scored)

    def journal(self, genomes: ArrayLike) -> Rows:
        """Return every row that a journal would have, trials too, with nominal fitness."""
        return self._submit(genomes, lambda rows: rows).result()

    def _scored(self, rows: Rows) -> Rows:
        found = all_successes(rows, TrialPlan.of(self.spec), least=Outcome.ERROR)
        found.rows["fitness"] = found.scores
        return found.rows

    def _submit(self, genomes: ArrayLike, finish: Callable[[Rows], Rows]) -> "Future[Rows]":
        pool = self._pool
        if pool._open is None:
            raise InputError("Evaluations are opened by a with-block: `with qdgrasp.Evaluations(...) as e:`.")
        check_process()
        asked = check_genomes(genomes, self.layout)
        if self.prior == GIVEN:
            check_given("genomes: ", asked, self.scene.gripper)
        plan = plan_genomes(self.spec, self._prepared, self.prior, asked, f"lot-{next(pool._count)}")
        request = GenomeRequest(plan, finish)
        if not len(asked):
            request.answer.set_result(request.rows)
            return request.answer
        pool._pending.append(request)
        pool._queue.put(request.plan)
        if pool._end is not None:
            raise pool._end
        return request.answer

    # The thread of the coordinator.

    def _serve(self, session: LocalSession) -> None:
        """Coordinate the job until the with-block is left."""
        try:
            session.coordinate(self._queue, self._record, self._stop, self._place.batch_size, self._settle)
        except BaseException as error:  # noqa: BLE001  # it is raised in the threads that wait
            self._end = error
        else:
            self._end = EndedEarly("The job has ended.")
        for request in self._pending:
            request.answer.set_exception(self._end)

    def _settle(self) -> None:
        for request in list(self._pending):
            if request.plan.pipeline.finished is not None:
                request.answer.set_result(request.finish(request.rows))
                self._pending.remove(request)

    def _record(self, plan: RunPlan) -> RowSink:
        return next(request for request in self._pending if request.plan is plan)

    def _leave(self) -> None:
        self._stop.set(signal.SIGTERM)
        self._queue.close()


def evaluate(
    positions: ArrayLike,
    quaternions_xyzw: ArrayLike,
    *,
    synergies: ArrayLike | None = None,
    spreads: ArrayLike | None = None,
    place: Place = HERE,
    **scenery: Unpack[SceneArguments],
) -> dict[str, NDArray[np.generic]]:
    """Score arrays of hand poses, as `qdgrasp evaluate` does for files.

    Parameters
    ----------
    positions
        (n, 3) [m]: of the hand's root link, in the object's centre-of-mass frame.
    quaternions_xyzw
        (n, 4): orientations of that link; scaled to length one.
    synergies
        (n,): labels of the synergies that close, -1 for none; None: none.
    spreads
        (n, k): positions of the free joints [rad], NaN for open; None: open.
    place
        Where the workers run.
    **scenery
        `gripper` and `object`, and where need be `mass`, `scale`, `friction`, `protocol`, `surface_seed`.

    Returns
    -------
    scores
        Arrays of n by name: `valid`, `touched`, `success` (bool), `fitness` (0 to 2), `outcome` (`Outcome`),
        `base_position`, `base_quaternion_xyzw`, `joints` (n, j), `contacts`, `penetration` [m]; of successes
        `settled_position`, `settled_quaternion_xyzw`, `motion` (n, 2) [m, rad], `margin` and contacts, as
        docs/formats.md has them; with a protocol that has trials also `eta`.

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
    poses = HandPoses.of(positions, quaternions_xyzw, synergies, spreads)
    evaluations = Evaluations(prior=GIVEN, place=place, **scenery)
    genomes = poses.genomes(evaluations.scene)
    place.check_hands()
    with evaluations:
        rows = evaluations.journal(genomes)
    return scores(rows, evaluations.scene.object, TrialPlan.of(evaluations.spec))
