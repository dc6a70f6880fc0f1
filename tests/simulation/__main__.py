"""`python -m tests.simulation`: histories and mutations from the command line."""

import argparse
import sys
import time
from collections import Counter
from collections.abc import Sequence

from tests.simulation.invariants import INVARIANTS
from tests.simulation.play import Verdict, play


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; 1 where an invariant is violated."""
    parser = argparse.ArgumentParser(prog="python -m tests.simulation", description=__doc__)
    parser.add_argument("--histories", type=int, default=5000, help="how many")
    parser.add_argument("--first", type=int, default=0, help="the number of the first")
    parser.add_argument("--history", type=int, help="only this one")
    parser.add_argument("--trace", action="store_true", help="show what happens in it")
    parser.add_argument("--mutations", action="store_true", help="try every mutation instead")
    asked = parser.parse_args(arguments)
    if asked.mutations:
        from tests.simulation.mutations import show

        return show()
    if asked.history is not None:
        return _show(play(asked.history, trace=asked.trace))
    return _play_all(range(asked.first, asked.first + asked.histories))


def _show(verdict: Verdict) -> int:
    print(*verdict.trace, sep="\n")  # noqa: T201
    print(verdict.history)  # noqa: T201
    print(f"{verdict.events} events in {verdict.seconds:.1f} s: {verdict.violated or 'nothing violated'}")  # noqa: T201
    return int(verdict.violated is not None)


def _play_all(numbers: Sequence[int]) -> int:
    began, cpu, events, seconds = time.monotonic(), time.process_time(), 0, 0.0
    violated: Counter[str] = Counter()
    for done, number in enumerate(numbers, 1):
        verdict = play(number)
        events, seconds = events + verdict.events, seconds + verdict.seconds
        if verdict.violated is not None:
            violated[verdict.violated.invariant] += 1
            print(f"history {number}: {verdict.violated}", flush=True)  # noqa: T201
        if done % 500 == 0 or done == len(numbers):
            print(  # noqa: T201
                f"{done} histories, {events} events, {seconds / 3600:.1f} simulated hours, "
                f"{sum(violated.values())} violations of {len(INVARIANTS)} invariants; "
                f"{time.process_time() - cpu:.0f} CPU s, {time.monotonic() - began:.0f} s",
                flush=True,
            )
    return int(bool(violated))


if __name__ == "__main__":
    sys.exit(main())
