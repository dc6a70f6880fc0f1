"""Evaluators as a user writes them, in a file of their own."""

import numpy as np

from qdgrasp_assets.scene import Scene
from qdgrasp_protocol.rows import Outcome
from qdgrasp_worker.runtime.evaluator_api import Hands, Verdicts

ASKED: list[Hands] = []
"""The hands that `Height` was given, in this process."""


class Height:
    """Holds objects that it comes to from above."""

    def __init__(self, scene: Scene) -> None:
        self.top = scene.object_high[2]

    def __call__(self, hands: Hands) -> Verdicts:
        ASKED.append(hands)
        above = hands.base_to_object[:, 2] > self.top
        return Verdicts(np.where(above, Outcome.HELD, Outcome.MISSED))


class Squeamish(Height):
    """Raises for hands on one side."""

    def __call__(self, hands: Hands) -> Verdicts:
        if (hands.base_to_object[:, 0] > 0).any():
            raise ValueError("not there")
        return super().__call__(hands)


def nested() -> type:
    class Inner(Height):
        pass

    return Inner
