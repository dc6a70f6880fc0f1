"""The folder of a campaign: begun, or gone on with, and a queue of its unfinished runs.

The end of a run that has begun may be put off, not taken back below what is recorded. The index of finished
runs tells what is done without a look into their journals; a run that is not in it is counted, and added.
"""

import re
from collections import deque
from collections.abc import Mapping
from pathlib import Path

from qdgrasp_assets.asset_paths import named_path
from qdgrasp_assets.object_shape import MAX_SHAPE, ShapeStore, shape_task, unpack_shape
from qdgrasp_coordinator.metrics.job_status import RunListing
from qdgrasp_coordinator.metrics.run_stats import count_rows
from qdgrasp_coordinator.scheduler.run_plan import (
    BuildReply,
    JobExtent,
    RunPlan,
    RunQueue,
    ShapesMissing,
    ShapeWarning,
    WantedShape,
    WantedShapes,
    plan_run,
    prepare_scene,
)
from qdgrasp_coordinator.search.registry import check_spec
from qdgrasp_coordinator.storage import outputs
from qdgrasp_coordinator.storage.finished_runs import FinishedRuns
from qdgrasp_coordinator.storage.job_folder import JobFolder, new_job
from qdgrasp_coordinator.storage.outputs import CAMPAIGN, LOGS, RUNS, SKIPPED, OutFolder
from qdgrasp_coordinator.storage.run_folder import PreparedScene, RunFolder
from qdgrasp_protocol.errors import (
    DiskFull,
    FolderError,
    ImpossibleValue,
    InputError,
    MessageError,
    RunFailed,
)
from qdgrasp_protocol.messages import MAX_BUNDLE, inflate
from qdgrasp_protocol.spec import RunSpec, differences, run_spec, to_values
from qdgrasp_protocol.text import counted
from qdgrasp_tools.campaign.campaign_file import Campaign, read_campaign
from qdgrasp_tools.campaign.object_library import skip_report


def extend_run(folder: RunFolder, **goals: float) -> None:
    """Give a run a new budget, or other stop criteria: any of `spec.STOP_KEYS`.

    Raises ImpossibleValue if one is not allowed, or the journal goes on behind it.
    """
    spec = run_spec(to_values(folder.spec) | goals, "resume")
    check_spec(spec)
    with folder.journal() as journal:
        count_rows(spec, journal.blocks()).check_budget("--evaluations")
    folder.rewrite_spec(spec)


TASK_NAME = re.compile(r"'mesh\.\w+'")  # The name of a mesh where its shape is built
SCENE_KEYS = (
    *("gripper", "object", "mass", "scale", "friction", "mesh", "about"),
    *("protocol", "base", "engine", "surface_seed", "approach_distance", "resting_pose", "scene"),
    *("on", "avoid"),
)
"""The keys of a spec that its scene depends on."""


def run_listing(path: Path, spec: RunSpec) -> RunListing | None:
    """Return the counts of the run that `spec` asks for.

    None: it has not begun, or its journal cannot be read; the recorder that opens it says why. Raises
    FolderError or InputError where the folder holds a run of another spec, or more evaluations than the
    budget.
    """
    if not RunFolder.is_run(path):
        return None
    folder = RunFolder.open(path)
    if differ := differences(folder.spec, spec):
        raise FolderError(f"{path} holds a run of another spec ({', '.join(differ)}); name another folder.")
    try:
        with folder.journal() as journal:
            try:
                found = count_rows(spec, journal.blocks())
                found.check_budget()
            except ImpossibleValue as reason:
                raise InputError(f"{folder.path} cannot end as is asked: {reason}") from None
            return RunListing.of(journal.run, journal.scene, found)
    except FolderError:
        return None


def campaign_progress(folder: JobFolder, runs: Mapping[str, RunSpec]) -> dict[str, RunListing]:
    """Return the counts of a campaign's runs that have begun, by name; raises as `run_listing`.

    Finished ones are read from the index; those that it lacks are counted, and added.
    """
    found, index = dict[str, RunListing](), FinishedRuns(folder.path)
    index.refresh()
    for name, spec in runs.items():
        path = folder.run_path(name)
        listing = index.find(path, spec)
        if listing is None and (listing := run_listing(path, spec)) is not None and listing.finished:
            index.add(path, spec, listing)
        if listing is not None:
            found[name] = listing
    return found


