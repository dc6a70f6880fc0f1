"""What somebody at the terminal has chosen to see, and what a key changes of it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

List = Literal["", "runs", "workers", "events"]
LISTS: dict[str, List] = {"r": "runs", "w": "workers", "e": "events"}
BACK = frozenset({"a", "escape"})
NEXT, PREVIOUS = frozenset({"tab", "right"}), frozenset({"backtab", "left"})
STEPS = {"up": -1, "down": 1}
LEAVE = frozenset({"q", "Q"})


@dataclass(frozen=True)
class Choice:
    """What is to be seen.

    Attributes
    ----------
    job
        The name of a job; where there is none of that name, the first one is meant.
    long
        The list that has all the room; empty: each has some.
    top
        The number of the first row of that list.
    """

    job: str = ""
    long: List = ""
    top: int = 0

    def place(self, jobs: Sequence[str]) -> int:
        """Which of some jobs is meant."""
        return jobs.index(self.job) if self.job in jobs else 0

    def pressed(self, key: str, jobs: Sequence[str], page: int) -> "Choice":
        """What is to be seen after a key was pressed.

        Parameters
        ----------
        jobs
            The names of those that there are.
        page
            How many rows of a list are seen at a time.
        """
        if key in LISTS:
            return replace(self, long="" if self.long == LISTS[key] else LISTS[key], top=0)
        if key in BACK:
            return replace(self, long="", top=0)
        if self.long and (to := self._scrolled(key, page)) is not None:
            return replace(self, top=max(0, to))
        return self._another(key, jobs)

    def _scrolled(self, key: str, page: int) -> int | None:
        moves = {**STEPS, "pageup": -page, "pagedown": page, " ": page, "home": -self.top, "end": 1 << 30}
        return self.top + moves[key] if key in moves else None

    def _another(self, key: str, jobs: Sequence[str]) -> "Choice":
        """With another job, if the key names one."""
        if not jobs:
            return self
        place = self.place(jobs)
        step = STEPS.get(key, (key in NEXT) - (key in PREVIOUS))
        if key.isdecimal() and key.isascii() and 1 <= int(key) <= len(jobs):
            place = int(key) - 1
        return replace(self, job=jobs[(place + step) % len(jobs)], top=self.top if not step else 0)
