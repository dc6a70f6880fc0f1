"""The worlds that a worker keeps: one evaluator for each scene that it lately served."""

from collections import OrderedDict
from collections.abc import Callable
from typing import Self

from qdgrasp_worker.evaluate import Evaluator

MOST = 8
"""A Bullet world takes 39 to 47 MB."""


class Worlds:
    """At most `most` evaluators by their scene's digest; the one longest unused leaves first.

    A context manager that closes them all.
    """

    def __init__(self, most: int = MOST) -> None:
        self._most = most
        self._evaluators: OrderedDict[str, Evaluator] = OrderedDict()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __len__(self) -> int:
        return len(self._evaluators)

    def __contains__(self, digest: str) -> bool:
        return digest in self._evaluators

    def get(self, digest: str, load: Callable[[], Evaluator]) -> Evaluator:
        """The evaluator of a scene, made by `load` where there is none yet."""
        if digest not in self._evaluators:
            self._make_room()
            self._evaluators[digest] = load()
        self._evaluators.move_to_end(digest)
        return self._evaluators[digest]

    def close(self) -> None:
        """Close all evaluators; closing twice is allowed."""
        while self._evaluators:
            self._evaluators.popitem()[1].close()

    def _make_room(self) -> None:
        while len(self._evaluators) >= self._most:
            self._evaluators.popitem(last=False)[1].close()
