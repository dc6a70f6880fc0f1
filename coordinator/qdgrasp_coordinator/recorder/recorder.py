"""Decides what a recorder does: opens runs, takes rows, commits them in groups, reports.

Decided without a thread or a clock (docs/bus.md, rule 8); time is passed in, in seconds of any steady clock.
The state of a run is read from its folder, so a recorder that was started again goes on with any run.

A run is reported at once when there is news of it, and then each second for a while after its last message:
a report may be lost. No later report is due: a coordinator that still misses one sends its rows again, and
these are news.
"""

import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from math import inf
from pathlib import Path

import structlog

from qdgrasp_coordinator.recorder.recorded_job import LockedJobFolder, RunIdentity, check_same_run
from qdgrasp_coordinator.recorder.run_writer import Arrival, RunWriter
from qdgrasp_coordinator.storage.finished_runs import FinishedRuns
from qdgrasp_coordinator.storage.job_folder import RUN
from qdgrasp_coordinator.storage.journal import Journal, slice_from_message, slice_to_message
from qdgrasp_coordinator.storage.journal_writer import FirstEpoch, OpenJournals
from qdgrasp_coordinator.storage.outputs import JOURNAL, SPEC, OutFolder
from qdgrasp_coordinator.storage.platforms import platform_differences, platform_of
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol import messages
from qdgrasp_protocol.bus import DropCounter, Query, Sample
from qdgrasp_protocol.errors import DiskFull, FolderError, InputError, MessageError, NoReply, Refused
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.messages import Log, Open, Opened, Platform, Recordable, Recorded, shorten
from qdgrasp_protocol.spec import read_run_spec

log = structlog.get_logger()

RETRY_INTERVAL = 1.0  # Seconds between two tries to write on a full disk


class DiskSpaceRetry:
    """State of a folder's disk, full or not, as writes have shown; waits `limit` seconds."""

    def __init__(self, path: Path, limit: float) -> None:
        self._path = path
        self._limit = limit
        self._since: float | None = None
        self.trouble = ""  # Reason why nothing can be written; empty when it can
        self.try_at = -inf  # When to try to write again

    def on_full(self, reason: str, now: float, command: str) -> None:
        """Note that a write did not fit; raise `DiskFull` when nothing has fitted for too long.

        Once there is room, `command` goes on with the job.
        """
        if self._since is None:
            self._since = now
        elif now - self._since > self._limit:
            raise DiskFull(
                f"{self._path} has had no room for {self._limit:g} s; make room, then `{command}` goes on."
            )
        self.trouble = reason
        self.try_at = now + RETRY_INTERVAL

    def on_written(self) -> None:
        """Note that something was written."""
        self._since, self.trouble, self.try_at = None, "", -inf


REPORT_INTERVAL = 1.0  # Seconds between two reports of a run when nothing happens
REPORT_SECONDS = 10.0  # Seconds for which a run is reported after its last message


class ReportSchedule:
    """Schedule of the reports of runs."""

    def __init__(self) -> None:
        self._due: dict[str, float] = {}
        self._until: dict[str, float] = {}

    def keep_reporting(self, run: str, now: float) -> None:
        """Report a run each second for a while."""
        self._due.setdefault(run, now + REPORT_INTERVAL)
        self._until[run] = now + REPORT_SECONDS

    def report_now(self, run: str, now: float) -> None:
        """Report a run at once."""
        self._due[run] = now
        self._until[run] = now + REPORT_SECONDS

    def report_all(self, now: float) -> None:
        """Make every remembered run due at once."""
        self._due = dict.fromkeys(self._due, now)

    def has(self, run: str) -> bool:
        """Return whether another report of a run is due at some time."""
        return run in self._due

    @property
    def deadline(self) -> float:
        """When the next report is due; infinite if there is no next one."""
        return min(self._due.values(), default=inf)

    def due(self, now: float) -> list[str]:
        """The runs to report now; they count as reported."""
        runs = [run for run, at in self._due.items() if at <= now]
        for run in runs:
            if now + REPORT_INTERVAL <= self._until[run]:
                self._due[run] = now + REPORT_INTERVAL
            else:
                del self._due[run], self._until[run]
        return runs


