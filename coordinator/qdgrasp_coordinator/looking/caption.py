"""A caption: what stands below a picture of an evaluation."""

from collections.abc import Sequence
from dataclasses import dataclass

from qdgrasp_coordinator.analysis.profile import MEANINGS
from qdgrasp_coordinator.looking.specimen import Specimen
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.replay import Shot

RATE = 240
"""Steps of the simulator in a second."""
PHASES = {
    "placed": "placed, before the hand closes",
    "closing": "closing, {seconds:.2f} s",
    "shake z": "shake along z, {seconds:.2f} s",
    "shake x": "shake about x, {seconds:.2f} s",
}
CLOSED = "after closing"


@dataclass(frozen=True)
class Caption:
    """The words that are the same below all frames of a replay."""

    title: str
    lines: tuple[str, ...]
    closes: int
    """Steps that the hand closed for."""

    @classmethod
    def of(cls, shown: Specimen, shots: Sequence[Shot], unlike: Sequence[str]) -> "Caption":
        """That of a row whose replay differs in `unlike` from what is recorded."""
        spec, row, outcome = shown.found_by.spec, shown.row, shown.outcome
        noun = "grasp" if outcome.is_success else "row"
        trial = f", trial {shown.trial}" if shown.trial else ""
        gripper, target = shown.scene.gripper.name, shown.scene.object.name
        found = f"fitness {row['fitness']:g}, penetration {1000 * row['penetration']:.2g} mm, "
        touching = f"{row['contacts']} finger link{'s' if row['contacts'] != 1 else ''} in contact"
        return cls(
            f"{gripper} on {target}, {noun} {shown.number}{trial}: {_word(outcome)}",
            (
                f"{MEANINGS[outcome]}; {found}{touching}",
                f"protocol {spec.protocol}, {spec.method}, seed {spec.seed}; {_agreement(outcome, unlike)}",
            ),
            max((shot.step for shot in shots if shot.phase == "closing"), default=0),
        )

    def phase(self, shot: Shot) -> str:
        """What happens in a frame."""
        if shot.phase == "closing" and shot.step == self.closes:
            return CLOSED
        return PHASES[shot.phase].format(seconds=shot.step / RATE)


def _word(outcome: Outcome) -> str:
    return outcome.name.lower().replace("_", " ")


def _agreement(outcome: Outcome, unlike: Sequence[str]) -> str:
    """Whether what is seen is what was recorded."""
    if outcome is Outcome.DEAD_END:
        return "not simulated in the run"
    return f"but replayed: {', '.join(unlike)}" if unlike else "replayed as recorded"
