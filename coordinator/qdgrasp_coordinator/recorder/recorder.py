"""Decides what a recorder does: opens runs, takes rows, commits them in groups, reports.

Decided without a thread or a clock (docs/bus.md, rule 8); time is passed in, in seconds of any steady clock.
The state of a run is read from its folder, so a recorder that was started again goes on with any run.

A run is reported when there is news of it, and only then: a coordinator that misses a report sends its rows
again, and these are news.
"""

import time
from contextlib import ExitStack, suppress
from dataclasses import replace
from math import inf
from pathlib import Path

import structlog

from qdgrasp_coordinator.recorder.run_writer import RunWriter, check_same_run
from qdgrasp_coordinator.storage.finished_runs import FinishedRuns
from qdgrasp_coordinator.storage.job_folder import RUN, JobFolder
from qdgrasp_coordinator.storage.journal import Journal, JournalIdentity, slice_from_message, slice_to_message
from qdgrasp_coordinator.storage.journal_writer import OpenJournals
from qdgrasp_coordinator.storage.outputs import JOURNAL, SPEC, OutFolder
from qdgrasp_coordinator.storage.platforms import platform_differences
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol import messages
from qdgrasp_protocol.bus import DropCounter, Query, Sample
from qdgrasp_protocol.errors import (
    DiskFull,
    FolderError,
    InputError,
    MessageError,
    NoReply,
    Refused,
    TookOver,
)
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.messages import Log, Open, Opened, Recordable, Recorded, shorten
from qdgrasp_protocol.spec import read_run_spec

log = structlog.get_logger()

RETRY_INTERVAL = 1.0  # Seconds between two tries to write on a full disk
COMMITS_AT_ONCE = 8  # Most runs that are committed between two looks at queries: an opening waits for one
OPEN_JOURNALS = 64  # Most journals open at once, of three files each; reopening costs a few commits
MOST_PAGE_ITEMS = 1 << 18  # Numbers in the widest column of a page: 1 MB, the most that a message may have


JOB_KINDS = ("a run of its own", "a campaign")


