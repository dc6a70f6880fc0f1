"""Writes the replay of an evaluation as a PNG or a GIF, annotated, above a caption."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from PIL import Image, ImageColor, ImageDraw

from qdgrasp_assets.scene import SceneGripper
from qdgrasp_coordinator.metrics.run_stats import outcome_words
from qdgrasp_coordinator.storage.outputs import OutFile
from qdgrasp_protocol.process import Stop
from qdgrasp_protocol.replay_messages import ReplayFrame
from qdgrasp_protocol.rows import Outcome
from qdgrasp_protocol.text import counted
from qdgrasp_tools.rendering import annotations
from qdgrasp_tools.rendering.annotations import INK, Canvas, CoveredArea, fitting_size, label_font
from qdgrasp_tools.report import row_report
from qdgrasp_tools.verification import comparison
from qdgrasp_tools.verification.replay_client import (
    PictureSize,
    ReplayedEvaluation,
    ReplayOptions,
    ReplayTarget,
    local_platform,
    replay_evaluation,
)

REPLAY_MEANINGS = row_report.OUTCOME_MEANINGS | {
    Outcome.DEAD_END: "none of its poses was free and promised enough; this is the first of them"
}
STEPS_PER_SECOND = 240  # Steps of the simulator in a second
PHASE_WORDS = {
    "placed": "as it is placed, before the hand closes",
    "closing": "closing, {seconds:.2f} s",
    "shake z": "shake along z, {seconds:.2f} s",
    "shake x": "shake about x, {seconds:.2f} s",
    "settling": "settling, {seconds:.2f} s",
    "pushes": "pushes, {seconds:.2f} s",
    "lift": "lift, {seconds:.2f} s",
}


@dataclass(frozen=True)
class ReplayCaption:
    """The words that are the same below all frames of a replay."""

    title: str
    lines: tuple[str, ...]
    closing_steps: int

    @classmethod
    def of(
        cls, shown: ReplayTarget, shots: Sequence[ReplayFrame], differences: Sequence[str]
    ) -> "ReplayCaption":
        """Make the caption of a row whose replay differs in `differences` from what is recorded."""
        spec, outcome = shown.found_by.spec, shown.outcome
        made = f"protocol {spec.protocol_words}, method {spec.method}, seed {spec.seed}"
        agreement = f"but replayed: {', '.join(differences)}" if differences else "replayed as recorded"
        if outcome is Outcome.DEAD_END:
            agreement = "not simulated in the run"
        return cls(
            _title(shown),
            (f"{REPLAY_MEANINGS[outcome]}{_contact_words(shown)}", f"{made}; {agreement}"),
            max((shot.step for shot in shots if shot.phase == "closing"), default=0),
        )

    def phase(self, shot: ReplayFrame) -> str:
        """Describe what happens in a frame."""
        if shot.phase == "closing" and shot.step == self.closing_steps:
            return "after closing"
        return PHASE_WORDS[shot.phase].format(seconds=shot.step / STEPS_PER_SECOND)


def _title(shown: ReplayTarget) -> str:
    outcome = shown.outcome
    noun = "grasp" if outcome.is_success else "row"
    trial = f", trial {shown.trial}" if shown.trial else ""
    found = f"{outcome_words(outcome)}, fitness {shown.row['fitness']:g}"
    return f"{shown.scene.gripper.name} on {shown.scene.object.name}, {noun} {shown.number}{trial}: {found}"


def _contact_words(shown: ReplayTarget) -> str:
    if not shown.outcome.is_success:
        return ""
    links = counted(int(shown.row["contacts"]), "finger link")
    return f"; {links} in contact, penetration {1000 * shown.row['penetration']:.2g} mm"


SMALLEST, LARGEST = PictureSize(320, 240), {".png": PictureSize(3840, 2160), ".gif": PictureSize(1280, 960)}
"""Least size of a picture, and the greatest by file ending: a film has some ninety frames."""
FAINT = "#5c646d"
MARGIN = 10  # Pixels beside and between words
PALETTE_IMAGES = 8  # Frames that a film's colours are taken from
PALETTE_COLOURS = 128  # Colours of a film besides those of marks and words
WHITE = 255  # Of the ground, on which nothing is drawn
LEGEND_GAP = 12  # Least difference of a film's colours from those of marks, in red, green or blue, of 255


class PictureLayout:
    """Division of a picture of some size: the scene above, words below unless it has none."""

    def __init__(self, size: PictureSize, *, has_labels: bool = True) -> None:
        self.size = size
        self.has_labels = has_labels
        self.large = max(12, min(size.width // 40, size.height // 32))
        """Height of the title's letters; those of other words are smaller [pixels]."""
        self.small = round(0.8 * self.large)
        self._rows = [self.large, *[self.small] * 4]

    @property
    def scene(self) -> PictureSize:
        """Size of the replayed scene."""
        if not self.has_labels:
            return self.size
        caption = 2 * MARGIN + sum(map(self._step, self._rows))
        return PictureSize(self.size.width, self.size.height - caption)

    @property
    def heights(self) -> list[int]:
        """Vertical middles of the rows of words [pixels]."""
        top = self.scene.height + MARGIN
        return [top + sum(map(self._step, self._rows[:n])) + row // 2 for n, row in enumerate(self._rows)]

    @staticmethod
    def _step(size: int) -> int:
        return round(1.45 * size)


def replay_pictures(
    replay: ReplayedEvaluation, gripper: SceneGripper, caption: ReplayCaption, layout: PictureLayout
) -> Iterator[Image.Image]:
    """Yield each frame of a replay with annotations and caption."""
    shots = replay.answer.shots
    marks = annotations.SceneAnnotations(gripper, replay.answer.camera, layout.small)
    # what hand or object cover in any frame: in a film words then move little while the hand does
    covered = CoveredArea(replay.frames.min(axis=(0, -1)) < WHITE)
    legend = [
        *annotations.AXIS_COLOURS.items(),
        ("approach axis", annotations.APPROACH_COLOUR),
        *((annotations.CONTACT_WORDS[hue], hue) for hue in annotations.contact_colours(shots)),
    ]
    for frame, shot in zip(replay.frames, shots, strict=True):
        canvas = Canvas(frame, covered)
        marks.draw(canvas, shot)
        if layout.has_labels:
            yield _with_words(canvas.composed(), caption, shot, legend, layout)
        else:
            yield canvas.composed(has_words=False)


def write_pictures(path: Path, images: Iterator[Image.Image], shots: Sequence[ReplayFrame]) -> None:
    """Write the pictures of a replay to a new file: a PNG of the last of them, or a GIF of all."""
    if path.suffix.lower() == ".gif":
        _write_gif(path, list(images), shots)
    else:
        list(images)[-1].save(path, format="PNG")


def _with_words(
    scene: Image.Image,
    caption: ReplayCaption,
    shot: ReplayFrame,
    legend: Sequence[tuple[str, str]],
    layout: PictureLayout,
) -> Image.Image:
    whole = Image.new("RGB", layout.size, "white")
    whole.paste(scene)
    pen = ImageDraw.Draw(whole)
    pen.line([0, scene.height, scene.width, scene.height], fill="#d9dde1")
    lines = [caption.title, *caption.lines, caption.phase(shot)]
    sizes = [layout.large, *[layout.small] * len(lines)]
    for height, size, words in zip(layout.heights, sizes, lines, strict=False):
        font = label_font(fitting_size(pen, words, size, layout.size.width - 2 * MARGIN))
        pen.text((MARGIN, height), words, INK if words is caption.title else FAINT, font, anchor="lm")
    _write_legend(pen, layout, legend)
    return whole


def _write_legend(pen: ImageDraw.ImageDraw, layout: PictureLayout, legend: Sequence[tuple[str, str]]) -> None:
    """Draw what the colours mean, side by side in the last line, in letters as small as needed."""
    height, x, line = layout.heights[-1], float(MARGIN), " ".join(word for word, _ in legend)
    size = fitting_size(pen, line, layout.small, layout.size.width, 3 * len(legend))
    for words, colour in legend:
        pen.ellipse([x, height - size // 3, x + 2 * (size // 3), height + size // 3], fill=colour)
        pen.text((x + size, height), words, FAINT, label_font(size), anchor="lm")
        x += pen.textlength(words, label_font(size)) + 2.5 * size


def _write_gif(path: Path, images: Sequence[Image.Image], shots: Sequence[ReplayFrame]) -> None:
    """Write all frames in one set of colours, so that nothing flickers."""
    palette = _palette(images[:: max(1, len(images) // PALETTE_IMAGES)])
    first, *others = (image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images)
    ends = np.rint(100 * np.cumsum([shot.seconds for shot in shots])).astype(int)  # a GIF counts in 10 ms
    durations = (10 * np.diff(ends, prepend=0)).tolist()
    first.save(path, format="GIF", save_all=True, append_images=others, duration=durations, loop=0)


def _palette(images: Sequence[Image.Image]) -> Image.Image:
    """Return a palette: the exact colours of marks and words, and those for all others."""
    sheet = Image.new("RGB", (images[0].width, images[0].height * len(images)))
    for place, image in enumerate(images):
        sheet.paste(image, (0, place * image.height))
    reduced = sheet.quantize(PALETTE_COLOURS, method=Image.Quantize.MEDIANCUT).convert("RGB")
    found = reduced.getcolors(PALETTE_COLOURS) or []
    exact = np.array([*map(ImageColor.getrgb, ("white", FAINT, INK, *annotations.ANNOTATION_COLOURS))])
    others = np.array([colour for _, colour in found])
    is_apart = np.abs(others[:, None] - exact).max(axis=2).min(axis=1) > LEGEND_GAP
    palette = Image.new("P", (1, 1))
    palette.putpalette(np.concatenate([exact, others[is_apart]]).ravel().tolist())
    return palette


def write_evaluation(
    shown: ReplayTarget, options: ReplayOptions, out: OutFile, stop: Stop, *, has_labels: bool = True
) -> list[str]:
    """Replay a row and write its picture or film of `options.size`, with words or without.

    Returns what the replay found in place of what is recorded, column by column; nothing where they agree,
    and of a dead end, which was not simulated. Raises InputError if the part that is asked for did not
    happen, or the file cannot be written, and ReplayFailed if it could not be replayed.
    """
    layout = PictureLayout(options.size, has_labels=has_labels)
    with replay_evaluation(shown, replace(options, size=layout.scene), stop) as replay:
        if replay is None:
            return []
        differences, shots = list[str](), replay.answer.shots
        if shown.outcome is not Outcome.DEAD_END:
            now = comparison.row_with_answer(shown.row, replay.answer)
            differences = comparison.difference_words(comparison.row_differences(shown.row, now))
        caption = ReplayCaption.of(shown, shots, differences)
        with out.writing() as made:
            write_pictures(made, replay_pictures(replay, shown.scene.gripper, caption, layout), shots)
    return differences


def difference_reason(shown: ReplayTarget, differences: list[str]) -> str:
    """Describe the differences, and how this platform differs from that of the row."""
    return (
        f"The replay differs from row {shown.number}: {', '.join(differences)}. "
        f"{comparison.platform_words(shown.found_by.platform, local_platform())}"
    )
