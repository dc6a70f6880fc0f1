"""Mutations: each breaks one rule, and invariants must notice within some histories.

`MUTATIONS` names them: what is replaced, by what. A mutation that nothing notices says that the histories
are too tame, or an invariant is missing.
"""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from math import inf
from typing import Any
from unittest.mock import patch

import msgspec
from tests.simulation.plan import wild
from tests.simulation.play import play

from qdgrasp_coordinator.recorder.recorded_job import LockedJobFolder
from qdgrasp_coordinator.recorder.recorder import Recorder, ReportSchedule
from qdgrasp_coordinator.recorder.run_writer import Arrival, RunWriter
from qdgrasp_coordinator.scheduler import lease_dispatcher as dispatching
from qdgrasp_coordinator.scheduler import worker_registry
from qdgrasp_coordinator.scheduler.batch_queue import BatchQueue, Settlement
from qdgrasp_coordinator.scheduler.job_scheduler import JobScheduler
from qdgrasp_coordinator.scheduler.lease_dispatcher import BatchTable, Dispatcher
from qdgrasp_coordinator.scheduler.pipeline import GenerationBuffer, Pipeline
from qdgrasp_coordinator.scheduler.recorder_client import Outbox
from qdgrasp_coordinator.scheduler.worker_registry import LostWorker, Worker, WorkerRegistry
from qdgrasp_coordinator.storage.journal_slice import JournalSlice
from qdgrasp_protocol.messages import Recordable, Recorded
from qdgrasp_worker.runtime.job_registry import JobSession

MOST = 120
"""A mutation is to be noticed within so many histories."""
Patch = Any


@dataclass(frozen=True)
class Mutation:
    """One broken rule."""

    name: str
    rule: str
    """The rule of docs/bus.md, or what else is broken."""
    invariants: tuple[str, ...]
    """Those that are to notice; others do not count, for any fault may break anything."""
    patches: Callable[[], list[Patch]]

    @contextmanager
    def applied(self) -> Iterator[None]:
        """The rule is broken within this context."""
        with ExitStack() as stack:
            for one in self.patches():
                stack.enter_context(one)
            yield


def method(owner: object, name: str, make: Callable[[Any], Any]) -> Patch:
    """A method or function replaced by what `make` makes of it."""
    return patch.object(owner, name, make(getattr(owner, name)))


def value(owner: type, name: str, get: Callable[[Any], Any]) -> Patch:
    """A property replaced by a function."""
    return patch.object(owner, name, property(get))


# Dispatch and the sessions of workers.


def _accept_any_join(session: JobSession, work: Any) -> bool:
    if work.epoch != session.epoch:
        return False
    session._held[work.batch] = work
    return True


def _keep_held(on_answer: Any) -> Any:
    def kept(session: JobSession, *answer: Any) -> bool:
        held = dict(session._held)
        is_current: bool = on_answer(session, *answer)
        session._held.update(held)
        return is_current

    return kept


def _keep_settled(close: Any) -> Any:
    def closed(batches: BatchTable, state: Any, winner: str | None = None) -> None:
        close(batches, state, winner)
        vars(batches).setdefault("kept", {})[state.batch.id] = state

    return closed


def _settle_again(classify: Any) -> Any:
    def classified(batches: Any, wid: str, result: Any) -> Settlement:
        kind: Settlement = classify(batches, wid, result)
        if kind not in (Settlement.DUPLICATE, Settlement.LATE):
            return kind
        batches._open[result.batch] = batches.kept[result.batch]
        return Settlement.FRESH

    return classified


def _close_and_keep(batches: BatchTable, state: Any, winner: str | None = None) -> None:
    batches._settled[state.batch.id] = (batches._open.pop(state.batch.id).leased, winner)


def _accept_any_worker(classify: Any) -> Any:
    def classified(batches: BatchTable, wid: str, result: Any) -> Settlement:
        state = batches._open.get(result.batch)
        if state is not None and result.n == len(state.batch):
            state.leased.add(wid)
        return classify(batches, wid, result)

    return classified


def _forget_requeued(requeue: Any) -> Any:
    def requeued(dispatcher: Dispatcher, batch_ids: Any) -> int:
        with patch.object(BatchQueue, "requeue"):
            return requeue(dispatcher, batch_ids)

    return requeued


def _join_without_requeue(join: Any) -> Any:
    def joined(dispatcher: Dispatcher, *arguments: Any) -> list[bytes]:
        with patch.object(Dispatcher, "requeue", lambda self, ids: len(list(ids))):
            return join(dispatcher, *arguments)

    return joined