class CampaignRunQueue(RunQueue):
    """The unfinished runs of a campaign, each made when it is next.

    Runs on a mesh file wait until its shape is built, unless it lies in the store of this machine or their
    folder has the scene; others go first. Without a `folder` nothing is known of recorded runs, and no
    folders are made; `runs` are specs by name. Raises FolderError or InputError if a run's folder holds
    another run, or more evaluations than its budget.
    """

    has_shapes = True

    def __init__(self, folder: JobFolder | None, runs: Mapping[str, RunSpec]) -> None:
        self._folder = folder
        self._runs = runs
        begun = campaign_progress(folder, runs) if folder else {}
        finished = {name: found.totals for name, found in begun.items() if found.finished}
        asked = JobExtent.of({name: spec.evaluations for name, spec in runs.items()})
        self.extent = asked.with_done(finished)
        self._left = deque(self.extent.budgets)  # Runs that were not looked at
        self._ready: deque[str] = deque()
        self._waiting: dict[str, list[str]] = {}  # Runs by the key of the shape that they wait for
        self._wanted: deque[WantedShape] = deque()
        self._failed: deque[RunFailed] = deque()
        self._keys: dict[str, str] = {}  # Keys of the shapes of runs that were looked at
        self._shapes = ShapeStore()
        self._scene: tuple[RunSpec, PreparedScene] | None = None

    def next(self) -> RunPlan | None:
        """Return the next unfinished run, with a folder of its own.

        Raises RunFailed if its scene cannot be built or its folder not be written, and DiskFull if there is
        no room for the folder; it then stays the next. Raises ShapesMissing if all that are left wait.
        """
        while self._left and not (self._ready or self._failed or self._wanted):
            self._look_at_next()
        if self._failed:
            raise self._failed.popleft()
        if not self._ready:
            if self._left or self._waiting:
                raise ShapesMissing
            return None
        name = self._ready.popleft()
        try:
            return self._prepare(name, self._runs[name])
        except DiskFull:
            self.put_back(name)
            raise
        except InputError as error:
            raise RunFailed(name, str(error)) from None

    def put_back(self, run: str) -> None:
        """Have a run made again, before any other."""
        self._ready.appendleft(run)

    def object_of(self, run: str) -> str:
        """Return the object of a run, as its spec names it."""
        return self._runs[run].object

    @property
    def ready_runs(self) -> int:
        """Number of runs known to be left that wait for no shape."""
        return len(self._ready)

    def wanted_shapes(self, most: int) -> WantedShapes:
        """Return shapes that the next runs need, until so many of them or of ready runs are found."""
        ready = len(self._ready)
        while self._left and len(self._wanted) + len(self._ready) - ready < most:
            self._look_at_next()
        shapes = tuple(self._wanted.popleft() for _ in range(min(most, len(self._wanted))))
        return WantedShapes(shapes, is_last=not (self._left or self._wanted))

    def take_shape(self, reply: BuildReply) -> ShapeWarning | None:
        """Keep a shape that was built, and have its runs made, or failed."""
        runs = self._waiting.pop(reply.key, [])
        if reply.reason:
            file = Path(self._runs[runs[0]].object).name if runs else ""
            said = TASK_NAME.sub(lambda _: f"'{file}'", reply.reason)
            reason = f"The shape of its object cannot be built: {said}"
            self._failed.extend(RunFailed(run, reason) for run in runs)
            return None
        self._ready.extend(runs)
        if not reply.pieces or not runs:
            return None
        name = self._runs[runs[0]].object
        try:
            payload = inflate(b"".join(reply.pieces), MAX_SHAPE)
            shape = unpack_shape(payload)
        except MessageError as error:  # `next` builds it
            words = f"A worker's shape of '{Path(name).name}' is left aside: {error}."
            return ShapeWarning(name, words)
        self._shapes.put(reply.key, payload)
        if reply.key not in self._shapes:
            words = f"The shape of '{Path(name).name}' cannot be kept in the cache: it is built again."
            return ShapeWarning(name, words)
        words = "; ".join(shape.notes)
        return ShapeWarning(name, f"'{Path(name).name}': {words}.") if words else None

    def _look_at_next(self) -> None:
        """Find out whether the next run waits for a shape."""
        name = self._left.popleft()
        spec, path = self._runs[name], self._folder.run_path(name) if self._folder else None
        if path is not None and RunFolder.is_run(path) and RunFolder(path).has_bundle():
            self._ready.append(name)
            return
        try:
            task = shape_task(spec)
            is_stored = task is not None and task.key in self._shapes
        except InputError as error:
            self._failed.append(RunFailed(name, str(error)))
            return
        if task is None or sum(file.size for file in task.files) > MAX_BUNDLE:
            self._ready.append(name)
            return
        self._keys[name] = task.key
        if task.key in self._waiting:
            self._waiting[task.key].append(name)
        elif is_stored:
            self._ready.append(name)
        else:
            self._waiting[task.key] = [name]
            self._wanted.append(WantedShape(task, named_path(spec.object)))

    def _prepare(self, name: str, spec: RunSpec) -> RunPlan:
        path = self._folder.run_path(name) if self._folder else None
        if path is not None and RunFolder.is_run(path) and RunFolder(path).has_bundle():
            return plan_run(spec, RunFolder(path).prepared_scene(), name)
        prepared = self._scene_of(name, spec)
        plan = plan_run(spec, prepared, name)
        if self._folder is not None and path is not None and not RunFolder.is_run(path):
            RunFolder.add(self._folder, name, spec, prepared.bundle)
        return plan

    def _scene_of(self, run: str, spec: RunSpec) -> PreparedScene:
        key, known = self._keys.get(run, ""), self._scene
        if known is None or any(getattr(known[0], name) != getattr(spec, name) for name in SCENE_KEYS):
            shape = self._shapes.get(key) if key else None
            self._scene = known = spec, prepare_scene(spec, shape)
        return known[1]


