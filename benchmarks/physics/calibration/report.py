"""Page and figure of the calibration study, made of its table and of nothing else."""

import hashlib
import io
import textwrap
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
from benchmarks.physics.calibration import table
from benchmarks.physics.calibration.figure import draw
from benchmarks.physics.calibration.study import (
    DISTURBANCES,
    SCENES,
    SEEDS,
    SEEN,
    UNSEEN,
    Disturbance,
    design_of,
)
from benchmarks.physics.calibration.survival import (
    PREDICTORS,
    Rows,
    by_hand,
    by_scene,
    difference_interval,
    drawn,
    engine_bins,
    eta_bins,
    margin_bins,
    mean_interval,
    of_group,
    predicted,
    survival,
)
from benchmarks.physics.calibration.table import GraspRow, Group

from qdgrasp_coordinator.storage import atomic_files
from qdgrasp_protocol.text import counted
from qdgrasp_tools.report.bootstrap import RESAMPLES
from qdgrasp_tools.report.figure_grid import FIGURE_DPI
from qdgrasp_tools.report.tables import markdown_table

ROBOT = {"panda": 0.95, "allegro": 0.72}
"""Share of grasps that transferred, Huber et al. 2024, Table I, 6DoF; a figure for all objects of a hand."""
TABLE_DIGEST = "Table"
"""Key of the PNG's text that holds the sha256 of the table that it was drawn from."""
WIDTH = 110  # Letters in a line of prose, at most
CODE = 6  # Digits of a digest that tell it from others on a page
GROUPS: tuple[Group, Group] = ("best", "held")
"""The best-ranked grasps, and those that they are compared with."""
SHORT = ("eta", "margin", "both engines")
"""Predictors that have a short name."""
MADE = """
Made by `python -m benchmarks.physics.calibration --page` from [calibration.csv](calibration.csv), which has
a line for each grasp.
"""
NO_ROBOT = """
**No robot was used.** Table I of Huber et al. 2024 reports which share of grasps transferred to a real arm:
0.95 with the Panda gripper and 0.72 with the Allegro hand (6DoF), and 0.84 with the Panda in reach and
grasp. Those are figures of the authors' own grasps, ranked in their simulator. This page stands in the
place of that table: for the same hands and the same four objects it asks, in simulation, whether grasps
that are ranked as [a user would rank them](../trust.md#grasps-for-a-robot) still hold when
something changes that had no part in the ranking. It cannot say how they would fare with a robot.
"""
GRASPS = """
Each run is one of the default method under `physical` in MuJoCo, with surface points of its own seed. Its
grasps are ranked as `qdgrasp rerank` ranks them: candidates are the best of each cell, by fitness and then
by margin, four times as many as are wanted; these are ordered by eta in sequential trials of `robust` with
base `physical`, and of equal etas the greater margin comes first. The margin took the place of the
penetration there after a first version of this study, on the Panda with mug and drill. Looked at are the
*best-ranked* ones, *random held* ones of all others that hold, and random successes of all that are left.
"""
DISTURBED = """
The trials of the ranking displace and turn the object (3 mm and 3 degrees along and about each axis) and
vary its lateral friction by a factor of 0.6 to 1.4. *Unseen* are disturbances of another kind, or greater:
"""
SURVIVED = """
A grasp survives a disturbance if it is `HELD` under it; its *survival* is the share of the unseen ones that
it survives. Intervals are 95 % percentile bootstrap intervals over the grasps of each scene, {resamples:,}
resamples. Seeds and objects are not drawn: they are for these runs and objects alone. Where all n grasps
survived an interval has no width; the true share may still be as low as 1 - 3 / n.
"""
BEST = """
*Eta* is the mean estimate that the best-ranked were chosen by, and so rather too high than too low. Rows of
several objects are means over them. The last column is of other grasps, and of all four objects of a hand.
"""
BY_DISTURBANCE = """
Shares of the best-ranked, and of random held grasps, that are `HELD` under each disturbance: means over the
objects of a hand.
"""
PREDICTED = """
Of two grasps of one hand and object, drawn at random, that survive unequally: how often the one with the
greater figure survives more (*concordance*; where survival is all or nothing, the area under the ROC
curve). 0.5 is chance; equal figures count half. *That hold*: in MuJoCo, undisturbed, as those do that a
user takes. The last column of a hand is of survival of the disturbances of the ranking's kind. In brackets:
grasps.
"""
BINNED = """
Random held grasps and random successes together. A bin of eta has its lower edge, the last one both. Eta is
a share of pushes and survival one of disturbances: they need not be equal, but should rise together.
"""
PICTURE = "![Survival by eta, share held by disturbance, and concordance with survival](calibration.png)\n"


