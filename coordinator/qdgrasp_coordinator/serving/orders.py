"""Orders: what whoever administers a job has its coordinator do - pause, continue, cancel, drain.

None of them has a say in what a run finds: they decide when and where rows are evaluated, and when a
coordinator ends. Whatever is recorded stays.
"""

from collections.abc import Callable

from qdgrasp_coordinator.counts.team import WorkerFigures
from qdgrasp_coordinator.serving.turn import Turn
from qdgrasp_protocol.errors import Cancelled, EndedEarly, Refused
from qdgrasp_protocol.messages import Order
from qdgrasp_protocol.phrases import counted, few

SHOWN = 8
"""So much of a worker's id tells it from others, mostly."""
NAMED = 5
"""So many workers are named to somebody who names one that is not there."""


class Orders:
    """Carries orders out.

    Parameters
    ----------
    job
        The job's name.
    turn
        The coordinator's turn as it is now.
    end
        Has the coordinator end, for a reason.
    """

    def __init__(self, job: str, turn: Callable[[], Turn], end: Callable[[EndedEarly], None]) -> None:
        self._job = job
        self._turn = turn
        self._end = end

    def obey(self, order: Order, now: float) -> str:
        """Do what is asked; gives what happened, in a sentence.

        Raises
        ------
        Refused
            It cannot be done, and why not.
        """
        if self._turn().is_ending:
            raise Refused(f"job '{self._job}' is ending already")
        return _ACTS[order.act](self, order, now)

    def _pause(self, _order: Order, _now: float) -> str:
        turn = self._turn()
        if turn.is_paused:
            return f"Job '{self._job}' is paused already; `qdgrasp continue {self._job}` has it go on."
        turn.is_paused = True
        out = counted(
            sum(len(member.batches) for member in turn.dispatch.members),
            "batch that is out still counts",
            "batches that are out still count",
        )
        return f"Job '{self._job}' is paused: nothing is handed out; {out}."

    def _continue(self, _order: Order, _now: float) -> str:
        turn = self._turn()
        if not turn.is_paused:
            return f"Job '{self._job}' is not paused."
        turn.is_paused = False
        return f"Job '{self._job}' goes on."

    def _cancel(self, _order: Order, _now: float) -> str:
        self._end(Cancelled(self._job))
        return (
            f"Job '{self._job}' ends. What is recorded stays: `qdgrasp resume DIR` (or `campaign`) goes on."
        )

    def _drain(self, order: Order, now: float) -> str:
        turn = self._turn()
        chosen = self._chosen(turn.crew.figures(now), order)
        for worker in chosen:
            turn.crew.drain(worker.wid)
        who = f"{len(chosen)} worker{'s' if len(chosen) > 1 else ''}"
        return f"Asked {who} of job '{self._job}' to finish the batches at hand and leave."

    def _chosen(self, workers: list[WorkerFigures], order: Order) -> list[WorkerFigures]:
        """The workers that an order means: one by the beginning of its id, or all of a host."""
        if not (order.worker or order.host):
            raise Refused("it is not said whom to drain: name a worker or a host")
        if order.host:
            named, found = f"on host '{order.host}'", [one for one in workers if one.host == order.host]
        else:
            found = [one for one in workers if one.wid.startswith(order.worker)]
            named = f"'{order.worker}'"
        if not found:
            raise Refused(f"job '{self._job}' has no worker {named}; {_known(workers)}")
        if order.worker and len(found) > 1:
            raise Refused(f"job '{self._job}' has {len(found)} workers whose ids begin so; {_known(found)}")
        return found


_ACTS: dict[str, Callable[[Orders, Order, float], str]] = {
    "pause": Orders._pause,
    "continue": Orders._continue,
    "cancel": Orders._cancel,
    "drain": Orders._drain,
}


def _known(workers: list[WorkerFigures]) -> str:
    """Which workers there are, in words."""
    if not workers:
        return "none has joined"
    return f"there are {few([f'{one.wid[:SHOWN]} on {one.host}' for one in workers], NAMED)}"
