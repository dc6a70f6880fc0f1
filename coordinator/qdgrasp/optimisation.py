"""Carries out a run with a search of one's own, with the folder that every run has."""

import os
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from itertools import chain
from pathlib import Path
from typing import Protocol, TypeAlias, Unpack

from numpy.typing import ArrayLike

from qdgrasp.arguments import (
    SceneArguments,
    check_genomes,
    layout_of,
    spec_from_arguments,
)
from qdgrasp.backend import HERE, Place, SilentProgress, open_place
from qdgrasp.runs import Run
from qdgrasp_coordinator.scheduler.recorder_client import RecorderClient
from qdgrasp_coordinator.scheduler.run_plan import NamedRunQueue, plan_run, prepare_scene
from qdgrasp_coordinator.search.registry import CUSTOM
from qdgrasp_coordinator.storage.job_folder import RUN
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.errors import FolderError, ImpossibleValue, InputError, UnknownName
from qdgrasp_protocol.process import Stop
from qdgrasp_protocol.rows import Genomes, Layout, Rows
from qdgrasp_protocol.spec import MAX_POPULATION, RunSpec, differences
from qdgrasp_tools.local.progress import ProgressDisplay, progress_display
from qdgrasp_tools.local.supervisor import check_engines


class Search(Protocol):
    """A search of one's own: asked and told generation by generation, each once and in order.

    Where its genomes depend only on the rows that it was told, and on seeds, its run has the same journal
    with any workers, and can be resumed.
    """

    def ask(self, generation: int) -> ArrayLike:
        """Return genomes (n, d) in [-1, 1], n at most 4096; n = 0 ends the run."""

    def tell(self, generation: int, rows: Rows) -> None:
        """Take the rows (n,) of a generation in order; `rows["fitness"]` is the score.

        Where the protocol has trials it is the sum over those of a success, and `rows["trial"]` their number.
        The generation that reaches the budget is not told.
        """


Make: TypeAlias = Callable[[Layout], Search]
"""Makes a new search for genomes with this layout; most often a class."""


class CheckedSearch:
    """A custom search whose genomes are checked before they are evaluated."""

    def __init__(self, make: Make, layout: Layout) -> None:
        if not callable(make):
            raise ImpossibleValue("make", make, "a class or function that is called with the genes")
        self._search = made = make(layout)
        if missing := [verb for verb in ("ask", "tell") if not callable(getattr(made, verb, None))]:
            raise InputError(f"The result of make, {made!r}, has no {' and no '.join(missing)}.")
        self._layout = layout

    def ask(self, generation: int) -> Genomes:
        """Return the genomes of a generation, as float32."""
        genomes = check_genomes(self._search.ask(generation), self._layout)
        if len(genomes) > MAX_POPULATION:
            raise ImpossibleValue("genomes", genomes.shape, f"at most {MAX_POPULATION} in a generation")
        return genomes

    def tell(self, generation: int, rows: Rows) -> None:
        """Pass on the rows of a generation."""
        self._search.tell(generation, rows)


def optimise(
    make: Make,
    out: str | os.PathLike[str],
    *,
    evaluations: int,
    prior: str = "contact",
    seed: int = 0,
    generations_in_flight: int = 1,
    resume: bool = False,
    progress: bool = False,
    place: Place = HERE,
    **scenery: Unpack[SceneArguments],
) -> Run:
    """Carry out a run with a custom search: coordinator, recorder and workers as in any run.

    The folder is a run's: `qdgrasp info`, `show`, `export` and the others read it. Only this resumes it.

    Parameters
    ----------
    make
        Makes the search; called with the genes' names and intervals. The search is asked and told one call at
        a time, not always in the same thread. While it takes its time, workers wait; it may take minutes.
    out
        The run's folder, which must not exist yet unless `resume` is true.
    evaluations
        The budget: the run ends with so many evaluations, or when the search asks nothing any more.
    prior
        How genomes are decoded (docs/methods.md).
    seed
        Written in the spec; only the search uses it.
    generations_in_flight
        Generation g is asked when generation g minus this has been told.
    resume
        Go on with a run that was stopped, if there is one: the search is made anew, and asked and told again
        what the journal has. Promised only where it asks the same again, bit for bit; that is compared.
    progress
        Show the progress on standard error.
    place
        Where the workers run.
    **scenery
        `gripper` and `object`, and where need be `mass`, `scale`, `friction`, `protocol`, `surface_seed`.

    Returns
    -------
    run
        As `qdgrasp.open(out)` returns it.

    Raises
    ------
    InputError
        A name that is not known, a value that cannot be, a file that cannot be used, genomes that are none;
        or the journal is not what the search asks again. Errors found before any evaluation leave no
        folder.
    EndedEarly
        The job was cancelled, or processes die again and again; `resume` goes on with it.

    Examples
    --------
    >>> class Uniform:
    ...     def __init__(self, layout):
    ...         self.genes = len(layout)
    ...
    ...     def ask(self, generation):
    ...         return np.random.default_rng(generation).uniform(-1, 1, (100, self.genes))
    ...
    ...     def tell(self, generation, rows):
    ...         print(generation, rows["fitness"].mean())
    >>> run = qdgrasp.optimise(Uniform, "runs/mine", evaluations=1000, gripper="panda", object="mug")
    """
    path = Path(out)
    place.check_hands()
    if prior not in list(CUSTOM):
        raise UnknownName("prior", str(prior), CUSTOM)
    spec = spec_from_arguments(
        scenery,
        method=CUSTOM[prior].name,
        evaluations=evaluations,
        seed=seed,
        generations_in_flight=generations_in_flight,
    )
    check_engines([spec], place.hands)
    is_there = _is_there(path, spec, resume=resume)
    prepared = RunFolder(path).prepared_scene() if is_there else prepare_scene(spec)
    genes = layout_of(prepared.scene, prior)
    # the first is made before there is a folder, and a new one each time that the run begins again
    searches = chain([CheckedSearch(make, genes)], iter(lambda: CheckedSearch(make, genes), None))
    shows: AbstractContextManager[ProgressDisplay] = (
        progress_display(path.name, spec.evaluations) if progress else nullcontext(SilentProgress())
    )
    meeting = place.meet()  # before there is a folder
    with meeting[0]:
        if is_there:
            folder = RunFolder(path)
            folder.rewrite_spec(spec)  # the budget may be a greater one
        else:
            folder = RunFolder.create(path, spec, prepared.bundle, job=place.job)
        with (
            shows as shown,
            folder.job.supervise(),
            open_place(place, folder.job.logs, shown, folder.job.name, meeting) as session,
        ):
            session.start_recorder(folder.path)
            session.start_workers(place.hands)
            session.coordinate(
                NamedRunQueue(
                    lambda _: plan_run(spec, prepared, search=next(searches)), {RUN: spec.evaluations}
                ),
                lambda run: RecorderClient(session.bus, session.job, run.shape),
                Stop(),
                place.batch_size,
            )
    return Run(path)


def _is_there(path: Path, spec: RunSpec, *, resume: bool) -> bool:
    """Check that the run can be begun or continued; True: it was begun."""
    if not RunFolder.is_run(path):
        RunFolder.check_free(path)
        return False
    if not resume:
        raise FolderError(f"{path} holds a run already: resume=True goes on with it, or name another folder.")
    if other := differences(RunFolder(path).spec, spec):
        raise FolderError(f"{path} holds a run with another {', '.join(other)}; name another folder.")
    RunFolder(path).job.check_not_in_use()
    return True
