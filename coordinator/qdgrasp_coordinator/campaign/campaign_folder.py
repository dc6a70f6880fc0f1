"""The folder of a campaign: begun, or gone on with, and a queue of its unfinished runs.

The end of a run that has begun may be put off, not taken back below what is recorded. The totals of a
finished run are cached beside its journal (`found.json`), so that a large campaign need not read it again.
"""

import csv
import re
from collections import Counter, deque
from collections.abc import Mapping
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path

import msgspec
from msgspec import Struct, structs

from qdgrasp_coordinator.campaign.campaign_file import (
    LARGEST_CAMPAIGN,
    TAKEN_FOR_GRANTED,
    Campaign,
    read_campaign,
)
from qdgrasp_coordinator.campaign.object_library import skip_report
from qdgrasp_coordinator.campaign.summary import run_summary
from qdgrasp_coordinator.metrics.run_stats import TOTAL_NAMES, RunCounter, RunTotals, count_rows
from qdgrasp_coordinator.scheduler.run_plan import JobExtent, RunPlan, plan_run, prepare_scene
from qdgrasp_coordinator.search.registry import check_spec
from qdgrasp_coordinator.storage import atomic_files
from qdgrasp_coordinator.storage.job_folder import JobFolder, JobRecord
from qdgrasp_coordinator.storage.outputs import CAMPAIGN, LOGS, RUNS, SKIPPED, OutFolder
from qdgrasp_coordinator.storage.run_folder import PreparedScene, RunFolder
from qdgrasp_protocol.errors import DiskFull, EndsTooSoon, FolderError, ImpossibleValue, InputError, RunFailed
from qdgrasp_protocol.spec import STOP_KEYS, RunSpec, differences, read_run_spec, run_spec, to_values
from qdgrasp_protocol.text import counted


def extend_run(folder: RunFolder, **goals: int) -> None:
    """Give a run a new budget, or other stop criteria: any of `spec.STOP_KEYS`.

    Raises ImpossibleValue if one is not allowed, or the journal goes on behind it.
    """
    spec = run_spec(to_values(folder.spec) | goals, "resume")
    count_within_budget(folder, spec, "--evaluations")
    folder.rewrite_spec(spec)


def count_within_budget(folder: RunFolder, spec: RunSpec, where: str = "evaluations") -> RunCounter:
    """Count a run's journal; raises ImpossibleValue unless it begins a journal of `spec`."""
    check_spec(spec)
    with folder.journal() as journal:
        found = count_rows(spec, journal.blocks())
    found.check_budget(spec, where)
    return found


TOTALS_FILE = "found.json"
DIGITS = re.compile(r"-?\d+(?:\.\d+)?(?:e-?\d+)?|'[^']*'")
"""Numbers and names, which reasons are told apart without."""
SCENE_KEYS = (
    *("gripper", "object", "mass", "scale", "friction", "mesh", "about"),
    *("protocol", "base", "engine", "surface_seed"),
)
"""The keys of a spec that its scene depends on."""


class CachedTotals(Struct, frozen=True):
    """Totals of a finished run, with the mark of what they depend on."""

    mark: str
    totals: RunTotals


def read_cached_totals(folder: RunFolder, spec: RunSpec) -> RunTotals | None:
    """Return the stored totals of a run that was finished under `spec`; None: not known."""
    file = folder.path / TOTALS_FILE
    if file.is_file():
        with suppress(FolderError, msgspec.MsgspecError):
            known = msgspec.json.decode(atomic_files.read(file), type=CachedTotals)
            if known.mark == _journal_mark(folder, spec):
                return known.totals
    return None


def _write_cached_totals(folder: RunFolder, spec: RunSpec, totals: RunTotals) -> None:
    """Store the totals of a finished run; a disk that cannot take them is no error."""
    with suppress(FolderError):
        cached = CachedTotals(_journal_mark(folder, spec), totals)
        atomic_files.replace(folder.path / TOTALS_FILE, msgspec.json.encode(cached))


def _journal_mark(folder: RunFolder, spec: RunSpec) -> str:
    """Return the mark of all that the totals depend on: rows, goals, version, names of counts."""
    with folder.journal() as journal:
        ends = [str(getattr(spec, key)) for key in STOP_KEYS]
        return " ".join([journal.mark, *ends, version("qdgrasp"), *TOTAL_NAMES])


