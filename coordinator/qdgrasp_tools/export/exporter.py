"""Exports grasps: of a run to a file, of several runs and campaigns to a data set."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from qdgrasp_assets.geometry.collision_parts import Tell, ignore_progress
from qdgrasp_coordinator.storage.job_folder import JobFolder
from qdgrasp_coordinator.storage.outputs import OutFile, OutFolder, Output
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.errors import InputError, UnknownName, check_packages
from qdgrasp_protocol.rows import Outcome
from qdgrasp_protocol.text import counted
from qdgrasp_tools.export import jaw_files, tabular, yaml_files
from qdgrasp_tools.export.frames import Frame, frame_of
from qdgrasp_tools.export.grasp_reader import (
    ALL_FAILURES,
    ALL_GRASPS,
    NOT_SETTLED,
    ChosenGrasps,
    GraspChoice,
    choose_grasps,
    grasp_metadata,
    read_journal,
    read_run,
)
from qdgrasp_tools.export.grasp_table import GraspMetadata, RunTable


@dataclass(frozen=True)
class ExportFormat:
    """One format of files of grasps."""

    name: str
    suffix: str
    """Ending of its files; empty: it is a folder."""
    write_table: Callable[[Path, RunTable], None] | None = None
    """Writes all grasps at once; None: `write_parts` does, part by part."""
    write_parts: Callable[[Path, Iterable[RunTable]], None] | None = None
    default_failures: int | None = 0
    """Failures that are written by default; None: the format has no place for them."""
    packages: tuple[str, ...] = ()
    """Packages of extras that write it."""

    def failures(self, negatives: int | None) -> int:
        """Return how many failures are written at most, where so many are asked for."""
        if negatives and self.default_failures is None:
            raise InputError(f"{self.name} has no place for failures; leave --negatives out.")
        return negatives if negatives is not None else self.default_failures or 0

    def write(self, path: Path, chosen: ChosenGrasps, metadata: GraspMetadata) -> None:
        """Write the chosen grasps of a run."""
        if self.write_table:
            self.write_table(path, chosen.grasps.table(metadata.frame, metadata))
        elif self.write_parts:
            self.write_parts(path, chosen.tables(metadata.frame, metadata))


FORMATS = {
    each.name: each
    for each in (
        ExportFormat("isaac", ".yaml", yaml_files.write_isaac, default_failures=None),
        ExportFormat("acronym", ".h5", jaw_files.write_acronym, packages=("h5py",)),
        ExportFormat("graspgen", "", write_parts=jaw_files.write_graspgen, default_failures=ALL_FAILURES),
        ExportFormat("parquet", ".parquet", write_parts=tabular.write_parquet, packages=("pyarrow",)),
        ExportFormat("webdataset", ".tar", write_parts=tabular.write_tar),
        ExportFormat("moveit", ".yaml", yaml_files.write_moveit, default_failures=None),
        ExportFormat("csv", ".csv", tabular.write_csv),
    )
}


def format_of(name: str) -> ExportFormat:
    """Return the format of that name; raises UnknownName or MissingPackage."""
    if name not in FORMATS:
        raise UnknownName("format", name, FORMATS)
    check_packages(f"The format {name}", *FORMATS[name].packages)
    return FORMATS[name]


def run_folders(directories: Sequence[Path]) -> list[RunFolder]:
    """Return the runs in folders of runs and campaigns, each once; raises FolderError."""
    found = []
    for directory in directories:
        is_campaign = JobFolder.is_job(directory) and JobFolder(directory).is_campaign
        paths = JobFolder(directory).run_paths if is_campaign else [directory]
        found += [RunFolder.open(path) for path in paths if not is_campaign or RunFolder.is_run(path)]
    return list({folder.path.resolve(): folder for folder in found}.values())


def export_run(
    folder: RunFolder,
    out: Path,
    name: str,
    choice: GraspChoice = ALL_GRASPS,
    *,
    frame: str = "mesh",
    negatives: int | None = None,
    force: bool = False,
    tell: Tell = ignore_progress,
) -> str:
    """Write the chosen grasps of a run in the format of that name; returns a sentence about it.

    The file or folder `out` appears whole or not at all; `force` lets it be replaced. Poses are in the
    object's `frame`, "mesh" or "com". At most `negatives` failures are written behind the grasps; None: as
    many as is usual in the format. `tell` is called with each step that begins. Raises InputError if there is
    no such format or frame, there is nothing to write, or it cannot be read or written.
    """
    form, object_frame = format_of(name), frame_of(frame)
    wanted = form.failures(negatives)
    output: Output = OutFile(out, force=force)
    if not form.suffix:
        output = OutFolder(out, force=force, is_kind=jaw_files.is_graspgen)
    output.check()
    tell(f"reading {folder.path}")
    with folder.journal() as journal:
        least = Outcome.MISSED if wanted else Outcome.DROPPED
        chosen = choose_grasps(read_journal(folder, journal, least), choice, wanted)
        if len(chosen.grasps) == chosen.failures:
            raise InputError(_no_grasps(folder, choice, journal.count))
        tell(f"writing {counted(len(chosen.grasps), 'evaluation')} to {out}")
        metadata = grasp_metadata(chosen, object_frame, journal)
        with output.writing() as made:
            form.write(made, chosen, metadata)
    return _written(out, chosen, choice, metadata, object_frame)


def _written(
    out: Path, chosen: ChosenGrasps, choice: GraspChoice, metadata: GraspMetadata, frame: Frame
) -> str:
    beside = f" and {counted(chosen.failures, 'failure')}" if chosen.failures else ""
    grasps = f"{counted(len(chosen.grasps) - chosen.failures, 'grasp')}{beside} written to {out}"
    note = f" But {NOT_SETTLED}." if metadata.settled == NOT_SETTLED else ""
    if choice.holds_in is not None:
        unknown = counted(chosen.unknown, "grasp")
        note += f" Left out: {unknown} whose verdict in {choice.holds_in} is not known."
    return f"{grasps}, poses in the object's {frame} frame.{note}"


def _no_grasps(folder: RunFolder, choice: GraspChoice, rows: int) -> str:
    """Return why a run has nothing to write."""
    successes = read_run(folder)
    if not len(successes):
        return f"{folder.path} has no grasp to write: there is no success among {counted(rows, 'row')}."
    best, many = int(successes.fitness.max()), counted(len(successes), "success", "successes")
    return (
        f"{folder.path} has no such grasp: the best of its {many} has fitness {best} and confidence "
        f"{successes.confidence.max():.3g}. --min-fitness 0 takes every success; other limits may be too "
        "narrow."
    )