class Recorder(ExitStack):
    """Records the runs of a job, of one epoch and one platform, from messages, queries and time.

    A context manager that holds the lock of the job's folder, there or to be created: a run's own folder
    where the run is named `RUN`, else a campaign's. A full disk is waited for `disk_wait` seconds.

    A `FolderError` says that the folder is another job's, in use, holds other files, or cannot be read. Any
    method that is passed the time raises `DiskFull` when the disk was full for too long.
    """

    def __init__(self, path: Path, job: str, disk_wait: float, journals: OpenJournals) -> None:
        super().__init__()
        self.folder = JobFolder(path)
        self.epoch = 0  # Epoch of the coordinator whose rows are taken; `_store_epoch` writes it
        self._job = job
        self._is_begun = False  # The folder is there
        self._journals = journals
        self._keys = Keys(job)
        self._disk_wait = disk_wait
        self._full_since = inf  # When a write first found the disk full; infinite: the last one fitted
        self._try_at = -inf  # When to try to write again
        self._trouble = ""  # Reason why nothing can be written; empty when it can
        self._drops = DropCounter()
        self._news: set[str] = set()  # Runs that are to be reported
        self.writers: dict[str, RunWriter] = {}
        """Writers of runs by name; other runs, also finished ones, may be in the folder."""
        self._waiting: dict[str, RunWriter] = {}
        self._without_scene: dict[str, RunWriter] = {}
        self._finished = FinishedRuns(path)
        self._lock_existing()
        self._find(RUN)
        self._platform = self._recorded_platform()

    def _lock_existing(self) -> None:
        folder = self.folder
        if not JobFolder.is_job(folder.path):
            OutFolder(folder.path).check()
            return
        if folder.name != self._job:
            raise FolderError(
                f"{folder.path} is of job '{folder.name}', not '{self._job}'; say --job {folder.name}."
            )
        self._take_lock()

    def _take_lock(self) -> None:
        self.enter_context(self.folder.lock())
        self._is_begun = True
        self.epoch = max(self.epoch, self.folder.epoch)

    def take(self, sample: Sample, now: float) -> None:
        """Process a message; ignore those of other kinds."""
        try:
            if sample.encoding == messages.encoding(Recordable):
                message = messages.decode(sample.payload, Recordable)
                if not self.add_rows(message, now):
                    self._news.add(message.run)
        except (MessageError, Refused) as error:
            self._drops.note(sample.key, error)

    def add_rows(self, message: Recordable, now: float) -> bool:
        """Queue rows for their commit; False: not taken.

        A run that was not opened, or another row shape, is refused.
        """
        writer = self._writer(message.run)
        if message.epoch < self.epoch:
            return False
        is_taken = writer.add(slice_from_message(message, writer.identity.shape), message.epoch, now)
        self.epoch, self._platform = message.epoch, message.platform or self._platform
        if is_taken:
            self._waiting[message.run] = writer
        return is_taken

    def answer(self, query: Query, now: float) -> bytes:
        """Open runs, or show recorded rows; else raise `Refused`, or `NoReply` for want of room now."""
        try:
            if query.key == self._keys.open:
                opened = self.open(messages.decode(query.payload, Open))
                self._on_disk_written()
                return messages.encode(opened)
            return messages.encode(self.page(messages.decode(query.payload, Log)))
        except DiskFull as full:
            self._on_disk_full(full, now)
            raise NoReply(str(full)) from None
        except (InputError, MessageError, Refused) as error:
            raise Refused(str(error).removesuffix(".")) from None

    def page(self, asked: Log) -> Recordable:
        """Return recorded rows of a run as a message; a run that was never opened is refused."""
        writer = self._writer(asked.run)
        shape = writer.identity.shape
        widest = max(shape.genes, shape.joints, shape.contact_values, 7)
        limit = min(asked.limit, MOST_PAGE_ITEMS // widest)
        return slice_to_message(writer.journal.slice(asked.first, limit), asked.run, self.epoch, shape)

    def open(self, asked: Open) -> Opened:
        """Open runs for a coordinator, all or none; missing folders and journals are created.

        Without runs only an epoch begins: a campaign whose runs wait for shapes.

        Raises `Refused` where the coordinator was replaced, a run is not the one that its folder holds, or it
        was recorded on another platform; `FolderError` or `DiskFull` where something cannot be written; and
        `InputError` where a spec is not valid.
        """
        self._check_request(asked)
        runs = [JournalIdentity.of(run) for run in asked.runs]
        for run in runs:
            self._check_run(run)
        goes_on = 0 < asked.epoch == self.epoch
        platform = self._common_platform(self._platform if goes_on else self._recorded_platform(), runs)
        self._begin_folder(runs)
        if not goes_on:
            self._begin_epoch(asked.epoch or self.epoch + 1)
        self._store_epoch()
        self._platform = platform
        writers = list(map(self._open, runs))
        for writer, each in zip(writers, asked.runs, strict=True):
            if each.excluded:
                writer.exclude(set(each.excluded))
        durable = [writer.durable for writer in writers]
        log.info("opened", runs=[run.run for run in runs], epoch=self.epoch, rows=durable)
        identity = self.folder.identity
        return Opened(epoch=self.epoch, durable=durable, platform=platform, identity=identity)

    def _check_request(self, asked: Open) -> None:
        """Refuse runs that may not be opened here, now, and at once."""
        runs = [run.run for run in asked.runs]
        if asked.job != self._job:
            raise Refused(f"this recorder keeps the runs of job '{self._job}', not of '{asked.job}'")
        if 0 < asked.epoch < self.epoch:
            raise Refused(f"epoch {asked.epoch} is over: {TookOver.BY} {self.epoch}")
        is_campaign = RUN not in runs
        if self._is_begun and self.folder.is_campaign != is_campaign:
            raise Refused(
                f"{self.folder.path} holds {JOB_KINDS[not is_campaign]}, the coordinator opens "
                f"{JOB_KINDS[is_campaign]}; name another folder"
            )

    def _begin_folder(self, runs: list[JournalIdentity]) -> None:
        """Create the job's folder if it is missing, for a run of its own or for others."""
        if self._is_begun:
            return
        if runs and runs[0].run == RUN:
            RunFolder.create(self.folder.path, runs[0].spec, None, job=self._job)
        else:
            JobFolder.create(self.folder.path, self._job)
        self._take_lock()

    def _store_epoch(self) -> None:
        """Write the epoch if the folder has a lower one, as a restored copy may."""
        if self._is_begun and self.folder.epoch < self.epoch:
            self.folder.set_epoch(self.epoch)

    def _check_run(self, run: JournalIdentity) -> None:
        """Check that a run's folder holds a beginning of this run, or nothing."""
        path = self.folder.run_path(run.run)
        writer = self._find(run.run)
        if writer is not None:
            check_same_run(path, writer.identity, run)
        elif RunFolder.is_run(path):
            folder = RunFolder(path)
            scene = folder.bundle().digest if folder.has_bundle() else run.scene
            check_same_run(path, replace(run, spec=folder.spec, scene=scene), run)
        else:
            OutFolder(path).check()

    def _common_platform(self, platform: dict[str, str], runs: list[JournalIdentity]) -> dict[str, str]:
        for run in runs:
            writer = self._find(run.run)
            recorded = writer.journal.platform if writer else {}
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
        for path in self.folder.run_paths if self._is_begun else []:
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
        self.epoch = epoch

    def _open(self, run: JournalIdentity) -> RunWriter:
        job = self.folder
        path = job.run_path(run.run)
        if not RunFolder.is_run(path):
            RunFolder.add(job, run.run, run.spec, None)
        if not (path / JOURNAL).is_file():
            self._journals.begin(path, run, self.epoch, time.time())
            return self._writer(run.run)
        writer = self._writer(run.run)
        writer.begin_epoch(run.spec, self.epoch)
        return writer

    def _writer(self, run: str) -> RunWriter:
        writer = self._find(run)
        if writer is None:
            raise Refused(f"{self.folder.path} holds no journal of run '{run}': it was not opened")
        return writer

    def _find(self, run: str) -> RunWriter | None:
        """Return a run's writer; None: it has no journal."""
        path = self.folder.run_path(run)
        if run not in self.writers and (path / JOURNAL).is_file():
            self.writers[run] = writer = RunWriter(RunFolder(path), self._journals, self.epoch)
            if not writer.folder.has_bundle():
                self._without_scene[run] = writer
        return self.writers.get(run)

    @property
    def deadline(self) -> float:
        """When `step` has something to do if nothing comes before; infinite: never."""
        return -inf if self._news else self._commit_at

    def step(self, now: float) -> list[Recorded]:
        """Commit what is due; gives the reports of runs of which there is news."""
        if now >= self._commit_at:
            try:
                self._commit_due(now, COMMITS_AT_ONCE)
            except DiskFull as full:
                self._on_disk_full(full, now)
            else:
                self._on_disk_written()
        return self._take_reports()

    def finish(self) -> list[Recorded]:
        """Commit what waits, if there is room; gives the last reports."""
        with suppress(DiskFull):
            self._commit_due(inf)
        return self._take_reports()

    def commit(self, run: str) -> None:
        """Make a run's waiting rows durable; on a full disk (`DiskFull`) they go on waiting."""
        writer = self.writers[run]
        self._store_epoch()
        writer.commit(self._platform)
        self._waiting.pop(run, None)
        if run != RUN and (listing := writer.finished) is not None:
            path = self.folder.run_path(run)
            self._journals.close(path)  # its files are as they stay
            self._finished.add(path, writer.identity.spec, listing)

    @property
    def _commit_at(self) -> float:
        return max(min((writer.deadline for writer in self._waiting.values()), default=inf), self._try_at)

    def _commit_due(self, by: float, most: int | None = None) -> None:
        due = [run for run, writer in self._waiting.items() if writer.deadline <= by]
        for run in due[:most]:
            self.commit(run)
            self._news.add(run)

    def _on_disk_full(self, full: DiskFull, now: float) -> None:
        """Report that the disk is full, and try again soon; give up when it was full for too long."""
        folder = self.folder
        if not self._trouble:
            log.warning("the disk is full; trying again until there is room", reason=str(full))
        self._full_since = min(self._full_since, now)
        if now - self._full_since > self._disk_wait:
            raise DiskFull(
                f"{folder.path} has had no room for {self._disk_wait:g} s; "
                f"make room, then `{folder.resume_command}` goes on."
            )
        self._trouble, self._try_at = shorten(str(full)), now + RETRY_INTERVAL
        self._news.update(self._waiting)

    def _on_disk_written(self) -> None:
        if self._trouble:
            log.info("there is room again", folder=str(self.folder.path))
            self._news.update(self.writers)
        self._full_since, self._try_at, self._trouble = inf, -inf, ""

    def _take_reports(self) -> list[Recorded]:
        reports = [self._report(run) for run in sorted(self._news)]
        for run in self._news:
            self._forget(run)
        self._news.clear()
        return reports

    def _forget(self, run: str) -> None:
        """Forget a run that is finished; it is found again in its folder."""
        if self.writers[run].finished and run not in self._waiting and run not in self._without_scene:
            del self.writers[run]

    def _report(self, run: str) -> Recorded:
        durable = self.writers[run].durable
        return Recorded(epoch=self.epoch, run=run, durable=durable, trouble=self._trouble)

    @property
    def missing_scenes(self) -> list[str]:
        """The digests of scenes whose bundles are not in the folders of their runs yet."""
        return sorted({writer.identity.scene for writer in self._without_scene.values()})

    def add_scene(self, digest: str, payload: bytes) -> None:
        """Store a scene's bundle where it is missing."""
        for run, writer in list(self._without_scene.items()):
            if writer.identity.scene == digest:
                writer.folder.add_bundle(payload)
                del self._without_scene[run]
