"""A caption: what stands below a picture of an evaluation."""

from collections.abc import Sequence
from dataclasses import dataclass

from qdgrasp_coordinator.analysis import profile
from qdgrasp_coordinator.looking.specimen import Specimen
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.replay import Shot

MEANINGS = profile.MEANINGS | {
    Outcome.DEAD_END: "none of its poses was free and promised enough; this is the first of them"
}
RATE = 240
"""Steps of the simulator in a second."""
PHASES = {
    "placed": "as it is placed, before the hand closes",
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
        spec, outcome = shown.found_by.spec, shown.outcome
        made = f"protocol {spec.protocol}, method {spec.method}, seed {spec.seed}"
        return cls(
            _title(shown),
            (f"{MEANINGS[outcome]}{_found(shown)}", f"{made}; {_agreement(outcome, unlike)}"),
            max((shot.step for shot in shots if shot.phase == "closing"), default=0),
        )

    def phase(self, shot: Shot) -> str:
        """What happens in a frame."""
        if shot.phase == "closing" and shot.step == self.closes:
            return CLOSED
        return PHASES[shot.phase].format(seconds=shot.step / RATE)


def _title(shown: Specimen) -> str:
    """What it is, and what came of it."""
    outcome = shown.outcome
    noun = "grasp" if outcome.is_success else "row"
    trial = f", trial {shown.trial}" if shown.trial else ""
    found = f"{outcome.name.lower().replace('_', ' ')}, fitness {shown.row['fitness']:g}"
    return f"{shown.scene.gripper.name} on {shown.scene.object.name}, {noun} {shown.number}{trial}: {found}"


def _found(shown: Specimen) -> str:
    """What is known of a success besides."""
    if not shown.outcome.is_success:
        return ""
    links = int(shown.row["contacts"])
    touching = f"{links} finger link{'s' if links != 1 else ''} in contact"
    return f"; {touching}, penetration {1000 * shown.row['penetration']:.2g} mm"


def _agreement(outcome: Outcome, unlike: Sequence[str]) -> str:
    """Whether what is seen is what was recorded."""
    if outcome is Outcome.DEAD_END:
        return "not simulated in the run"
    return f"but replayed: {', '.join(unlike)}" if unlike else "replayed as recorded"