def write(rows: Rows, file: Path) -> None:
    """Write page and figure beside the table's file, of its rows."""
    with atomic_files.writing(file.parent):
        atomic_files.write(file.with_suffix(".md"), page(rows).encode())
        atomic_files.write(file.with_suffix(".png"), png(rows))


def png(rows: Rows) -> bytes:
    """The figure, with the digest of its table."""
    digest, image = hashlib.sha256(table.text(rows).encode()).hexdigest(), io.BytesIO()
    draw(rows).figure.savefig(image, format="png", dpi=FIGURE_DPI, metadata={TABLE_DIGEST: digest})
    return image.getvalue()


def page(rows: Rows) -> str:
    """The whole page."""
    parts = ["# Ranked grasps under other disturbances\n", *_introduction(), _standing(rows)]
    if rows:
        parts += [*_short_part(rows), *_best_part(rows), PICTURE]
        parts += [*_disturbance_part(rows), *_predictor_part(rows), *_bin_part(rows)]
    return "\n".join(parts)


def _introduction() -> Iterator[str]:
    yield from map(filled, (MADE, NO_ROBOT, GRASPS, DISTURBED))
    yield _listed(UNSEEN)
    yield "*Of the ranking's kind* are, for comparison:\n"
    yield _listed(SEEN)
    yield filled(SURVIVED.format(resamples=RESAMPLES))


def filled(words: str, indent: str = "") -> str:
    """A paragraph in lines of `WIDTH`."""
    lines = textwrap.fill(
        " ".join(words.split()), WIDTH,
        subsequent_indent=indent, break_long_words=False, break_on_hyphens=False,
    )  # fmt: skip
    return f"{lines}\n"


def _listed(disturbances: Sequence[Disturbance]) -> str:
    return "".join(filled(f"- *{each.label}*: {each.words}", "  ") for each in disturbances)


def _standing(rows: Rows) -> str:
    """The number of finished runs, with their numbers and code."""
    runs = {row.run: row for row in rows}
    wanted = {(*scene, seed) for scene in SCENES for seed in SEEDS}
    said = f"{len(wanted & runs.keys())} of the {len(wanted)} runs of the study are in"
    others = sum(row.design != design_of(row.gripper).words for row in runs.values())
    said += f", {others} of them with other numbers than the whole study has.\n" if others else ".\n"
    columns = ("hand", "object", "seed", "numbers", "grasps", "code", "MuJoCo's code", "scene")
    lines = [
        (
            *map(str, run), row.design, str(sum(other.run == run for other in rows)),
            *(f"`{digest[:CODE]}`" for digest in (row.code, row.mujoco_code, row.scene)),
        )
        for run, row in sorted(runs.items())
    ]  # fmt: skip
    return f"{said}\n{markdown_table(columns, lines)}" if lines else said


def _short_part(rows: Rows) -> Iterator[str]:
    """The findings of each hand in a sentence or two."""
    yield "## In short\n"
    yield "".join(filled(_finding(hand, some), "  ") for hand, some in by_hand(rows).items())
    yield filled("Intervals are of the grasps of these runs; over other runs they would be wider.", "")


def _finding(hand: str, rows: Rows) -> str:
    best, held = ([of_group(some, group) for some in by_scene(rows).values()] for group in GROUPS)
    pairs = [(survival(one), survival(other)) for one, other in zip(best, held, strict=True)]
    holding = [row for row in drawn(rows) if row.holds]
    words = {name: predicted(holding, name).words for name in SHORT}
    told = ", ".join(f"by {name} in {share}" for name, share in words.items() if share)
    said = (
        f"- **{hand}**, {counted(len(best), 'object')}: the {sum(map(len, best))} best-ranked grasps survive "
        f"{_survived(best)} of the unseen disturbances, {sum(map(len, held))} random ones that hold "
        f"{_survived(held)}; the difference is {difference_interval(pairs).words}."
    )
    if told:
        said += f" Of pairs of random ones that hold, the one that survives more is told {told}."
    return said


