"""Chooses grasps of a run by words, and writes a picture of them beside each other."""

import re
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from qdgrasp_coordinator.metrics.grasp_quality import takes_held
from qdgrasp_coordinator.metrics.run_stats import outcome_words
from qdgrasp_coordinator.metrics.success_metrics import FITNESS_COLOURS
from qdgrasp_coordinator.storage.journal import Journal
from qdgrasp_coordinator.storage.outputs import OutFile
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.errors import ImpossibleValue, InputError
from qdgrasp_protocol.process import Stop
from qdgrasp_protocol.rows import Outcome
from qdgrasp_protocol.text import counted
from qdgrasp_tools.export.frames import COM
from qdgrasp_tools.export.grasp_reader import GraspChoice, GraspReader, choose_grasps
from qdgrasp_tools.export.grasp_set import Grasps
from qdgrasp_tools.rendering.contact_sheet import (
    PanelLabel,
    PlacedHands,
    common_camera,
    contact_sheet,
    draw_hands,
)
from qdgrasp_tools.report.row_report import row_at
from qdgrasp_tools.verification.replay_client import NoPose, PictureSize

MOST_PANELS = 48  # Grasps in one picture
RANDOM_SEED = 0  # So that the same command draws the same grasps
CHOICES = "best:N, diverse:N, random:N, or numbers of rows, as in best:12 and 3,17,22"
SMALLEST_PANEL, LARGEST_PANEL = PictureSize(160, 120), PictureSize(960, 720)


FAILURE_COLOUR = "#d3d8dd"  # Of the dot of an evaluation that was no success


def placed_hands(grasps: Grasps, *, pregrasp: bool = False) -> PlacedHands:
    """Return the hands as they settled, or open in the commanded pose.

    A hand that never closed, since it overlapped the object, is open in any case.
    """
    is_open = pregrasp | (grasps.rows["outcome"] < Outcome.MISSED)[:, None]
    poses = np.where(is_open, grasps.poses(COM), grasps.settled_poses(COM))
    joints = np.where(is_open, grasps.pregrasp, grasps.joints).astype(np.float64)
    return PlacedHands(grasps.scene, grasps.rows, poses, joints)


def grasp_labels(grasps: Grasps) -> list[PanelLabel]:
    """Return the words below each grasp: number and outcome, then eta or fitness, and margin."""
    labels = []
    for place in range(len(grasps)):
        outcome, eta = Outcome(grasps.rows["outcome"][place]), grasps.eta[place]
        score = f"fitness {grasps.fitness[place]:g} of {grasps.spec.disturbances}"
        parts = [score if np.isnan(eta) else f"eta {eta:.2f}"]
        if not np.isnan(grasps.margin[place]):
            parts.append(f"margin {grasps.margin[place]:.2g}")
        colour = FITNESS_COLOURS[outcome - Outcome.DROPPED] if outcome.is_success else FAILURE_COLOUR
        title = f"{grasps.numbers[place]}  {outcome_words(outcome)}"
        labels.append(PanelLabel(title, ", ".join(parts), colour))
    return labels


@dataclass(frozen=True)
class SheetChoice:
    """The grasps that a sheet shows: some by rank, or rows by their numbers."""

    rank: str
    """"best", "diverse" or "random"; empty: those of `numbers`."""
    most: int
    numbers: tuple[int, ...] = ()

    @classmethod
    def parse(cls, text: str) -> "SheetChoice":
        """Read a choice such as best:12 or 3,17,22; raises ImpossibleValue for other words."""
        if found := re.fullmatch(r"(best|diverse|random):([1-9]\d{0,8})", text):
            choice = cls(found[1], int(found[2]))
        elif re.fullmatch(r"\d{1,10}(,\d{1,10})*", text):
            numbers = tuple(dict.fromkeys(map(int, text.split(","))))
            choice = cls("", len(numbers), numbers)
        else:
            raise ImpossibleValue("--grasps", text, CHOICES)
        if choice.most > MOST_PANELS:
            raise ImpossibleValue("--grasps", text, f"at most {MOST_PANELS} grasps")
        return choice

    def read(self, folder: RunFolder) -> Grasps:
        """Read the grasps that are chosen.

        Raises NoSuchRow or NoPose for a number without a row or a pose, InputError if there is no grasp, and
        FolderError if the folder cannot be read.
        """
        with folder.journal() as journal:
            reader = GraspReader(folder, journal)
            numbers = self._numbers(folder, journal, reader)
            if not len(numbers):
                raise InputError(
                    f"{folder.path} has no grasp yet with a fitness of 1 or more. Rows by their numbers can "
                    "be drawn all the same, as in --grasps 3,17,22."
                )
            return reader.at(numbers)

    def _numbers(self, folder: RunFolder, journal: Journal, reader: GraspReader) -> NDArray[np.int64]:
        if not self.rank:
            for number in self.numbers:
                row = row_at(folder, journal, number)
                if not row["base_to_object"].any():
                    reason = journal.errors().get(number, "why is not recorded")
                    raise NoPose(number, Outcome(row["outcome"]), reason)
            return np.array(self.numbers, np.int64)
        choice = {
            "best": GraspChoice(top=self.most),
            "diverse": GraspChoice(diverse=self.most),
            "random": GraspChoice(),
        }[self.rank]
        numbers: NDArray[np.int64] = choose_grasps(reader, choice).index["number"]
        if not len(numbers):  # none survived every push: the title says so
            numbers = choose_grasps(reader, replace(choice, min_fitness=1)).index["number"]
        if self.rank == "random" and len(numbers) > self.most:
            drawn = np.random.default_rng(RANDOM_SEED).choice(len(numbers), self.most, replace=False)
            return numbers[np.sort(drawn)]
        return numbers

    def title(self, grasps: Grasps) -> str:
        """Describe hand, object and choice."""
        names = f"{grasps.scene.gripper.name} on {grasps.scene.object.name}"
        ranks = {"best": ", the best first", "diverse": ", well spread", "random": ", drawn at random"}
        noun = "grasp" if grasps.is_success.all() else "row"
        holds = not self.rank or not takes_held(grasps.spec) or (grasps.rows["outcome"] == Outcome.HELD).all()
        note = "" if holds else "; no grasp survived every push"
        return f"{names}: {counted(len(grasps), noun)}{ranks.get(self.rank, '')}{note}"


def write_sheet(
    grasps: Grasps,
    title: str,
    panel: PictureSize,
    out: OutFile,
    stop: Stop,
    *,
    view: tuple[float, float] | None = None,
    pregrasp: bool = False,
    has_labels: bool = True,
) -> None:
    """Write a picture of grasps beside each other, each in a panel of this size above its words.

    Nothing is simulated: hands stand as they are recorded. `view` as of `ReplayOptions`. After a signal
    nothing is written.
    """
    hands = placed_hands(grasps, pregrasp=pregrasp)
    camera = common_camera(hands, panel.width, panel.height, view)
    sheet = contact_sheet(
        draw_hands(hands, camera),
        grasp_labels(grasps),
        title,
        camera,
        has_labels=has_labels,
        is_stopped=lambda: stop.is_set,
    )
    if not stop.is_set:
        with out.writing() as made:
            sheet.save(made, format="PNG")