def finished_totals(path: Path, spec: RunSpec) -> RunTotals | None:
    """Return the totals of the run that `spec` asks for, where its folder holds all of it.

    None: it is not finished, or its journal cannot be read; the recorder that opens it says why. Raises
    FolderError or EndsTooSoon where the folder holds a run of another spec, more evaluations than the budget,
    or successes alone of fewer; ImpossibleValue where the spec in its journal is none of this version.
    """
    if not RunFolder.is_run(path):
        return None
    folder = RunFolder.open(path)
    if differ := differences(folder.spec, spec):
        raise FolderError(f"{path} holds a run of another spec ({', '.join(differ)}); name another folder.")
    try:
        with folder.journal() as journal:
            is_reduced = bool(journal.sources)
        if not is_reduced:
            if known := read_cached_totals(folder, spec):
                return known
            try:
                found = count_within_budget(folder, spec)
            except ImpossibleValue as reason:
                raise EndsTooSoon(folder.path, reason) from None
            if found.finished:
                _write_cached_totals(folder, spec, found.totals)
            return found.totals if found.finished else None
    except FolderError:
        return None
    if any(getattr(folder.spec, key) != getattr(spec, key) for key in STOP_KEYS):
        raise FolderError(f"{path} was pruned, so that it cannot be gone on with; name another folder.")
    return run_summary(folder).totals


class CampaignRunQueue:
    """The unfinished runs of a campaign, each made when it is next.

    Without a `folder` nothing is known of recorded runs, and no folders are made; `runs` are specs by name.
    Raises FolderError or EndsTooSoon if a run's folder holds another run, or more evaluations than its
    budget.
    """

    def __init__(self, folder: JobFolder | None, runs: Mapping[str, RunSpec]) -> None:
        self._folder = folder
        self._runs = runs
        finished = {
            name: found
            for name, spec in runs.items()
            if folder and (found := finished_totals(folder.run_path(name), spec)) is not None
        }
        self.extent = JobExtent.of({name: spec.evaluations for name, spec in runs.items()}).with_done(
            finished
        )
        self._left = deque(self.extent.budgets)
        self._scene: tuple[RunSpec, PreparedScene] | None = None

    def next(self) -> RunPlan | None:
        """Return the next unfinished run, with a folder of its own.

        Raises RunFailed if its scene cannot be built or its folder not be written, and DiskFull if there is
        no room for the folder; it then stays the next.
        """
        if not self._left:
            return None
        name = self._left.popleft()
        try:
            return self._prepare(name, self._runs[name])
        except DiskFull:
            self.put_back(name)
            raise
        except InputError as error:
            raise RunFailed(name, str(error)) from None

    def put_back(self, run: str) -> None:
        """Have a run made again, before any other."""
        self._left.appendleft(run)

    def _prepare(self, name: str, spec: RunSpec) -> RunPlan:
        path = self._folder.run_path(name) if self._folder else None
        if path is not None and RunFolder.is_run(path) and RunFolder(path).has_bundle():
            return plan_run(spec, RunFolder(path).prepared_scene(), name)
        prepared = self._scene_of(spec)
        if self._folder is not None and path is not None and not RunFolder.is_run(path):
            RunFolder.add(self._folder, name, spec, prepared.bundle)
        return plan_run(spec, prepared, name)

    def _scene_of(self, spec: RunSpec) -> PreparedScene:
        known = self._scene
        if known is None or any(getattr(known[0], key) != getattr(spec, key) for key in SCENE_KEYS):
            self._scene = known = spec, prepare_scene(spec)
        return known[1]


