"""Exports the selected grasps of a run: the table of formats, and `qdgrasp export`."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from qdgrasp_assets.geometry.collision_parts import Tell, ignore_progress
from qdgrasp_coordinator.metrics.grasp_quality import NO_LIMITS, GraspLimits
from qdgrasp_coordinator.storage.outputs import OutFile, OutFolder, WholeOutput
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.errors import InputError, UnknownName
from qdgrasp_protocol.extras import check_packages
from qdgrasp_protocol.rows import Outcome
from qdgrasp_protocol.text import counted
from qdgrasp_tools.export import acronym, graspgen, isaac_moveit, tabular
from qdgrasp_tools.export.frames import frame_of
from qdgrasp_tools.export.grasp_reader import (
    ALL_FAILURES,
    ChosenGrasps,
    GraspChoice,
    GraspReader,
    choose_grasps,
    read_run,
)
from qdgrasp_tools.export.grasp_set import Grasps, select_grasps
from qdgrasp_tools.export.metadata import NOT_SETTLED, GraspMetadata, PosePlaces, grasp_metadata


@dataclass(frozen=True)
class ExportFormat:
    """One format of files of grasps."""

    name: str
    write: Callable[[Path, ChosenGrasps, GraspMetadata], None]
    suffix: str
    """Ending of its files; empty: it is a folder."""
    places: PosePlaces
    default_failures: int | None = 0
    """Failures that are written by default; None: the format has no place for them."""
    packages: tuple[str, ...] = ()
    """Packages of extras that write it."""

    def failures(self, negatives: int | None) -> int:
        """Return how many failures are written at most, where so many are asked for."""
        if negatives and self.default_failures is None:
            raise InputError(f"{self.name} has no place for failures; leave --negatives out.")
        return negatives if negatives is not None else self.default_failures or 0

    def output(self, path: Path, *, force: bool = False) -> WholeOutput:
        """Return the file or folder at a path; `force` replaces one of the same format."""
        if self.suffix:
            return OutFile(path, force=force)
        return OutFolder(path, force=force, is_kind=graspgen.is_ours)


def _at_once(
    write: Callable[[Path, Grasps, GraspMetadata], None],
) -> Callable[[Path, ChosenGrasps, GraspMetadata], None]:
    """Have grasps written by a function that takes them all at once, in memory."""
    return lambda path, chosen, metadata: write(path, chosen.whole, metadata)


ISAAC_PLACES = PosePlaces(
    "pregrasp_position, pregrasp_orientation, pregrasp_cspace_position",
    "position, orientation, cspace_position",
)
ACRONYM_PLACES = PosePlaces(
    "grasps/transforms, grasps/pregrasp_joint_positions",
    "grasps/settled_transforms, grasps/joint_positions",
    "grasps/contact_links, contact_points, contact_normals, contact_forces",
)
GRASPGEN_PLACES = PosePlaces(
    "grasps.transforms, qdgrasp.grasps.pregrasp_joint_positions",
    "qdgrasp.grasps.settled_transforms, joint_positions",
    "qdgrasp.grasps.contacts",
)
CSV_PLACES = PosePlaces("x to qw, pregrasp.*", "settled_x to settled_qw, joint.*")
PARQUET_PLACES = replace(CSV_PLACES, contacts=tabular.CONTACTS)
MOVEIT_PLACES = PosePlaces("grasp_pose, pre_grasp_posture", "qdgrasp.grasps.settled_poses, grasp_posture")

FORMATS = {
    each.name: each
    for each in (
        ExportFormat(
            "isaac", _at_once(isaac_moveit.write_isaac), ".yaml", ISAAC_PLACES, default_failures=None
        ),
        ExportFormat("acronym", _at_once(acronym.write), ".h5", ACRONYM_PLACES, packages=("h5py",)),
        ExportFormat("graspgen", graspgen.write, "", GRASPGEN_PLACES, default_failures=ALL_FAILURES),
        ExportFormat("parquet", tabular.write_parquet, ".parquet", PARQUET_PLACES, packages=("pyarrow",)),
        ExportFormat("webdataset", tabular.write_tar, ".tar", PARQUET_PLACES),
        ExportFormat(
            "moveit", _at_once(isaac_moveit.write_moveit), ".yaml", MOVEIT_PLACES, default_failures=None
        ),
        ExportFormat("csv", _at_once(tabular.write_csv), ".csv", CSV_PLACES),
    )
}


def format_of(name: str) -> ExportFormat:
    """Return the format of that name; raises UnknownName or MissingPackage."""
    if name not in FORMATS:
        raise UnknownName("format", name, FORMATS)
    check_packages(f"The format {name}", *FORMATS[name].packages)
    return FORMATS[name]


def export_run(
    folder: RunFolder,
    out: Path,
    name: str,
    *,
    min_fitness: int | None = None,
    min_quality: float = 0.0,
    top: int | None = None,
    diverse: int | None = None,
    limits: GraspLimits = NO_LIMITS,
    holds_in: str | None = None,
    approach_distance: float | None = None,
    resting_pose: int | str | None = None,
    frame: str = "mesh",
    negatives: int | None = None,
    force: bool = False,
    tell: Tell = ignore_progress,
) -> str:
    """Write the chosen grasps of a run in the format of that name; returns a sentence about it.

    The file or folder `out` appears whole or not at all; `force` lets it be replaced. `min_fitness`, `top`,
    `diverse`, `limits` and `holds_in` are as in `select_grasps`; `min_quality` is a least confidence;
    `approach_distance` [m] and `resting_pose` say how hands come to grasps, as in `GraspChoice`; poses are in
    the object's `frame`, "mesh" or "com". At most `negatives` failures are written behind the grasps; None:
    as many as is usual in the format. `tell` is called with each step that begins. Raises InputError if there
    is no such format or frame, there is nothing to write, or it cannot be read or written.
    """
    form, object_frame = format_of(name), frame_of(frame)
    wanted = form.failures(negatives)
    choice = GraspChoice(
        min_fitness, min_quality, top, diverse, limits, holds_in, approach_distance, resting_pose
    )
    output = form.output(out, force=force)
    output.check()
    tell(f"reading {folder.path}")
    with folder.journal() as journal:
        chosen = choose_grasps(GraspReader(folder, journal), choice, wanted)
        if len(chosen) == chosen.failures:
            raise InputError(_no_grasps(folder, choice))
        tell(f"writing {counted(len(chosen), 'evaluation')} to {out}")
        metadata = grasp_metadata(folder, chosen, object_frame, form.places)
        with output.writing() as made:
            form.write(made, chosen, metadata)
    beside = f" and {counted(chosen.failures, 'failure')}" if wanted else ""
    grasps_written = f"{counted(len(chosen) - chosen.failures, 'grasp')}{beside} written to {out}"
    note = f" But {NOT_SETTLED}." if metadata.settled == NOT_SETTLED else ""
    if holds_in is not None:
        unknown = counted(chosen.unknown, "grasp")
        note += f" Left out: {unknown} whose verdict in {holds_in} is not known."
    return f"{grasps_written}, poses in the object's {object_frame} frame.{note}"


def _no_grasps(folder: RunFolder, choice: GraspChoice) -> str:
    successes = read_run(folder)
    if not len(successes):
        with folder.journal() as journal:
            rows = counted(journal.count, "row")
        return f"{folder.path} has no grasp to write: there is no success among {rows}."
    best, many = int(successes.fitness.max()), counted(len(successes), "success", "successes")
    if len(good := select_grasps(successes, choice.min_fitness)):
        if choice.holds_in is not None:
            found = good.verdicts_in(choice.holds_in)
            held = int((found == Outcome.HELD).sum())
            here = f"of {counted(len(good), 'grasp')} {held} hold in {choice.holds_in}"
            good = good[found == Outcome.HELD]
            if not len(good):
                return f"{folder.path} has no such grasp: {here}, {int((found < 0).sum())} are not known."
        check = choice.reachability(good.scene, good.spec)
        if check is not None:
            if not len(reached := select_grasps(good, 0, approach=check)):
                return f"{folder.path} has no such grasp: of {counted(len(good), 'grasp')} none is reachable."
            good = reached
        admitted = choice.limits.admitted(good.rows, good.scene)
        if admitted.any():
            highest = good.confidence[admitted].max()
            return (
                f"{folder.path} has no grasp of this confidence: the best has {highest:.3g} "
                "(--min-confidence)."
            )
        return (
            f"{folder.path} has no grasp within these limits: {choice.limits.reason(good.rows, good.scene)}."
        )
    some = ", --min-fitness 1 all that survived some disturbance" if best > 1 else ""
    return (
        f"{folder.path} has no grasp that survived as many disturbances: the best of its {many} has "
        f"fitness {best}, and --min-fitness {best} writes those{some}."
    )
