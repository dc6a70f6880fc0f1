"""The watch over the dispatch of one coordinator's turn."""

from collections import Counter
from collections.abc import Iterable

import numpy as np
from tests.coordinator.runs.plans import Task
from tests.simulation.coordinator import Coordinator
from tests.simulation.invariants import require
from tests.simulation.worker import CREDIT

from qdgrasp_coordinator.dispatching import pace, tickets
from qdgrasp_coordinator.dispatching.batch import Batch, Lease, Settled, Settlement
from qdgrasp_coordinator.dispatching.dispatch import Dispatch, Lost
from qdgrasp_coordinator.dispatching.member import SCENES
from qdgrasp_protocol.messages import Result
from qdgrasp_protocol.rows import Rows

Key = tuple[str, int, int, int]
"""A row: run, generation, index, trial."""


class TurnWatch:
    """Watches the dispatch of one turn: what goes in, and what comes out."""

    def __init__(self, host: Coordinator, task: Task) -> None:
        self._host = host
        self._task = task
        self._leased: dict[bytes, set[str]] = {}
        self._settled: set[bytes] = set()
        self.outstanding: set[Key] = set()
        """Rows that were asked and are not settled."""
        self.taken_back: Counter[str] = Counter()
        """Batches that were taken back, by worker: it may not know."""
        self._attach(host.turn.dispatch)

    def _attach(self, dispatch: Dispatch) -> None:
        self._dispatch = dispatch
        for name in ("submit", "withdraw", "leases", "settle", "tick"):
            setattr(self, f"_real_{name}", getattr(dispatch, name))
            setattr(dispatch, name, getattr(self, f"_{name}"))

    def _submit(self, run: str, scene: str, prior: str, generation: int, *rest: np.ndarray) -> None:
        indices, trials, genomes = rest
        keys = _keys(run, generation, indices, trials)
        require(self.outstanding.isdisjoint(keys), "nothing is lost", "asked twice:", keys)
        self.outstanding.update(keys)
        self._real_submit(run, scene, prior, generation, indices, trials, genomes)

    def _withdraw(self, run: str) -> dict[str, list[bytes]]:
        self.outstanding = {key for key in self.outstanding if key[0] != run}
        drops = self._real_withdraw(run)
        self.taken_back.update({wid: len(batches) for wid, batches in drops.items()})
        return drops

    def _leases(self, now: float) -> list[Lease]:
        leases = self._real_leases(now)
        for lease in leases:
            require(
                lease.batch.id not in self._settled, "settled once", "leased again:", lease.batch.id.hex()
            )
            held = len(self._dispatch._roster._members[lease.wid].batches)
            require(held <= CREDIT, "bounded work", "worker", lease.wid, "is leased", held)
            self._leased.setdefault(lease.batch.id, set()).add(lease.wid)
            self._host.note(
                f"leases {lease.batch.id.hex()[-4:]} to worker {int(lease.wid, 16)}, join {lease.join}"
            )
        waits = any(queue for queue in self._dispatch._backlog._queues.values())
        members = self._dispatch.members
        is_any_well = any(member.is_well for member in members)
        free = [member.wid for member in members if member.has_credit and (member.is_well or not is_any_well)]
        require(not (waits and free), "work is handed out", "nothing is leased to", free)
        return leases

    def _settle(self, wid: str, result: Result, rows: Rows, now: float) -> Settled:
        settled = self._real_settle(wid, result, rows, now)
        self._host.note(f"hears {result.batch.hex()[-4:]} of worker {int(wid, 16)}: {settled.kind.value}")
        if settled.superseded is not None:
            self.taken_back[settled.superseded] += 1
        if settled.kind is not Settlement.FRESH:
            return settled
        batch = result.batch
        require(batch not in self._settled, "settled once", "again:", batch.hex())
        require(wid in self._leased.get(batch, ()), "settled once", "by", wid, "who was not leased it")
        require(settled.rows is not None, "settled once", "without rows")
        self._settled.add(batch)
        self._check_rows(result.run, settled.rows)
        return settled

    def _check_rows(self, run: str, rows: Rows) -> None:
        asked = self._task.shape.empty(len(rows))
        for column in ("generation", "index", "trial", "genome"):
            asked[column] = rows[column]
        require(
            self._task.evaluate(asked).tobytes() == rows.tobytes(), "settled once", "with other rows:", rows
        )
        keys = set(
            zip([run] * len(rows), *(rows[c].tolist() for c in ("generation", "index", "trial")), strict=True)
        )
        require(keys <= self.outstanding, "settled once", "nobody waits for", keys - self.outstanding)
        self.outstanding -= keys

    def _tick(self, now: float) -> list[Lost]:
        lost = self._real_tick(now)
        for worker in lost:
            self._host.note(f"gives worker {int(worker.wid, 16)} up: {worker.reason}")
        require(not lost or self._host.link_is_up, "patience while cut off", lost)
        for worker in lost:
            self.taken_back[worker.wid] += worker.batches
        return lost

    # After every event.

    def look(self) -> None:
        """Check where all batches are."""
        dispatch, members = self._dispatch, self._dispatch._roster._members
        places: list[Key] = []
        for queue in dispatch._backlog._queues.values():
            for batch in (*queue.chunks, *queue.back.values()):
                places += _keys_of(batch)
        held: dict[str, set[bytes]] = {wid: set() for wid in members}
        for ticket in dispatch._tickets._open.values():
            if ticket.holder is not None:
                places += _keys_of(ticket.batch)
                held.setdefault(ticket.holder, set()).add(ticket.batch.id)
        require(len(places) == len(set(places)), "nothing is lost", "a row is in two places")
        require(
            set(places) == self.outstanding, "nothing is lost", self.outstanding.symmetric_difference(places)
        )
        for wid, batches in held.items():
            known = set(members[wid].batches) if wid in members else set()
            require(
                batches == known, "nothing is lost", wid, "is leased", batches, "and known to hold", known
            )

    def look_at_bounds(self) -> None:
        """Check credit, and how much is remembered."""
        dispatch = self._dispatch
        for member in dispatch.members:
            require(len(member.scenes) <= SCENES, "bounded memory", "scenes")
        require(len(dispatch._tickets._open) <= len(self.outstanding), "bounded memory", "open tickets")
        require(len(dispatch._tickets._settled) <= tickets.REMEMBERED, "bounded memory", "settled tickets")
        require(len(dispatch._roster.patience._turns) <= pace._TURNS, "bounded memory", "turns")
        open_runs = set(self._host.lanes.open)
        require(set(dispatch._backlog._queues) <= open_runs, "bounded memory", "queues of finished runs")

    def look_at_members(self, living: set[str]) -> None:
        """Check that nobody is remembered who is gone."""
        gone = set(self._dispatch._roster._members) - living
        require(not gone, "bounded memory", "workers that are gone:", gone)
        gone = self._host.turn.crew.alive - living
        require(not gone, "bounded memory", "tokens that are gone:", gone)


def _keys_of(batch: Batch) -> Iterable[Key]:
    return _keys(batch.run, batch.generation, batch.indices, batch.trials)


def _keys(run: str, generation: int, indices: np.ndarray, trials: np.ndarray) -> list[Key]:
    return [
        (run, generation, index, trial)
        for index, trial in zip(indices.tolist(), trials.tolist(), strict=True)
    ]
