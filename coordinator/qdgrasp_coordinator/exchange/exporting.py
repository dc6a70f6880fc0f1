"""Exporting: from a run's folder to a file of grasps."""

from pathlib import Path

import numpy as np

from qdgrasp_assets.convex import Tell, quietly
from qdgrasp_coordinator.exchange.about import about
from qdgrasp_coordinator.exchange.choosing import choose
from qdgrasp_coordinator.exchange.frames import frame_of
from qdgrasp_coordinator.exchange.grasps import Grasps, joined
from qdgrasp_coordinator.exchange.taking import read_grasps
from qdgrasp_coordinator.exchange.writing import ALL, Format, format_of, write
from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.phrases import counted


def export(
    folder: RunFolder,
    out: Path,
    name: str,
    *,
    min_fitness: int = 1,
    top: int | None = None,
    diverse: int | None = None,
    frame: str = "mesh",
    negatives: int | None = None,
    force: bool = False,
    tell: Tell = quietly,
) -> str:
    """Write the chosen grasps of a run in the format of that name.

    Parameters
    ----------
    out
        The file, or folder, that is written; it appears whole or not at all.
    min_fitness, top, diverse
        As in `choose`.
    frame
        "mesh" or "com": where the poses are told.
    negatives
        How many failures are written behind the grasps, at most; None: as many as is usual in the format.
    force
        Whether `out` may be replaced.
    tell
        Hears what is begun with.

    Returns
    -------
    words
        What was written, for a person.

    Raises
    ------
    InputError
        There is no such format or frame, there is nothing to write, or it cannot be read or written.
    """
    form, told_in = format_of(name), frame_of(frame)
    wanted = _negatives(form, negatives)
    output = form.output(out, force=force)
    output.check()
    tell(f"reading {folder.path}")
    every = read_grasps(folder, Outcome.MISSED if wanted else Outcome.DROPPED)
    tell(f"choosing from {counted(len(every), 'evaluation')}")
    chosen = choose(every, min_fitness, top, diverse)
    if not len(chosen):
        raise InputError(_nothing(folder, every, min_fitness))
    failures = _failures(every, chosen, wanted)
    written = joined([chosen, failures])
    tell(f"writing {counted(len(written), 'evaluation')} to {out}")
    write(output, form, written, about(folder, written, told_in))
    beside = f" and {counted(len(failures), 'failure')}" if wanted else ""
    return f"{counted(len(chosen), 'grasp')}{beside} written to {out}, poses in the object's {told_in} frame."


def _negatives(form: Format, asked: int | None) -> int:
    """How many failures are to be written, or `ALL`."""
    if asked and form.negatives is None:
        raise InputError(f"{form.name} has no place for failures; leave --negatives out.")
    return asked if asked is not None else form.negatives or 0


def _failures(every: Grasps, chosen: Grasps, most: int) -> Grasps:
    """The evaluations that were no grasps; of more than `most` some that are spread over the journal."""
    places = np.flatnonzero(~every.is_grasp & ~np.isin(every.numbers, chosen.numbers))
    if most != ALL and most < len(places):
        places = places[np.linspace(0, len(places) - 1, most).round().astype(np.int64)]
    return every[places if most else places[:0]]


def _nothing(folder: RunFolder, every: Grasps, min_fitness: int) -> str:
    """What is said where there is no grasp to write."""
    successes = every[every.is_success]
    if not len(successes):
        with folder.journal() as journal:
            rows = counted(journal.count, "row")
            return f"{folder.path} has no grasp to write: there is no success among {rows}."
    best, many = int(successes.fitness.max()), counted(len(successes), "success", "successes")
    return (
        f"{folder.path} has no grasp with a fitness of {min_fitness} or more: the best of its "
        f"{many} has {best}, and --min-fitness {best} writes those."
    )
