"""Finds of a run made by hand, and records that hold them."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from qdgrasp_assets.scene import Scene
from qdgrasp_coordinator.counts.curve import Curve
from qdgrasp_coordinator.counts.entry import RunEntries
from qdgrasp_coordinator.counts.finds import Found, layout
from qdgrasp_coordinator.monitor.records import JournalId, Page, Place
from qdgrasp_protocol.errors import UnknownName
from qdgrasp_protocol.outcome import Outcome


def finds(
    numbers: ArrayLike,
    places: ArrayLike,
    outcomes: ArrayLike,
    joints: int = 2,
    synergies: ArrayLike = -1,
    etas: ArrayLike = -1,
) -> Found:
    """Finds with these journal numbers (n,), in these cells (n, 3), with these outcomes (n,) and so on."""
    made = np.zeros(len(np.asarray(numbers)), layout(joints))
    made["number"], made["outcome"], made["synergy"], made["eta"] = numbers, outcomes, synergies, etas
    made["descriptor"] = np.asarray(places) / 100
    made["base_to_object"][:, :3] = made["descriptor"]
    made["base_to_object"][:, 6] = 1
    made["fitness"] = made["outcome"].astype(int) - Outcome.DROPPED
    return made


def random_finds(n: int, reach: int = 3, seed: int = 0) -> Found:
    """So many finds in few cells, so that many of them meet; every other row of the journal is one."""
    random = np.random.default_rng(seed)
    places = random.integers(-reach, reach + 1, (n, 3))
    outcomes = random.integers(Outcome.DROPPED, Outcome.HELD + 1, n)
    labels, etas = random.integers(-1, 2, n), random.choice([-1, 0, 0.25, 0.5, 1], n)
    return finds(2 * np.arange(n), places, outcomes, synergies=labels, etas=etas)


ORIGIN = JournalId("1" * 64, 1.0)


@dataclass
class HandMadeRecords:
    """A single run, of whose finds each page has a few; counts what it was asked."""

    a_scene: Scene
    found: Found = field(default_factory=lambda: finds([], np.zeros((0, 3)), []))
    rows: int = 0
    on_a_page: int = 4
    asked: int = 0
    run: str = "run"
    origin: JournalId = ORIGIN
    listed: int = 0

    def record(self, found: Found) -> None:
        """Have found these too."""
        self.found = np.concatenate([self.found, found])
        self.rows = int(self.found["number"][-1]) + 1

    def become(self, scene: Scene, origin: JournalId, found: Found) -> None:
        """Be the records of another job of the same name."""
        self.a_scene, self.origin, self.found = scene, origin, found
        self.rows = int(found["number"][-1]) + 1

    def scene(self, job: str, run: str, digest: str) -> Scene:
        assert digest == self.origin.scene
        return self.a_scene

    def page(self, job: str, run: str, first: int) -> Page:
        self.asked += 1
        if run != self.run:
            raise UnknownName("run", run, [self.run])
        start = int(np.searchsorted(self.found["number"], first))
        shown = self.found[start : start + self.on_a_page]
        more = start + self.on_a_page < len(self.found)
        return Page(
            self.origin, shown, int(shown["number"][-1]) + 1 if more else max(first, self.rows), self.rows
        )

    def entries(self, job: str) -> RunEntries:
        self.listed += 1
        return RunEntries(runs=[])

    def curve(self, job: str, run: str) -> Curve:
        return Curve(run=run, points=[])

    def place(self, job: str, run: str) -> Place:
        return Place("runs/mug")
