"""Replaying: a process of the worker's room carries one evaluation out again, and gives frames back."""

import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from qdgrasp_coordinator.looking.specimen import Specimen
from qdgrasp_coordinator.watching.workers import GRACE
from qdgrasp_protocol.crew import Crew, Death
from qdgrasp_protocol.errors import InputError, QdgraspError
from qdgrasp_protocol.lifetime import Stop
from qdgrasp_protocol.replay import ANSWER, FRAMES, REQUEST, SCENE, Answer, Request, What

MODULE = "qdgrasp_worker.replaying"
LOOK_INTERVAL = 0.05  # seconds between two looks whether it is done


class Size(NamedTuple):
    """Of a picture, in pixels."""

    width: int
    height: int

    def __str__(self) -> str:
        return f"{self.width}x{self.height}"


@dataclass(frozen=True)
class Wish:
    """How an evaluation is to be shown."""

    size: Size
    view: tuple[float, float] | None = None
    """Azimuth and elevation of the camera [deg]; None: where the most is seen."""
    what: What | None = None
    """The part that is filmed; None: a still."""
    parts: bool = False
    """Whether the object is drawn as its convex parts."""

    def of(self, shown: Specimen) -> Request:
        """What the process is asked."""
        return Request(
            genome=shown.genome,
            trial=shown.trial,
            width=self.size.width,
            height=self.size.height,
            view=self.view,
            what=self.what,
            parts=self.parts,
        )


@dataclass(frozen=True)
class Replay:
    """An evaluation as it was seen again."""

    answer: Answer
    frames: NDArray[np.uint8]
    """(n, rows, columns, 3), read from the disk as they are asked for."""


class NotReplayed(QdgraspError):
    """The process that replays ended without an answer."""

    def __init__(self, death: Death, said: str) -> None:
        super().__init__(f"The process that replays {death.words}. {said}".strip())


@contextmanager
def replayed(shown: Specimen, wish: Wish, stop: Stop) -> Iterator[Replay | None]:
    """The replay of a row, while its frames are looked at; None where a signal came first.

    Raises
    ------
    InputError
        The part that is asked for did not happen.
    NotReplayed
        It could not be replayed.
    """
    with tempfile.TemporaryDirectory(prefix="qdgrasp-") as name:
        folder = Path(name)
        (folder / SCENE).write_bytes(shown.bundle.payload)
        (folder / REQUEST).write_bytes(msgspec.json.encode(wish.of(shown)))
        _carry_out(folder, stop)
        yield None if stop.is_set else _read(folder)


def platform() -> dict[str, str]:
    """What decides the bits of results on this machine."""
    told = subprocess.run(
        [sys.executable, "-m", "qdgrasp_worker.cli", "--self-test"],
        capture_output=True,
        check=True,
        text=True,
    )
    return dict(json.loads(told.stdout))


def _carry_out(folder: Path, stop: Stop) -> None:
    """Have the process do its work, and wait for it."""
    with Crew(folder, GRACE) as crew:
        crew.hire("replay", MODULE, [str(folder)])
        while not (stop.is_set or (ended := crew.deaths())):
            _wait(crew)
        for death in () if stop.is_set else ended:
            _check(death, crew)


def _wait(crew: Crew) -> None:
    try:
        crew.process("replay").wait(LOOK_INTERVAL)
    except subprocess.TimeoutExpired:
        return


def _check(death: Death, crew: Crew) -> None:
    said = crew.last_words(death.name)
    if death.exit_code == InputError.exit_code:
        raise InputError(said)
    if death.exit_code:
        raise NotReplayed(death, said)


def _read(folder: Path) -> Replay:
    answer = msgspec.json.decode((folder / ANSWER).read_bytes(), type=Answer)
    return Replay(answer, np.load(folder / FRAMES, mmap_mode="r", allow_pickle=False))
