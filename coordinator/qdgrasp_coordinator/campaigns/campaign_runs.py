"""The runs of a campaign in its folder: which are finished, and how the others are made ready."""

from collections import deque
from collections.abc import Iterator, Mapping
from pathlib import Path

from qdgrasp_assets.scene import Bundle, Scene
from qdgrasp_coordinator.campaigns import finding
from qdgrasp_coordinator.campaigns.budget import tally_within
from qdgrasp_coordinator.campaigns.programme import Extent
from qdgrasp_coordinator.campaigns.summary import summary
from qdgrasp_coordinator.counts.totals import Totals, totals
from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_coordinator.folders.job_folder import JobFolder
from qdgrasp_coordinator.runs import preparation
from qdgrasp_coordinator.runs.assignment import Assignment
from qdgrasp_protocol.errors import DiskFull, EndsTooSoon, FolderError, ImpossibleValue, InputError, RunFailed
from qdgrasp_protocol.spec import GOALS, RunSpec, differences

SCENE = ("gripper", "object", "mass", "scale", "friction", "protocol", "surface_seed")
"""The keys of a spec that its scene depends on."""


class CampaignRuns:
    """The programme of a campaign: its unfinished runs, each made when its turn comes.

    Parameters
    ----------
    folder
        The campaign's; None: nothing is known of what was recorded, and no folders are made.
    runs
        The specs by name.

    Raises
    ------
    FolderError, EndsTooSoon
        A run's folder holds another run, or more evaluations than its budget.
    """

    def __init__(self, folder: JobFolder | None, runs: Mapping[str, RunSpec]) -> None:
        self._folder = folder
        self._runs = runs
        budgets = {name: spec.evaluations for name, spec in runs.items()}
        self.extent = Extent.of(budgets).with_done(dict(self._done()))
        self._left = deque(self.extent.budgets)
        self._scene: tuple[RunSpec, tuple[Scene, Bundle]] | None = None

    def next(self) -> Assignment | None:
        """The next unfinished run, with a folder of its own.

        Raises
        ------
        RunFailed
            Its scene cannot be built, or its folder not be written.
        DiskFull
            There is no room for its folder; it stays the next.
        """
        if not self._left:
            return None
        name = self._left.popleft()
        try:
            return self._make(name, self._runs[name])
        except DiskFull:
            self.put_back(name)
            raise
        except InputError as error:
            raise RunFailed(name, str(error)) from None

    def put_back(self, run: str) -> None:
        """Have a run made again, before any other."""
        self._left.appendleft(run)

    def _done(self) -> Iterator[tuple[str, Totals]]:
        """The runs that are finished, with what they found."""
        for name, spec in self._runs.items():
            found = finished(self._folder.run_path(name), spec) if self._folder else None
            if found is not None:
                yield name, found

    def _make(self, name: str, spec: RunSpec) -> Assignment:
        path = self._folder.run_path(name) if self._folder else None
        if path is not None and RunFolder.is_run(path) and RunFolder(path).has_bundle():
            folder = RunFolder(path)
            return preparation.assignment(spec, folder.scene(), folder.bundle(), name)
        scene, bundle = self._built(spec)
        if self._folder is not None and path is not None and not RunFolder.is_run(path):
            RunFolder.add(self._folder, name, spec, bundle)
        return preparation.assignment(spec, scene, bundle, name)

    def _built(self, spec: RunSpec) -> tuple[Scene, Bundle]:
        """The scene of a spec; neighbours in the order often share theirs."""
        if self._scene is None or not _share_scene(self._scene[0], spec):
            self._scene = spec, preparation.make_bundle(spec)
        return self._scene[1]


def finished(path: Path, spec: RunSpec) -> Totals | None:
    """What the run that `spec` asks for has found, where its folder holds all of it.

    None: it is not finished, or its journal cannot be read; why not is told when the recorder opens it.

    Raises
    ------
    FolderError, EndsTooSoon
        It holds a run of another spec, more evaluations than the budget, or successes alone of fewer.
    """
    if not RunFolder.is_run(path):
        return None
    folder = RunFolder.open(path)
    differ = differences(folder.spec, spec)
    if differ:
        raise FolderError(f"{path} holds a run of another spec ({', '.join(differ)}); name another folder.")
    try:
        with folder.journal() as journal:
            is_reduced = bool(journal.sources)
        if not is_reduced:
            return finding.read(folder, spec) or _counted(folder, spec)
    except FolderError:
        return None
    if any(getattr(folder.spec, key) != getattr(spec, key) for key in GOALS):
        raise FolderError(f"{path} was pruned, so that it cannot be gone on with; name another folder.")
    return totals(summary(folder))


def _counted(folder: RunFolder, spec: RunSpec) -> Totals | None:
    """What a run's rows come to, kept for the next time; None while it is not finished."""
    try:
        found = tally_within(folder, spec)
    except ImpossibleValue as reason:
        raise EndsTooSoon(folder.path, reason) from None
    if not found.finished:
        return None
    finding.write(folder, spec, totals(found))
    return totals(found)


def _share_scene(one: RunSpec, other: RunSpec) -> bool:
    return all(getattr(one, key) == getattr(other, key) for key in SCENE)
