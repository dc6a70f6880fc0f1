"""The same work for many items, in several processes."""

import signal
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


def side_by_side(
    work: Callable[[Item], Result], items: Iterable[Item], processes: int
) -> Iterator[tuple[Item, Result]]:
    """Yield each item with its result as it is done; of one process in this one, in the items' order.

    If the iterator is closed, or the program interrupted, items at work end and the others are left out.
    """
    if processes == 1:
        yield from ((item, work(item)) for item in items)
        return
    with ProcessPoolExecutor(processes, get_context("spawn"), _leave_interrupts_to_the_starter) as pool:
        waiting = {pool.submit(work, item): item for item in items}
        try:
            for done in as_completed(waiting):
                yield waiting[done], done.result()
        finally:
            pool.shutdown(cancel_futures=True)


def _leave_interrupts_to_the_starter() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