def begin_campaign(path: Path, asked: Campaign, job: str | None = None) -> JobExtent:
    """Begin the campaign that is asked for at `path`, or check that it can go on there.

    `job` is the job's name for a new folder; None: the folder's name, reduced to the allowed characters.
    Raises FolderError or EndsTooSoon, and leaves the folder as it was, if it holds a single run, another job,
    other files, runs that are not asked for any more, or one that is asked for with another spec or with less
    than it has; or if it is in use.
    """
    if not JobFolder.is_job(path):
        OutFolder(path).check()
        RunFolder.check_outside(path)
        files = JobRecord.begun(path, job).file | {CAMPAIGN: asked.toml.encode()}
        if asked.skipped:
            files |= {SKIPPED: skip_report(asked.skipped)}
        atomic_files.create_folder(path, files, folders=[LOGS, RUNS])
        return CampaignRunQueue(None, asked.runs).extent
    folder = open_campaign(path)
    if job not in (None, folder.name):
        raise FolderError(f"{path} is of job '{folder.name}', not '{job}'; leave --job out.")
    folder.check_not_in_use()
    _check_kept(folder, asked)
    extent = CampaignRunQueue(folder, asked.runs).extent
    file = folder.path / CAMPAIGN
    if file.read_bytes() != asked.toml.encode():
        atomic_files.replace(file, asked.toml.encode())
    if asked.skipped is not None and (asked.skipped or (folder.path / SKIPPED).is_file()):
        atomic_files.replace(folder.path / SKIPPED, skip_report(asked.skipped))
    return extent


class CampaignSummary(Struct, frozen=True, kw_only=True):
    """Counts of a campaign: what is asked for, what is finished, and what was left out."""

    campaign: str
    runs: int
    runs_done: int
    objects: int
    evaluations: int
    """Sum of the budgets of all runs."""
    evaluations_done: int
    """Evaluations of finished runs."""
    successes: int
    """Successes of finished runs; `grasps` are those that survived a disturbance."""
    grasps: int
    skipped: int
    """Objects that cannot be used, and are left out."""
    reasons: dict[str, int]
    """Number of objects left out for each reason, the most frequent first; numbers in it are left out."""

    @property
    def table(self) -> str:
        """All counts, one to a line."""
        values = structs.asdict(self)
        reasons = values.pop("reasons")
        lines = [f"{name.replace('_', ' '):<16} {value}" for name, value in values.items()]
        lines += [f"{'left out':<16} {count}: {reason}" for reason, count in reasons.items()]
        return "\n".join(lines)


def campaign_summary(folder: JobFolder) -> CampaignSummary:
    """Count what a campaign asks for, has finished and left out, also while it goes on."""
    asked = read_campaign(folder.path / CAMPAIGN, here=False, is_begun=True)
    extent = CampaignRunQueue(folder, asked.runs).extent
    report, reasons = folder.path / SKIPPED, Counter[str]()
    if report.is_file():
        rows = csv.DictReader(atomic_files.read(report).decode(errors="replace").splitlines())
        reasons.update(DIGITS.sub("N", row.get("reason") or "") for row in rows)
    return CampaignSummary(
        campaign=folder.name,
        runs=extent.runs,
        runs_done=extent.runs_done,
        objects=len({spec.object for spec in asked.runs.values()}),
        evaluations=extent.evaluations,
        evaluations_done=extent.done.evaluations,
        successes=extent.done.successes,
        grasps=extent.done.grasps,
        skipped=reasons.total(),
        reasons=dict(reasons.most_common()),
    )


def open_campaign(path: Path) -> JobFolder:
    """Open the folder of a campaign that was begun; raises FolderError if it holds none."""
    folder = JobFolder.open(path)
    if not folder.is_campaign:
        raise FolderError(f"{path} holds a single run, no campaign; name the folder of a campaign.")
    return folder


def defaults_left_out(path: Path) -> frozenset[str]:
    """Return the keys of `TAKEN_FOR_GRANTED` that a folder's campaign lacks; none without one."""
    file = path / CAMPAIGN
    if not file.is_file():
        return frozenset()
    return frozenset(
        TAKEN_FOR_GRANTED.keys() - read_run_spec(file, LARGEST_CAMPAIGN).get("defaults", {}).keys()
    )


def _check_kept(folder: JobFolder, asked: Campaign) -> None:
    lost = [
        name for name in read_campaign(folder.path / CAMPAIGN, is_begun=True).runs if name not in asked.runs
    ]
    if lost:
        lacking = counted(len(lost), "run that is", "runs that are")
        raise FolderError(
            f"{folder.path} is of a campaign with {lacking} not asked for any more, such as "
            f"'{lost[0]}'; leave them in the file, or name another folder with --out. "
            f"`qdgrasp campaign {folder.path}` goes on with the campaign as it was."
        )