def _best_part(rows: Rows) -> Iterator[str]:
    """The table in the place of the paper's."""
    columns = (
        "hand", "object", "best-ranked", "eta", "hold in MuJoCo", "hold in both engines", "survival",
        "survival of those that hold in both", "random held", "survival", "best-ranked less random",
        "robot, in the paper",
    )  # fmt: skip
    lines = []
    for hand, some in by_hand(rows).items():
        scenes = by_scene(some)
        lines += [_best_line(hand, target, [of_scene], "") for (_, target), of_scene in scenes.items()]
        robot = f"{ROBOT[hand]:.2f}" if hand in ROBOT else ""
        lines.append(_best_line(hand, f"**all {len(scenes)}**", list(scenes.values()), robot))
    yield "## The best-ranked grasps\n"
    yield filled(BEST)
    yield markdown_table(columns, lines)


def _best_line(hand: str, target: str, scenes: Sequence[Rows], robot: str) -> tuple[str, ...]:
    best, held = ([of_group(some, group) for some in scenes] for group in GROUPS)
    both = [[row for row in some if row.holds_in_both] for some in best]
    pairs = [(survival(one), survival(other)) for one, other in zip(best, held, strict=True)]
    return (
        hand, target, str(sum(map(len, best))), _mean(best, lambda row: row.eta),
        _mean(best, lambda row: float(row.holds)), _mean(best, lambda row: float(row.holds_in_both)),
        _survived(best), _survived(both), str(sum(map(len, held))), _survived(held),
        difference_interval(pairs).words, robot,
    )  # fmt: skip


def _mean(scenes: Sequence[Rows], of: Callable[[GraspRow], float]) -> str:
    value = mean_interval([np.array([of(row) for row in some]) for some in scenes]).value
    return "" if np.isnan(value) else f"{value:.2f}"


def _survived(scenes: Sequence[Rows], disturbances: Sequence[Disturbance] = UNSEEN) -> str:
    return mean_interval([survival(some, disturbances) for some in scenes]).words


def _disturbance_part(rows: Rows) -> Iterator[str]:
    """Shares held under each disturbance."""
    hands = {hand: list(by_scene(some).values()) for hand, some in by_hand(rows).items()}
    columns = (
        "disturbance", "unseen",
        *(f"{hand}, {words}" for hand in hands for words in ("best-ranked", "random held")),
    )  # fmt: skip
    lines = [
        (
            each.label, "yes" if each.is_unseen else "no",
            *(
                _survived([of_group(some, group) for some in scenes], [each])
                for scenes in hands.values() for group in GROUPS
            ),
        )
        for each in DISTURBANCES
    ]  # fmt: skip
    yield "## Disturbance by disturbance\n"
    yield filled(BY_DISTURBANCE)
    yield markdown_table(columns, lines)


def _predictor_part(rows: Rows) -> Iterator[str]:
    """The part on how well each figure predicts survival."""
    columns: list[tuple[str, ...]] = [("figure", *PREDICTORS)]
    for hand, some in by_hand(drawn(rows)).items():
        holding = [row for row in some if row.holds]
        for words, of_hand, disturbances in (
            ("random", some, UNSEEN),
            ("random that hold", holding, UNSEEN),
            ("random that hold, ranking's kind", holding, SEEN),
        ):
            found = (predicted(of_hand, name, disturbances).words for name in PREDICTORS)
            columns.append((f"{hand}, {words} ({len(of_hand)})", *found))
    head, *lines = zip(*columns, strict=True)
    yield "## How well survival is told beforehand\n"
    yield filled(PREDICTED)
    yield markdown_table(head, lines)


def _bin_part(rows: Rows) -> Iterator[str]:
    """Survival by ranges of the figures that are known beforehand."""
    figures = {"eta": eta_bins, "margin, in its scene": margin_bins, "holds in": engine_bins}
    lines = [
        (hand, figure, each.name, str(len(each.rows)), f"{each.eta:.2f}", each.unseen.words, each.seen.words)
        for hand, some in by_hand(drawn(rows)).items()
        for figure, bins in figures.items()
        for each in bins(some)
    ]
    yield "## Survival by eta, margin and engines\n"
    yield filled(BINNED)
    yield markdown_table(
        ("hand", "figure", "range", "grasps", "mean eta", "survival", "of the ranking's kind"), lines
    )
