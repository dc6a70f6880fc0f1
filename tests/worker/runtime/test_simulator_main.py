"""A simulator's process: the rows that it evaluates, and its limits on itself."""

from multiprocessing import Pipe
from unittest.mock import Mock

import pytest

from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.rows import RowShape, pack
from qdgrasp_worker.evaluator import Evaluation
from qdgrasp_worker.runtime.simulator_main import WORK_COLUMNS, SimulatorMain
from qdgrasp_worker.runtime.simulator_messages import (
    BatchRejected,
    EvaluateRows,
    MessageConnection,
    PartialResult,
)


class Scarce:
    """Loads evaluators, for `room` of which there is memory; else the engine says something else."""

    def __init__(self, room: int) -> None:
        self._room = room
        self.loads = 0

    def __call__(self, _bundle: bytes) -> Mock:
        self.loads += 1
        if not self._room:
            raise InputError("the engine cannot read this mesh")
        self._room -= 1
        evaluator = Mock(weight=1, at_once=1, shape=lambda _: RowShape(2, 1))
        evaluator.evaluate.side_effect = lambda _, genomes, __: Evaluation(
            RowShape(2, 1).empty(len(genomes)), []
        )
        evaluator.close.side_effect = self._give_back
        return evaluator

    def _give_back(self) -> None:
        self._room += 1


@pytest.mark.parametrize(("room", "loads", "last"), [(2, 4, PartialResult), (0, 1, BatchRejected)])
def test_a_scene_that_cannot_be_loaded_is_tried_again_without_the_others(room, loads, last) -> None:
    load = Scarce(room)
    ours, its = Pipe()
    with ours, its:
        main = SimulatorMain(MessageConnection(its), 60.0, load)
        for number in range(room + 1):
            main.evaluate(request(f"{number:064x}"))
        told = MessageConnection(ours)
        said = [told.receive() for _ in range(2 * room + 2 if room else 1)]
    assert load.loads == loads
    assert isinstance(said[-1], last)


def request(scene: str) -> EvaluateRows:
    rows = RowShape(2, 1).empty(1)
    return EvaluateRows(
        scene=scene, bundle=b"", prior="p", n=1, genes=2, columns=pack(rows, WORK_COLUMNS), is_careful=False
    )
