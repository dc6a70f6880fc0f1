"""What is kept of an answer: one thread asks for it at a time, the others take what is there."""

import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

from qdgrasp_protocol.errors import BusError, NoReply, QdgraspError

PATIENCE = 1.0
"""So long is waited for whoever asks first [s]."""
SORRY = 3.0
"""So long is nobody asked who gave no answer [s]."""

T = TypeVar("T")
K = TypeVar("K", bound=Hashable)


class Kept(Generic[T]):
    """The latest answer to a question that may take long; any thread may get it.

    Parameters
    ----------
    ask
        Gives the answer; it is called with the one before, None at first.
    fresh
        How long an answer is good for [s].
    clock
        Gives the time [s].
    """

    def __init__(
        self,
        ask: Callable[[T | None], T],
        fresh: Callable[[T], float],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._ask, self._fresh, self._clock = ask, fresh, clock
        self._asking = threading.Lock()
        self._answer: T | None = None
        self._failure: QdgraspError | None = None
        self._due = float("-inf")

    def get(self) -> T:
        """The answer, asked for anew where it is due; the one before while nobody answers.

        Raises
        ------
        QdgraspError
            There is none: as `ask`, or because another thread waits for it since long.
        """
        if self._is_due and self._asking.acquire(timeout=PATIENCE if self._answer is None else 0):
            try:
                self._renew()
            finally:
                self._asking.release()
        answer, failure = self._answer, self._failure
        if answer is None or (failure is not None and not isinstance(failure, BusError)):
            raise (failure or NoReply("It is asked for already; try again.")).with_traceback(None)
        return answer

    @property
    def _is_due(self) -> bool:
        return self._clock() >= self._due

    def _renew(self) -> None:
        """Ask, unless another thread did so meanwhile."""
        if not self._is_due:
            return
        try:
            answer = self._ask(self._answer)
        except QdgraspError as error:
            self._failure, self._due = error, self._clock() + SORRY
        else:
            self._answer, self._failure = answer, None
            self._due = self._clock() + self._fresh(answer)


class Shelf(Generic[K, T]):
    """A few things by name, each made when it is first asked for; what was not asked for longest gives way.

    Parameters
    ----------
    make
        Makes the thing of a name, at once.
    most
        So many are kept.
    """

    def __init__(self, make: Callable[[K], T], most: int) -> None:
        self._make, self._most = make, most
        self._lock = threading.Lock()
        self._kept: OrderedDict[K, T] = OrderedDict()

    def of(self, name: K) -> T:
        """That of a name; any thread may ask."""
        with self._lock:
            self._kept[name] = self._kept.pop(name) if name in self._kept else self._make(name)
            if len(self._kept) > self._most:
                self._kept.popitem(last=False)
            return self._kept[name]
