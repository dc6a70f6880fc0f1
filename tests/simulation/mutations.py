"""Mutations: each breaks one rule, and one invariant must notice within some histories.

`MUTATIONS` names them: what is replaced, by what. A mutation that nothing notices says that the histories
are too tame, or an invariant is missing.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from itertools import islice
from math import inf
from typing import Any
from unittest.mock import patch

import msgspec
from tests.simulation.plan import History, wild, with_bad_workers
from tests.simulation.play import play

from qdgrasp_coordinator.recorder.recorder import Recorder
from qdgrasp_coordinator.recorder.run_writer import RunWriter
from qdgrasp_coordinator.scheduler import batch_dispatcher as dispatching
from qdgrasp_coordinator.scheduler import worker_registry
from qdgrasp_coordinator.scheduler.batch_dispatcher import Dispatcher, Settlement
from qdgrasp_coordinator.scheduler.batch_queue import Batch, BatchQueue
from qdgrasp_coordinator.scheduler.job_scheduler import JobScheduler
from qdgrasp_coordinator.scheduler.pipeline import GenerationBuffer, Pipeline
from qdgrasp_coordinator.scheduler.recorder_client import Outbox
from qdgrasp_coordinator.scheduler.worker_registry import LostWorker, Worker, WorkerRegistry
from qdgrasp_coordinator.storage.journal import JournalSlice
from qdgrasp_protocol.bus import Sample
from qdgrasp_protocol.messages import Recordable, Recorded
from qdgrasp_worker.runtime.job_registry import JobSession
from qdgrasp_worker.runtime.service import WorkerService

MOST = 240
"""A mutation is to be noticed within so many histories."""
Real = Callable[..., Any]
"""The method or function that a mutation replaces."""


@dataclass(frozen=True)
class Mutation:
    """One broken rule."""

    name: str
    rule: str
    """The rule of docs/bus.md, or what else is broken."""
    invariant: str
    """The one that is to notice; others do not count, for any fault may break anything."""
    patches: Sequence[Any]
    histories: Callable[[int], History] = wild
    """Makes the histories of numbers in which it is to be noticed."""


def around(owner: object, name: str, act: Callable[..., Any]) -> Any:
    """A method or function replaced by one that is given the real one first."""
    real = getattr(owner, name)
    return patch.object(owner, name, lambda *arguments, **named: act(real, *arguments, **named))


def off(owner: type, name: str) -> Any:
    """A method replaced by one that does nothing."""
    return patch.object(owner, name, lambda *_: None)


def value(owner: type, name: str, get: Callable[[Any], Any]) -> Any:
    """A property replaced by a function."""
    return patch.object(owner, name, property(get))


# Dispatch and the sessions of workers.


def _accept_any_join(session: JobSession, work: Any) -> bool:
    if work.epoch != session.epoch:
        return False
    session._held[work.batch] = work
    return True


def _keep_held(on_answer: Real, session: JobSession, *answer: Any) -> bool:
    held = dict(session._held)
    is_current: bool = on_answer(session, *answer)
    session._held.update(held)
    return is_current


def _keep_settled(close: Real, batches: Dispatcher, state: Any) -> None:
    close(batches, state)
    vars(batches).setdefault("kept", {})[state.id] = state


def _settle_again(classify: Real, batches: Any, wid: str, result: Any) -> Settlement:
    kind: Settlement = classify(batches, wid, result)
    if kind is not Settlement.LATE or result.batch not in batches._settled:
        return kind
    batches._open[result.batch] = batches.kept[result.batch]
    return Settlement.FRESH


def _close_and_keep(batches: Dispatcher, state: Any) -> None:
    batches._settled[state.id] = batches._open.pop(state.id).leased


def _accept_any_worker(classify: Real, batches: Dispatcher, wid: str, result: Any) -> Settlement:
    state = batches._open.get(result.batch)
    if state is not None and result.n == len(state):
        state.leased.add(wid)
    return classify(batches, wid, result)


def _forget_requeued(requeue: Real, dispatcher: Dispatcher, wid: str, batch_ids: Any) -> int:
    with patch.object(BatchQueue, "requeue"):
        return requeue(dispatcher, wid, batch_ids)


def _requeue_held(requeue: Real, dispatcher: Dispatcher, wid: str, batch_ids: Any) -> int:
    ids = list(batch_ids)
    held = [state for one in ids if (state := dispatcher._open.get(one)) and len(state.holders) > 1]
    count: int = requeue(dispatcher, wid, ids)
    for state in held:
        dispatcher._requeue(state)
    return count


def _join_without_requeue(join: Real, dispatcher: Dispatcher, *arguments: Any) -> list[bytes]:
    with patch.object(Dispatcher, "requeue", lambda self, _, ids: len(list(ids))):
        return join(dispatcher, *arguments)


def _never_forget(give_up: Real, workers: WorkerRegistry, worker: Worker, now: float) -> LostWorker:
    worker.gone_at = None  # as one whose token is there, but who makes no progress
    return give_up(workers, worker, now)


def _overlook_the_first(idle: Real, workers: WorkerRegistry) -> Iterator[Worker]:
    yield from islice(idle(workers), 1, None)


def _withdraw_half(withdraw: Real, dispatcher: Dispatcher, run: str, **how: bool) -> Any:
    with patch.object(BatchQueue, "withdraw"):
        return withdraw(dispatcher, run, **how)


# Pipeline, outbox, recorder.


def _ready_with_gaps(buffer: GenerationBuffer) -> Any:
    indices, trials = buffer._next(4096)
    is_present = buffer._is_present[indices, trials]
    return buffer._rows[indices[is_present], trials[is_present]]


def _replay_without_last(replay: Real, pipeline: Pipeline, rows: Any) -> None:
    replay(pipeline, rows[:-1])


def _report_expected(report: Real, recorder: Recorder, run: str) -> Recorded:
    message: Recorded = report(recorder, run)
    return Recorded(epoch=message.epoch, run=run, durable=recorder.writers[run].expected, trouble="")


def _take_in_silence(take: Real, recorder: Recorder, sample: Sample, now: float) -> None:
    news = set(recorder._news)
    take(recorder, sample, now)
    recorder._news = news


def _forget_sent(due: Real, outbox: Outbox, now: float) -> list[JournalSlice]:
    slices: list[JournalSlice] = due(outbox, now)
    if slices:
        outbox._forget(outbox._end)
    return slices


def _number_batches(outbox: Outbox, part: JournalSlice) -> None:
    if len(part):
        outbox._kept.append(replace(part, first=outbox._end))
        outbox._end += 1


def _take_any_epoch(add_rows: Real, recorder: Recorder, message: Recordable, now: float) -> bool:
    return add_rows(recorder, msgspec.structs.replace(message, epoch=recorder.epoch), now)


def _take_past_gaps(add: Real, writer: RunWriter, part: JournalSlice, epoch: int, now: float) -> bool:
    part = replace(part, first=min(part.first, writer.expected))
    return add(writer, part, epoch, now)


def _no(_worker: Worker) -> bool:
    return False


def _only_batches(requeue: Real, dispatcher: Dispatcher, task: Any) -> None:
    if isinstance(task, Batch):
        requeue(dispatcher, task)


PATCHES: dict[tuple[str, str, Callable[[int], History]], dict[str, list[Any]]] = {
    ("3", "fenced", wild): {
        "drop the join fence": [patch.object(JobSession, "accept", _accept_any_join)],
        "keep work of an older epoch": [around(JobSession, "on_answer", _keep_held)],
    },
    ("5", "settled once", wild): {
        "settle twice": [
            around(Dispatcher, "_close", _keep_settled),
            around(Dispatcher, "_classify", _settle_again),
        ],
        "take a result from a worker that was not leased it": [
            around(Dispatcher, "_classify", _accept_any_worker)
        ],
    },
    ("8", "acknowledged when durable", wild): {
        "acknowledge before durable": [around(Recorder, "_report", _report_expected)]
    },
    ("8", "progress", wild): {
        "forget before durable": [around(Outbox, "take_due", _forget_sent)],
        "send rows once": [off(Outbox, "resend")],
        "report commits only, once": [around(Recorder, "take", _take_in_silence)],
        "pass over a higher epoch": [off(JobScheduler, "_on_token")],
    },
    ("7", "told in order", wild): {
        "tell out of order": [patch.object(GenerationBuffer, "ready_rows", _ready_with_gaps)]
    },
    ("8", "epochs rise", wild): {
        "the epoch is not stored": [off(Recorder, "_store_epoch")],
        "take rows of an older epoch": [around(Recorder, "add_rows", _take_any_epoch)],
    },
    ("8", "true journal", wild): {"take rows past a gap": [around(RunWriter, "add", _take_past_gaps)]},
    ("4", "progress", wild): {
        "no lease ever passes": [patch.object(Worker, "deadline", lambda *_: inf)],
        "only lost tokens end leases": [
            patch.object(
                Worker,
                "deadline",
                lambda member, limit: inf if member.gone_at is None else member.gone_at + 1.0,
            )
        ],
    },
    ("5", "nothing is lost", wild): {"queue again without taking away": [patch.object(BatchQueue, "remove")]},
    ("4", "nothing is lost", wild): {
        "forget what is to be queued again": [around(Dispatcher, "requeue", _forget_requeued)],
        "a join queues nothing again": [around(Dispatcher, "join", _join_without_requeue)],
        "a batch is queued again that another worker holds": [around(Dispatcher, "requeue", _requeue_held)],
    },
    ("1", "bounded work", wild): {
        "ignore credit": [value(Worker, "has_credit", lambda m: len(m.batches) < 9)]
    },
    ("1", "nothing is lost", wild): {"give no credit back": [off(WorkerRegistry, "release")]},
    ("9", "no machine fails", wild): {
        "replay skips a row": [around(Pipeline, "replay", _replay_without_last)]
    },
    ("8", "recorded before forgotten", wild): {
        "number batches, not rows": [patch.object(Outbox, "push", _number_batches)]
    },
    ("4", "patience while cut off", wild): {"give up while cut off": [off(WorkerRegistry, "on_link")]},
    ("8", "bounded memory", wild): {"ask without end": [value(Outbox, "is_full", lambda _: False)]},
    ("4", "bounded memory", wild): {
        "never forget a worker": [around(WorkerRegistry, "_give_up", _never_forget)],
        "wait for late tokens for ever": [patch.object(worker_registry, "TOKEN_DELAY", inf)],
    },
    ("2", "no machine spins", wild): {
        "a worker looks up again and again": [patch.object(WorkerService, "_wait_seconds", lambda *_: 0.0)]
    },
    ("1", "work is handed out", wild): {
        "overlook a worker with credit": [around(WorkerRegistry, "idle", _overlook_the_first)],
    },
    ("5", "bounded memory", wild): {
        "remember every batch": [patch.object(Dispatcher, "_close", _close_and_keep)]
    },
    ("6", "progress", wild): {"poison is tried for ever": [patch.object(dispatching, "STRIKES", 10**9)]},
    ("7", "bounded memory", wild): {
        "a finished run stays in the backlog": [around(Dispatcher, "withdraw", _withdraw_half)]
    },
    ("13", "bounded work", wild): {"a worker that builds gets batches": [value(Worker, "is_building", _no)]},
    ("13", "nothing is lost", wild): {
        "queue no build again": [around(Dispatcher, "_requeue", _only_batches)]
    },
    ("6", "settled once", with_bad_workers): {
        "one worker's failures make an error": [
            patch.object(Dispatcher, "_may_have", lambda *_: True),
        ],
    },
    ("6", "nothing is lost", wild): {
        "a failed row is lost": [patch.object(BatchQueue, "requeue_row", lambda *_: None)]
    },
    ("3", "settled once", wild): {
        "take an answer without its worker's key": [
            patch.object(JobScheduler, "_check_sender", lambda *_: None)
        ],
    },
    ("2", "progress", wild): {"ask once to join": [off(JobSession, "join_later")]},
}
"""By rule, invariant and histories, the patches of each mutation."""
MUTATIONS = [
    Mutation(name, rule, invariant, patches, histories)
    for (rule, invariant, histories), group in PATCHES.items()
    for name, patches in group.items()
]


def noticed(mutation: Mutation, most: int = MOST, first: int = 0) -> int | None:
    """Return the number of histories after which a mutation was noticed; else None."""
    with ExitStack() as stack:
        for one in mutation.patches:
            stack.enter_context(one)
        for count, number in enumerate(range(first, first + most), 1):
            violated = play(mutation.histories(number)).violated
            if violated is not None and violated.invariant == mutation.invariant:
                return count
    return None


def show() -> int:
    """Try all; prints a table, and gives 1 where one was not noticed."""
    missed = 0
    print("| mutation | rule | noticed by | after histories |\n|---|---|---|---|")  # noqa: T201
    for mutation in MUTATIONS:
        count = noticed(mutation)
        missed += count is None
        by = mutation.invariant if count else "**nothing**"
        print(f"| {mutation.name} | {mutation.rule} | {by} | {count or MOST} |", flush=True)  # noqa: T201
    return int(bool(missed))