def _stay_due(give_up: Any) -> Any:
    def given_up(workers: WorkerRegistry, worker: Worker, now: float) -> LostWorker:
        gone, worker.gone_at = worker.gone_at, None
        lost: LostWorker = give_up(workers, worker, now)
        worker.gone_at = gone
        return lost

    return given_up


def _never_forget(give_up: Any) -> Any:
    def given_up(workers: WorkerRegistry, worker: Worker, now: float) -> LostWorker:
        worker.gone_at = None  # as one whose token is there, but who makes no progress
        lost: LostWorker = give_up(workers, worker, now)
        return lost

    return given_up


def _overlook_the_first(ordered: Any) -> Any:
    def found(workers: list[Worker]) -> Iterator[Worker]:
        rest = sorted(workers, key=lambda worker: (len(worker.batches), worker.progress, worker.order))[1:]
        yield from ordered(rest)

    return found


def _withdraw_half(withdraw: Any) -> Any:
    def withdrawn(dispatcher: Dispatcher, run: str) -> Any:
        with patch.object(BatchQueue, "withdraw"):
            return withdraw(dispatcher, run)

    return withdrawn


# Pipeline, outbox, recorder.


def _ready_with_gaps(buffer: GenerationBuffer) -> Any:
    indices, trials = buffer._next(4096)
    is_present = buffer._is_present[indices, trials]
    return buffer._rows[indices[is_present], trials[is_present]]


def _replay_without_last(replay: Any) -> Any:
    def replayed(pipeline: Pipeline, rows: Any) -> None:
        replay(pipeline, rows[:-1])

    return replayed


def _report_expected(report: Any) -> Any:
    def reported(recorder: Recorder, run: str) -> Recorded:
        message: Recorded = report(recorder, run)
        return Recorded(epoch=message.epoch, run=run, durable=recorder.writers[run].expected, trouble="")

    return reported


def _take_in_silence(recorder: Recorder, message: Recordable, now: float) -> None:
    recorder.add_rows(message, now)


def _forget_sent(due: Any) -> Any:
    def sent(outbox: Outbox, now: float) -> list[JournalSlice]:
        stretches: list[JournalSlice] = due(outbox, now)
        if stretches:
            outbox._forget(outbox._end)
        return stretches

    return sent


def _number_batches(push: Any) -> Any:
    def pushed(outbox: Outbox, stretch: JournalSlice) -> None:
        if len(stretch):
            outbox._kept.append(replace(stretch, first=outbox._end))
            outbox._end += 1

    return pushed


def _take_any_epoch(add_rows: Any) -> Any:
    def added(recorder: Recorder, message: Recordable, now: float) -> Arrival:
        arrival: Arrival = add_rows(recorder, msgspec.structs.replace(message, epoch=recorder.epoch), now)
        return arrival

    return added


def _take_past_gaps(add: Any) -> Any:
    def added(writer: RunWriter, part: JournalSlice, epoch: int, now: float) -> Arrival:
        if part.first > writer.expected:
            part = replace(part, first=writer.expected)
        arrival: Arrival = add(writer, part, epoch, now)
        return arrival

    return added