def begin_campaign(path: Path, asked: Campaign, job: str | None = None) -> JobExtent:
    """Begin the campaign that is asked for at `path`, or check that it can go on there.

    `job` is the job's name for a new folder; None: the folder's name, reduced to the allowed characters.
    Raises FolderError or InputError, and leaves the folder as it was, if it holds a single run, another job,
    other files, runs that are not asked for any more, or one that is asked for with another spec or with less
    than it has; or if it is in use.
    """
    if not JobFolder.is_job(path):
        OutFolder(path).check()
        RunFolder.check_outside(path)
        files = new_job(path, job) | {CAMPAIGN: asked.toml.encode()}
        if asked.skipped:
            files |= {SKIPPED: skip_report(asked.skipped)}
        outputs.create_folder(path, files, folders=[LOGS, RUNS])
        return CampaignRunQueue(None, asked.runs).extent
    folder = open_campaign(path)
    if job not in (None, folder.name):
        raise FolderError(f"{path} is of job '{folder.name}', not '{job}'; leave --job out.")
    folder.check_not_in_use()
    _check_kept(folder, asked)
    extent = CampaignRunQueue(folder, asked.runs).extent
    file = folder.path / CAMPAIGN
    if file.read_bytes() != asked.toml.encode():
        outputs.replace(file, asked.toml.encode())
    if asked.skipped is not None and (asked.skipped or (folder.path / SKIPPED).is_file()):
        outputs.replace(folder.path / SKIPPED, skip_report(asked.skipped))
    return extent


def open_campaign(path: Path) -> JobFolder:
    """Open the folder of a campaign that was begun; raises FolderError if it holds none."""
    folder = JobFolder.open(path)
    if not folder.is_campaign:
        raise FolderError(f"{path} holds a single run, no campaign; name the folder of a campaign.")
    return folder


def _check_kept(folder: JobFolder, asked: Campaign) -> None:
    file = folder.path / CAMPAIGN
    if not file.is_file():
        raise FolderError(
            f"{folder.path} is what a recorder keeps of a campaign, without its {CAMPAIGN}; name another "
            "folder with --out."
        )
    if file.read_bytes() == asked.toml.encode():
        return
    lost = [name for name in read_campaign(file).runs if name not in asked.runs]
    if lost:
        lacking = counted(len(lost), "run that is", "runs that are")
        raise FolderError(
            f"{folder.path} is of a campaign with {lacking} not asked for any more, such as "
            f"'{lost[0]}'; leave them in the file, or name another folder with --out. "
            f"`qdgrasp campaign {folder.path}` goes on with the campaign as it was."
        )
