"""A programme that is asked in one thread while runs are put back in another."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

from qdgrasp_coordinator.scheduler.run_plan import SingleRunQueue

MADE = object()
MOST_INSTRUCTIONS = 100


@contextmanager
def before_instruction(number: int, function: Callable, act: Callable[[], None]) -> Iterator[None]:
    """Act once before that instruction of a function: as another thread may, at every one of them."""
    left = number

    def traced(frame: FrameType, event: str, _: object) -> object:
        nonlocal left
        if frame.f_code is not function.__code__:
            return None
        frame.f_trace_opcodes = True
        if event == "opcode":
            left -= 1
            if left == -1:
                act()
        return traced

    before = sys.gettrace()
    sys.settrace(traced)
    try:
        yield
    finally:
        sys.settrace(before)


def test_a_run_that_is_put_back_at_any_moment_is_made_once_again() -> None:
    moments = []
    for number in range(MOST_INSTRUCTIONS):
        single = SingleRunQueue(lambda: MADE, 1)  # type: ignore[arg-type,return-value]
        assert single.next() is MADE
        with before_instruction(number, SingleRunQueue.next, lambda: moments.append(single.put_back("run"))):  # noqa: B023
            made = [single.next()]
        if len(moments) == number:  # there are not so many
            break
        made += [single.next(), single.next()]
        assert made.count(MADE) == 1, f"put back before instruction {number}"
    assert 3 < len(moments) < MOST_INSTRUCTIONS