MUTATIONS = [
    Mutation(
        "drop the join fence",
        "3",
        ("fenced",),
        lambda: [patch.object(JobSession, "accept", _accept_any_join)],
    ),
    Mutation(
        "settle twice",
        "5",
        ("settled once",),
        lambda: [method(BatchTable, "close", _keep_settled), method(BatchTable, "classify", _settle_again)],
    ),
    Mutation(
        "take a result from a worker that was not leased it",
        "5",
        ("settled once",),
        lambda: [method(BatchTable, "classify", _accept_any_worker)],
    ),
    Mutation(
        "acknowledge before durable",
        "8",
        ("acknowledged when durable",),
        lambda: [method(Recorder, "_report", _report_expected)],
    ),
    Mutation("forget before durable", "8", ("progress",), lambda: [method(Outbox, "take_due", _forget_sent)]),
    Mutation(
        "tell out of order",
        "7",
        ("told in order",),
        lambda: [patch.object(GenerationBuffer, "ready_rows", _ready_with_gaps)],
    ),
    Mutation(
        "take rows of an older epoch",
        "8",
        ("epochs rise",),
        lambda: [method(Recorder, "add_rows", _take_any_epoch)],
    ),
    Mutation(
        "take rows past a gap",
        "8",
        ("true journal",),
        lambda: [method(RunWriter, "add", _take_past_gaps)],
    ),
    Mutation(
        "no lease ever passes", "4", ("progress",), lambda: [patch.object(Worker, "deadline", lambda *_: inf)]
    ),
    Mutation(
        "only lost tokens end leases",
        "4",
        ("progress",),
        lambda: [
            patch.object(
                Worker,
                "deadline",
                lambda member, limit: inf if member.gone_at is None else member.gone_at + 1.0,
            )
        ],
    ),
    Mutation(
        "queue again without taking away",
        "5",
        ("nothing is lost",),
        lambda: [patch.object(BatchQueue, "remove")],
    ),
    Mutation(
        "forget what is to be queued again",
        "4",
        ("nothing is lost",),
        lambda: [method(Dispatcher, "requeue", _forget_requeued)],
    ),
    Mutation(
        "a join queues nothing again",
        "4",
        ("nothing is lost",),
        lambda: [method(Dispatcher, "join", _join_without_requeue)],
    ),
    Mutation(
        "ignore credit",
        "1",
        ("bounded work",),
        lambda: [value(Worker, "has_credit", lambda m: len(m.batches) < 9)],
    ),
    Mutation(
        "give no credit back",
        "1",
        ("nothing is lost",),
        lambda: [patch.object(WorkerRegistry, "release", lambda *_: None)],
    ),
    Mutation(
        "replay skips a row",
        "9",
        ("no machine fails",),
        lambda: [method(Pipeline, "replay", _replay_without_last)],
    ),
    Mutation(
        "number batches, not rows",
        "8",
        ("recorded before forgotten",),
        lambda: [method(Outbox, "push", _number_batches)],
    ),
    Mutation(
        "give up while cut off",
        "4",
        ("patience while cut off",),
        lambda: [patch.object(WorkerRegistry, "on_link", lambda *_: None)],
    ),
    Mutation("send rows once", "8", ("progress",), lambda: [patch.object(Outbox, "resend", lambda *_: None)]),
    Mutation(
        "ask without end", "8", ("bounded memory",), lambda: [value(Outbox, "is_full", lambda _: False)]
    ),
    Mutation(
        "report commits only, once",
        "8",
        ("progress",),
        lambda: [
            patch.object(ReportSchedule, "keep_reporting", lambda *_: None),
            patch.object(Recorder, "_take_rows", _take_in_silence),
        ],
    ),
    Mutation(
        "never forget a worker",
        "4",
        ("bounded memory",),
        lambda: [method(WorkerRegistry, "_give_up", _never_forget)],
    ),
    Mutation(
        "give up for ever again who is gone",
        "4",
        ("no machine spins",),
        lambda: [method(WorkerRegistry, "_give_up", _stay_due)],
    ),
    Mutation(
        "overlook a worker with credit",
        "1",
        ("work is handed out",),
        lambda: [method(worker_registry, "fewest_batches_first", _overlook_the_first)],
    ),
    Mutation(
        "remember every batch",
        "5",
        ("bounded memory",),
        lambda: [patch.object(BatchTable, "close", _close_and_keep)],
    ),
    Mutation(
        "poison is tried for ever", "6", ("progress",), lambda: [patch.object(dispatching, "STRIKES", 10**9)]
    ),
    Mutation(
        "a finished run stays in the backlog",
        "7",
        ("bounded memory",),
        lambda: [method(Dispatcher, "withdraw", _withdraw_half)],
    ),
    Mutation(
        "the epoch is not stored",
        "8",
        ("epochs rise",),
        lambda: [patch.object(LockedJobFolder, "store_epoch", lambda _: None)],
    ),
    Mutation(
        "pass over a higher epoch",
        "8",
        ("progress",),
        lambda: [patch.object(JobScheduler, "_on_token", lambda *_: None)],
    ),
    Mutation(
        "keep work of an older epoch", "3", ("fenced",), lambda: [method(JobSession, "on_answer", _keep_held)]
    ),
    Mutation(
        "ask once to join",
        "2",
        ("progress",),
        lambda: [patch.object(JobSession, "join_later", lambda *_: None)],
    ),
]


def noticed(mutation: Mutation, most: int = MOST, first: int = 0) -> tuple[str, int] | None:
    """Return the invariant that noticed a mutation, and the number of histories; else None."""
    with mutation.applied():
        for count, number in enumerate(range(first, first + most), 1):
            violated = play(wild(number)).violated
            if violated is not None and violated.invariant in mutation.invariants:
                return violated.invariant, count
    return None


def show() -> int:
    """Try all; prints a table, and gives 1 where one was not noticed."""
    missed = 0
    print("| mutation | rule | noticed by | after histories |\n|---|---|---|---|")  # noqa: T201
    for mutation in MUTATIONS:
        found = noticed(mutation)
        missed += found is None
        invariant, count = found or ("**nothing**", MOST)
        print(f"| {mutation.name} | {mutation.rule} | {invariant} | {count} |", flush=True)  # noqa: T201
    return int(bool(missed))