COMMITS_AT_ONCE = 8  # Most runs that are committed between two looks at queries: an opening waits for one
OPEN_JOURNALS = 64  # Most journals open at once, of three files each; reopening costs a few commits
MOST_PAGE_ITEMS = 1 << 18  # Numbers in the widest column of a page: 1 MB, the most that a message may have


@contextmanager
def open_recorder(
    path: Path, job: str, disk_wait: float, now: float, open_journals: int = OPEN_JOURNALS
) -> Iterator["Recorder"]:
    """Lock the folder of a job, there or to be created, and record its runs in this context.

    It is a run's own folder where the run is named `RUN`, else a campaign's. A full disk is waited for
    `disk_wait` seconds; at most `open_journals` journals are open at once.
    """
    with LockedJobFolder(path, job) as folder, OpenJournals(open_journals) as journals:
        yield Recorder(folder, journals, disk_wait, now)


class Recorder:
    """Records the runs of a job, of one epoch and one platform, from messages, queries and time.

    Any method that is passed the time raises `DiskFull` when the disk was full for too long.
    """

    def __init__(self, folder: LockedJobFolder, journals: OpenJournals, disk_wait: float, now: float) -> None:
        self._folder = folder
        self._journals = journals
        self._keys = Keys(folder.job)
        self._disk = DiskSpaceRetry(folder.folder.path, disk_wait)
        self._drops = DropCounter()
        self._reports = ReportSchedule()
        self._rows_not_taken: Counter[Arrival] = Counter()
        self.writers: dict[str, RunWriter] = {}
        """Writers of runs by name; other runs, also finished ones, may be in the folder."""
        self._waiting: dict[str, RunWriter] = {}
        self._without_scene: dict[str, RunWriter] = {}
        self._finished = FinishedRuns(folder.folder.path)
        self._find(RUN)
        self._platform = self._recorded_platform()
        for run in self.writers:
            self._reports.keep_reporting(run, now)

    @property
    def epoch(self) -> int:
        """Epoch of the coordinator whose rows are taken."""
        return self._folder.epoch

    def take(self, sample: Sample, now: float) -> None:
        """Process a message; ignore those of other kinds."""
        try:
            if sample.encoding == messages.encoding(Recordable):
                self._take_rows(messages.decode(sample.payload, Recordable), now)
            elif sample.encoding == messages.encoding(Platform):
                self.set_platform(messages.decode(sample.payload, Platform))
        except (MessageError, Refused) as error:
            self._drops.note(sample.key, error)

    def _take_rows(self, message: Recordable, now: float) -> None:
        arrival = self.add_rows(message, now)
        if arrival is Arrival.TAKEN:
            self._reports.keep_reporting(message.run, now)
        else:
            self._rows_not_taken[arrival] += message.n
            self._reports.report_now(message.run, now)

    def add_rows(self, message: Recordable, now: float) -> Arrival:
        """Queue rows for their commit; a run that was not opened, or another row shape, is refused."""
        writer = self._writer(message.run)
        if message.epoch < self.epoch:
            return Arrival.STALE
        arrival = writer.add(slice_from_message(message, writer.identity.shape), message.epoch, now)
        self._folder.epoch = message.epoch
        if arrival is Arrival.TAKEN:
            self._waiting[message.run] = writer
        return arrival

    def set_platform(self, message: Platform) -> None:
        """Set the platform of rows to come; a journal gets it before its next rows."""
        if message.epoch >= self.epoch and message.platform:
            self._platform = message.platform

    def answer(self, query: Query, now: float) -> bytes:
        """Open runs, or show recorded rows; else raise `Refused`, or `NoReply` for want of room now."""
        try:
            if query.key == self._keys.open:
                return messages.encode(self._answer_open(messages.decode(query.payload, Open), now))
            return messages.encode(self.page(messages.decode(query.payload, Log)))
        except DiskFull as full:
            self._on_disk_full(full, now)
            raise NoReply(str(full)) from None
        except (InputError, MessageError, Refused) as error:
            raise Refused(str(error).removesuffix(".")) from None

    def _answer_open(self, asked: Open, now: float) -> Opened:
        opened = self.open(asked)
        self._on_disk_written(now)
        for run, rows in zip(asked.runs, opened.durable, strict=True):
            self._reports.keep_reporting(run.run, now)
            log.info("opened", run=run.run, epoch=opened.epoch, rows=rows)
        return opened

    def page(self, asked: Log) -> Recordable:
        """Return recorded rows of a run as a message; a run that was never opened is refused."""
        writer = self._writer(asked.run)
        shape = writer.identity.shape
        widest = max(shape.genes, shape.joints, shape.descriptors, shape.contact_values, 7)
        limit = min(asked.limit, MOST_PAGE_ITEMS // widest)
        return slice_to_message(writer.journal.slice(asked.first, limit), asked.run, self.epoch, shape)

    def open(self, asked: Open) -> Opened:
        """Open runs for a coordinator, all or none; missing folders and journals are created.

        Without runs only an epoch begins: a campaign whose runs wait for shapes.

        Raises `Refused` where the coordinator was replaced, a run is not the one that its folder holds, or it
        was recorded on another platform; `FolderError` or `DiskFull` where something cannot be written; and
        `InputError` where a spec is not valid, or its run is to end before what is recorded of it.
        """
        self._folder.check(asked)
        runs = [RunIdentity.of(run) for run in asked.runs]
        for run in runs:
            self._check(run)
        goes_on = 0 < asked.epoch == self.epoch
        platform = self._common_platform(self._platform if goes_on else self._recorded_platform(), runs)
        self._folder.begin(runs[0] if runs else None)
        if not goes_on:
            self._begin_epoch(asked.epoch or self.epoch + 1)
        self._folder.store_epoch()
        self._platform = platform
        durable = [self._open(run).durable for run in runs]
        identity = self._folder.folder.identity
        return Opened(epoch=self.epoch, durable=durable, platform=platform, identity=identity)

    def _check(self, run: RunIdentity) -> None:
        """Check that a run's folder holds a beginning of this run, or nothing."""
        path = self._folder.folder.run_path(run.run)
        writer = self._find(run.run)
        if writer is not None:
            check_same_run(path, writer.identity, run)
            writer.check_end(run.spec)
        elif RunFolder.is_run(path):
            folder = RunFolder(path)
            scene = folder.bundle().digest if folder.has_bundle() else run.scene
            check_same_run(path, replace(run, spec=folder.spec, scene=scene), run)
        else:
            OutFolder(path).check()

    def _common_platform(self, platform: dict[str, str], runs: list[RunIdentity]) -> dict[str, str]:
        for run in runs:
            writer = self._find(run.run)
            recorded = writer.platform if writer else {}
            if platform and recorded and (differing := platform_differences(platform, recorded)):
                raise Refused(
                    f"run '{run.run}' was recorded on another platform than the job's rows: {differing}"
                )
            platform = recorded | platform
        return platform

    def _recorded_platform(self) -> dict[str, str]:
        """The platform of the runs in the folder that have rows: those of one engine have the same."""
        platforms: dict[str | None, dict[str, str]] = {}
        self._finished.refresh()
        engines = self._finished.engines()
        for path in self._folder.run_paths:
            with suppress(FolderError, InputError):
                name = path.name
                engine = engines[name] if name in engines else read_run_spec(path / SPEC).get("engine")
                if engine not in platforms:
                    with Journal.open(path) as journal:
                        if journal.platform:
                            platforms[engine] = dict(journal.platform)
        return {name: value for platform in platforms.values() for name, value in platform.items()}

    def _begin_epoch(self, epoch: int) -> None:
        """Begin an epoch: rows of the one before are committed as far as there is room."""
        for run in list(self._waiting):
            with suppress(FolderError):
                self.commit(run)
        for writer in self.writers.values():
            writer.forget_waiting(epoch)
        self._waiting.clear()
        self._folder.epoch = epoch

    def _open(self, run: RunIdentity) -> RunWriter:
        job = self._folder.folder
        path = job.run_path(run.run)
        if not RunFolder.is_run(path):
            RunFolder.add(job, run.run, run.spec, None)
        if (path / JOURNAL).is_file():
            writer = self._writer(run.run)
            writer.begin_epoch(run.spec, self.epoch)
            return writer
        platform = platform_of(run.spec.engine, self._platform)
        self._journals.begin(path, run.for_journal, FirstEpoch(self.epoch, time.time(), platform))
        return self._keep(RunWriter(RunFolder(path), self._journals, self.epoch, run, platform))

    def _writer(self, run: str) -> RunWriter:
        writer = self._find(run)
        if writer is None:
            raise Refused(f"{self._folder.folder.path} holds no journal of run '{run}': it was not opened")
        return writer

    def _find(self, run: str) -> RunWriter | None:
        """Return a run's writer; None: it has no journal."""
        path = self._folder.folder.run_path(run)
        if run not in self.writers and (path / JOURNAL).is_file():
            self._keep(RunWriter(RunFolder(path), self._journals, self.epoch))
        return self.writers.get(run)

    def _keep(self, writer: RunWriter) -> RunWriter:
        self.writers[writer.identity.run] = writer
        if not writer.has_scene:
            self._without_scene[writer.identity.run] = writer
        return writer

    @property
    def deadline(self) -> float:
        """When `step` has something to do if nothing comes before; infinite: never."""
        return min(self._commit_at, self._reports.deadline)

    def step(self, now: float) -> list[Recorded]:
        """Commit what is due; gives the reports that are."""
        if now >= self._commit_at:
            try:
                self._commit_due(now, now, COMMITS_AT_ONCE)
            except DiskFull as full:
                self._on_disk_full(full, now)
            else:
                self._on_disk_written(now)
        return self._due_reports(now)

    def close(self, now: float) -> list[Recorded]:
        """Commit what waits, if there is room; gives the last reports."""
        with suppress(DiskFull):
            self._commit_due(inf, now)
        return self._due_reports(now)

    @property
    def commit_deadline(self) -> float:
        """When the next rows are to be committed; infinite if none wait."""
        return min((writer.deadline for writer in self._waiting.values()), default=inf)

    def due(self, now: float) -> list[str]:
        """The runs whose waiting rows are to be committed by now."""
        return [run for run, writer in self._waiting.items() if writer.deadline <= now]

    def commit(self, run: str) -> None:
        """Make a run's waiting rows durable; on a full disk (`DiskFull`) they go on waiting."""
        writer = self.writers[run]
        self._folder.store_epoch()
        writer.commit(self._platform)
        self._waiting.pop(run, None)
        if run != RUN and (listing := writer.finished) is not None:
            path = self._folder.folder.run_path(run)
            self._journals.close(path)  # its files are as they stay
            self._finished.add(path, writer.identity.spec, listing)

    @property
    def _commit_at(self) -> float:
        return max(self.commit_deadline, self._disk.try_at)

    def _commit_due(self, by: float, now: float, most: int | None = None) -> None:
        for run in self.due(by)[:most]:
            self.commit(run)
            self._reports.report_now(run, now)

    def _on_disk_full(self, full: DiskFull, now: float) -> None:
        """Report that the disk is full, and try again soon; give up when it was full for too long."""
        if not self._disk.trouble:
            log.warning("the disk is full; trying again until there is room", reason=str(full))
        self._disk.on_full(shorten(str(full)), now, self._folder.folder.resume_command)
        for run in self._waiting:
            self._reports.report_now(run, now)

    def _on_disk_written(self, now: float) -> None:
        if self._disk.trouble:
            log.info("there is room again", folder=str(self._folder.folder.path))
            self._reports.report_all(now)
        self._disk.on_written()

    def _due_reports(self, now: float) -> list[Recorded]:
        for arrival, rows in self._rows_not_taken.items():
            log.info("rows not taken", reason=arrival.value, rows=rows)
        self._rows_not_taken.clear()
        reports = [self._report(run) for run in self._reports.due(now)]
        for report in reports:
            if not self._reports.has(report.run):
                self._forget(report.run)
        return reports

    def _forget(self, run: str) -> None:
        """Forget a run that is finished and not heard of any more; it is found again in its folder."""
        if self.writers[run].finished and run not in self._waiting and run not in self._without_scene:
            del self.writers[run]

    def _report(self, run: str) -> Recorded:
        durable, trouble = self.writers[run].durable, self._disk.trouble
        return Recorded(epoch=self.epoch, run=run, durable=durable, trouble=trouble)

    @property
    def missing_scenes(self) -> list[str]:
        """The digests of scenes whose bundles are not in the folders of their runs yet."""
        return sorted({writer.identity.scene for writer in self._without_scene.values()})

    def add_scene(self, digest: str, payload: bytes) -> None:
        """Store a scene's bundle where it is missing."""
        for run, writer in list(self._without_scene.items()):
            if writer.identity.scene == digest:
                writer.add_scene(payload)
                del self._without_scene[run]
