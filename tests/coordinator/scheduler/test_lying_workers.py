"""Workers that lie among others that do not: the record, and the job's messages."""

import threading
from contextlib import ExitStack
from pathlib import Path

import numpy as np
from tests.common import PATIENCE
from tests.coordinator.scheduler.search_plans import Plan, reference
from tests.fakes.job import Job
from tests.fakes.messages import made_id
from tests.fakes.recorder import JOB, recording
from tests.fakes.worker import FakeWorker, LyingWorker

from qdgrasp_coordinator.metrics.job_status import JobEvent, JobStatus, from_json
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.bus import Bus, Sample
from qdgrasp_protocol.keys import Keys

PLANS: dict[str, Plan | None] = {
    f"run-{seed}": Plan(seed=seed, population=20, evaluations=400) for seed in range(3)
}
LIAR = made_id(7)


class Heard:
    """The messages of a job until it is over."""

    def __init__(self, bus: Bus) -> None:
        self.events: list[JobEvent] = []
        self.last: JobStatus | None = None
        self.has_excluded = threading.Event()
        bus.subscribe(Keys(JOB).event("*"), self._hear)
        bus.subscribe(Keys(JOB).stat("job"), self._look)

    def _hear(self, sample: Sample) -> None:
        event = from_json(sample.payload, JobEvent)
        self.events.append(event)
        if "is excluded" in event.words:
            self.has_excluded.set()

    def _look(self, sample: Sample) -> None:
        self.last = from_json(sample.payload, JobStatus)


def carry_out(job: Job, liar: LyingWorker, path: Path) -> Heard:
    """Carry a job out with two workers, whom a liar joins at once, recorded at a path."""
    heard = Heard(job.network.session())
    with ExitStack() as stack:

        def join(_now: float) -> None:
            if len(job.service.scheduler.workers) == 2 and not has_joined:
                has_joined.append(stack.enter_context(liar.at_work()))

        has_joined: list[FakeWorker] = []
        stack.enter_context(recording(job.network, path))
        for number in range(2):
            stack.enter_context(FakeWorker(job.network.session(), made_id(number)).at_work())
        job.service.run(join)
    return heard


def journal(path: Path, run: str) -> bytes:
    with RunFolder.open(path / "runs" / run).journal() as found:
        return np.concatenate(list(found.blocks())).tobytes()


def test_nothing_of_a_liar_is_recorded_and_the_job_says_who_it_was(tmp_path: Path) -> None:
    job = Job(PLANS, recorded=True)
    heard = carry_out(job, LyingWorker(job.network.session(), LIAR), tmp_path / "job")
    for name, plan in PLANS.items():
        assert plan is not None
        assert journal(tmp_path / "job", name) == reference(plan)
    assert heard.has_excluded.wait(PATIENCE)
    (event,) = [event for event in heard.events if "is excluded" in event.words]
    assert (event.kind, event.worker) == ("error", LIAR)
    assert event.words.startswith(f"Worker {LIAR[:8]} on here answered ")
    assert " of 'run-" in event.words
    assert not any("verify" in event.words for event in heard.events)
    assert heard.last is not None
    assert heard.last.differing > 0


def test_the_folder_counts_rows_that_were_checked_and_those_that_differed(tmp_path: Path) -> None:
    job = Job(PLANS, recorded=True, checked=0.2)
    carry_out(job, LyingWorker(job.network.session(), LIAR), tmp_path / "job")
    found = [RunFolder.open(tmp_path / "job" / "runs" / name) for name in PLANS]
    checked = differing = 0
    for folder in found:
        with folder.journal() as recorded:
            checked, differing = checked + recorded.checked, differing + recorded.differing
    assert 0.1 * 1200 < checked < 0.4 * 1200
    assert 0 < differing < checked


def test_a_worker_that_lies_later_is_excluded_and_its_runs_go_on_from_their_journals(tmp_path: Path) -> None:
    job = Job(PLANS, recorded=True, checked=0.5)
    heard = carry_out(job, LyingWorker(job.network.session(), LIAR, after=60), tmp_path / "job")
    words = [event.words for event in heard.events]
    assert sum("is excluded" in sentence for sentence in words) == 1
    assert any(
        sentence.startswith(f"Earlier rows of worker {LIAR[:8]} in run-") and "qdgrasp verify DIR" in sentence
        for sentence in words
    )
    assert any("goes on from row" in sentence for sentence in words)
    for name, plan in PLANS.items():
        assert plan is not None
        rows, true = journal(tmp_path / "job", name), reference(plan)
        assert len(rows) == len(true) or rows != true
