"""Exports grasps: of a run to a file, of runs and campaigns to a data set with a card."""

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from string import Template
from typing import Any

from qdgrasp_assets.geometry.collision_parts import Tell, ignore_progress
from qdgrasp_coordinator.metrics.grasp_quality import takes_held
from qdgrasp_coordinator.metrics.run_stats import count_rows
from qdgrasp_coordinator.storage.journal import Journal
from qdgrasp_coordinator.storage.outputs import OutFile, OutFolder, Output
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_coordinator.storage.tables import csv_text
from qdgrasp_protocol.errors import FolderError, InputError, UnknownName, check_packages
from qdgrasp_protocol.keys import job_name
from qdgrasp_protocol.rows import Outcome
from qdgrasp_protocol.spec import ENGINES, ObjectRecord
from qdgrasp_protocol.text import counted
from qdgrasp_tools.export import arrays, jaw_files, tabular, yaml_files
from qdgrasp_tools.export.grasp_reader import (
    ALL_FAILURES,
    ALL_GRASPS,
    OBJECT_FRAMES,
    ChosenGrasps,
    GraspChoice,
    choose_grasps,
    grasp_metadata,
    read_journal,
)
from qdgrasp_tools.export.grasp_set import Grasps
from qdgrasp_tools.export.grasp_table import (
    FITNESS_MEANING,
    UNITS,
    Frame,
    GraspMetadata,
    common_values,
    frame_of,
)
from qdgrasp_tools.export.yaml_files import to_yaml


@dataclass(frozen=True)
class ExportFormat:
    """One format of files of grasps."""

    name: str
    suffix: str
    """Ending of its files; empty: it is a folder."""
    write: Callable[[Path, Grasps, GraspMetadata], None]
    default_failures: int | None = 0
    """Failures that are written by default; None: the format has no place for them."""
    packages: tuple[str, ...] = ()
    """Packages of extras that write it."""
    has_mesh: bool = False
    """True: the object's mesh lies beside its file (`jaw_files.mesh_beside`)."""

    def failures(self, negatives: int | None) -> int:
        """Return how many failures are written at most, where so many are asked for."""
        if negatives and self.default_failures is None:
            raise InputError(f"{self.name} has no place for failures; leave --negatives out.")
        return negatives if negatives is not None else self.default_failures or 0


FORMATS = {
    each.name: each
    for each in (
        ExportFormat("isaac", ".yaml", yaml_files.write_isaac, default_failures=None),
        ExportFormat("acronym", ".h5", jaw_files.write_acronym, ALL_FAILURES, ("h5py",), has_mesh=True),
        ExportFormat("graspgen", "", jaw_files.write_graspgen, default_failures=ALL_FAILURES),
        ExportFormat("parquet", ".parquet", tabular.write_parquet, packages=("pyarrow",)),
        ExportFormat("webdataset", ".tar", tabular.write_tar),
        ExportFormat("moveit", ".yaml", yaml_files.write_moveit, default_failures=None),
        ExportFormat("csv", ".csv", tabular.write_csv),
        ExportFormat("molmospaces", ".npz", arrays.write_molmospaces, default_failures=None),
        ExportFormat("curobo", ".npz", arrays.write_curobo, default_failures=None),
        ExportFormat("dexgraspbench", "", arrays.write_dexgraspbench, default_failures=None),
        ExportFormat("bundle", "", arrays.write_bundle),
    )
}


def is_folder(path: Path) -> bool:
    """Return whether a folder is one of a format."""
    return {each.name for each in path.iterdir()} in (jaw_files.FOLDERS, arrays.FOLDERS, arrays.BUNDLE)


def format_of(name: str) -> ExportFormat:
    """Return the format of that name; raises UnknownName or InputError."""
    if name not in FORMATS:
        raise UnknownName("format", name, FORMATS)
    check_packages(f"The format {name}", *FORMATS[name].packages)
    return FORMATS[name]


def export_grasps(
    source: RunFolder | Sequence[RunFolder],
    out: Path,
    name: str,
    choice: GraspChoice = ALL_GRASPS,
    *,
    frame: str = "mesh",
    negatives: int | None = None,
    force: bool = False,
    tell: Tell = ignore_progress,
) -> str:
    """Write the chosen grasps of a run to a file or folder, or of several as one data set.

    Returns a sentence about it. The file or folder `out` appears whole or not at all; `force` lets it be
    replaced. The choice is made of each run. Poses are in the object's `frame`, "mesh" or "com". At most
    `negatives` failures of a run are written behind its grasps; None: as many as is usual in the format.
    `tell` is called with each step that begins. Runs of a data set that cannot be read are left out, and
    named in its card. Raises InputError if there is no such format or frame, there is nothing to write, or it
    cannot be read or written.
    """
    form = format_of(name)
    writer = GraspWriter(form, choice, frame_of(frame), form.failures(negatives))
    if isinstance(source, RunFolder):
        single: Output = OutFile(out, force=force)
        if not form.suffix:
            single = OutFolder(out, force=force, is_kind=is_folder)
        return writer.write_run(source, single, tell)
    output = OutFolder(out, force=force, is_kind=is_dataset)
    with output.writing() as made:
        made.mkdir()
        dataset = DatasetWriter(made, writer)
        for begin, folder in dataset.runs(source):
            tell(f"run {begin['run']}, {len(dataset.entries)} of {len(source)} written")
            dataset.write(begin, folder)
        return f"{dataset.write_lists()} written to {out}, poses in the objects' {frame} frame."


@dataclass(frozen=True)
class GraspWriter:
    """The choice of grasps of each run, and the format and frame that they are written in."""

    format: ExportFormat
    choice: GraspChoice
    frame: Frame
    failures: int
    """Failures of each run, at most."""

    def read(
        self, folder: RunFolder, journal: Journal, engines: Iterable[str] = (), name: str = ""
    ) -> ChosenGrasps:
        """Read the chosen grasps of a run; `engines` and `name` are those of `read_journal`."""
        least = Outcome.MISSED if self.failures else Outcome.DROPPED
        return choose_grasps(read_journal(folder, journal, least, engines, name), self.choice, self.failures)

    def write_run(self, folder: RunFolder, output: Output, tell: Tell) -> str:
        """Write the grasps of a run to a file, or a folder of GraspGen; returns a sentence about it."""
        beside = OutFile(jaw_files.mesh_beside(output.path), force=output.force)
        for each in (output, beside) if self.format.has_mesh else (output,):
            each.check()
        tell(f"reading {folder.path}")
        with folder.journal() as journal:
            chosen = self.read(folder, journal)
            if len(chosen.grasps) == chosen.failures:
                found = read_journal(folder, journal, Outcome.DROPPED)
                raise InputError(
                    f"{folder.path} has no such grasp among {counted(len(found), 'success', 'successes')}, "
                    f"whose fitness is at most {found.fitness.max(initial=0):g}. --min-fitness 0 takes every "
                    "success; other limits may be too narrow."
                )
            tell(f"writing {counted(len(chosen.grasps), 'evaluation')} to {output.path}")
            metadata = grasp_metadata(chosen, self.frame, journal)
            with output.writing() as made:
                self.format.write(made, chosen.grasps, metadata)
                if self.format.has_mesh:
                    beside.write(jaw_files.mesh_file(chosen.grasps.scene.object, self.frame))
        note = ""
        if chosen.arm is not None:
            note += f" The arm reaches {chosen.grasps.more[0].values.sum()} of {len(chosen.grasps)}."
        if self.choice.holds_in is not None:
            unknown = counted(chosen.unknown, "grasp")
            note += f" Left out: {unknown} whose verdict in {self.choice.holds_in} is not known."
        is_ranked = self.choice.top is not None or self.choice.diverse is not None
        if is_ranked and takes_held(folder.spec) and not chosen.grasps.trials.any():
            note += (
                " They were ranked by the object's motion; --verify-top 600 scores them, which ranks better."
            )
        words = grasp_words(len(chosen.grasps), chosen.failures)
        return f"{words} written to {output.path}, poses in the object's {self.frame} frame.{note}"


def grasp_words(rows: int, failures: int) -> str:
    """Return how many grasps, and failures behind them, are among so many rows."""
    beside = f" and {counted(failures, 'failure')}" if failures else ""
    return f"{counted(rows - failures, 'grasp')}{beside}"


DATA = "data"
CARD, INDEX = "README.md", "index.csv"
TRAIN = "train"  # Split of objects without one
TABLES = ("parquet", "webdataset")
"""Formats that hubs show as tables: their files are in a folder for each split."""


def is_dataset(path: Path) -> bool:
    """Return whether a folder is a data set that was exported."""
    return all((path / name).is_file() for name in (CARD, INDEX))


Entry = dict[str, Any]
"""A line of the index: one run."""


@dataclass
class DatasetWriter:
    """Writes the files of a data set into a folder, run by run."""

    path: Path
    writer: GraspWriter
    entries: list[Entry] = field(default_factory=list)
    left_out: dict[str, str] = field(default_factory=dict)
    """Runs that cannot be read, with the reason."""
    engines: tuple[str, ...] = ()
    """Those that any run has a table of."""

    def runs(self, folders: Sequence[RunFolder]) -> list[tuple[Entry, RunFolder]]:
        """Return the runs that can be read with the begin of their lines, those of a hand together."""
        names, found = Counter[str](), list[tuple[Entry, RunFolder]]()
        self.engines = tuple(
            name for name in ENGINES if any((each.path / f"engine-{name}.csv").exists() for each in folders)
        )
        for folder in folders:
            name = folder.path.absolute().name
            names[name] += 1
            unique = name if names[name] == 1 else f"{name}-{names[name]}"
            try:
                spec = folder.spec
            except InputError as error:
                self.left_out[unique] = str(error)
                continue
            common, about = common_values(spec), spec.about or ObjectRecord()
            begin = {name: common[name] for name in ("object", "gripper")}
            found.append((begin | {"run": unique, "split": about.split}, folder))
        return sorted(found, key=lambda one: [one[0][key] for key in ("gripper", "split", "object", "run")])

    def write(self, begin: Entry, folder: RunFolder) -> None:
        """Write the grasps of a run, or note why it cannot be read."""
        try:
            with folder.journal() as journal:
                chosen = self.writer.read(folder, journal, self.engines, begin["run"])
                metadata = grasp_metadata(chosen, self.writer.frame, journal)
                totals = count_rows(chosen.grasps.spec, journal.blocks()).totals
        except InputError as error:
            self.left_out[begin["run"]] = str(error)
            return
        body, spec = chosen.grasps.scene.object, chosen.grasps.spec
        about, common = spec.about or ObjectRecord(), common_values(spec)
        self.entries.append(begin | {
            "category": about.category,
            "licence": about.licence or body.licence,
            "source": about.source or body.source,
            "object_file": metadata.object_file,
            "object_sha256": metadata.object_sha256,
            **{name: common[name] for name in ("method", "seed", "protocol", "engine")},
            **{name: getattr(totals, name) for name in ("evaluations", "successes", "grasps", "robust")},
            "min_fitness": chosen.min_fitness,
            "rows": len(chosen.grasps),
            "failures": chosen.failures,
            "best_quality": chosen.best,
            "digest": metadata.runs[0].digest,
            "scene": metadata.scene,
            "files": " ".join(self._write_file(begin, chosen, metadata)),
        })  # fmt: skip

    def _write_file(self, begin: Entry, chosen: ChosenGrasps, metadata: GraspMetadata) -> list[str]:
        """Write the grasps of a run, if there are any; returns the names of its files."""
        form, home, name = self.writer.format, self.path / DATA / job_name(begin["gripper"]), begin["run"]
        if form.name in TABLES:
            home /= begin["split"] or TRAIN
        if not len(chosen.grasps):
            return []
        home.mkdir(parents=True, exist_ok=True)
        if form.name != "graspgen":
            made = [home / f"{name}{form.suffix}"]
            form.write(made[0], chosen.grasps, metadata)
            if form.has_mesh:
                made.append(jaw_files.mesh_beside(made[0]))
                made[1].write_bytes(jaw_files.mesh_file(chosen.grasps.scene.object, metadata.frame))
        else:
            jaw_files.write_graspgen_object(home, name, chosen.grasps, metadata)
            ends = {jaw_files.DATA: "json", jaw_files.OBJECTS: "obj"}
            made = [home / folder / f"{name}.{end}" for folder, end in ends.items()]
        return [file.relative_to(self.path).as_posix() for file in made]

    def write_lists(self) -> str:
        """Write the index and the card; returns how much was written, in words."""
        if not any(entry["rows"] for entry in self.entries):
            why = "; --min-fitness 1 takes what survived some disturbance, 0 all successes."
            if self.left_out:
                number, first = counted(len(self.left_out), "run"), next(iter(self.left_out.values()))
                why = f": {number} could not be read, the first: {first}"
            raise FolderError(f"There is no grasp to write{why}")
        if self.writer.format.name == "graspgen":
            self._write_graspgen_lists()
        (self.path / INDEX).write_text(csv_text(self.entries, list(self.entries[0])), encoding="utf-8")
        text, words = card_text(self)
        (self.path / CARD).write_text(text, encoding="utf-8")
        beside = f"; {counted(len(self.left_out), 'run')} left out, see {CARD}" if self.left_out else ""
        return f"{words}{beside}"

    def _write_graspgen_lists(self) -> None:
        hands: dict[str, dict[str, tuple[str, ...]]] = {}
        for entry in self.entries:
            if entry["rows"]:
                split = "valid" if entry["split"] == "validation" else entry["split"]
                splits = (split,) if split else ("train", "valid")
                hands.setdefault(job_name(entry["gripper"]), {})[entry["run"]] = splits
        for hand, objects in hands.items():
            jaw_files.write_graspgen_index(self.path / DATA / hand, objects)


CARD_TEMPLATE = Template(Path(__file__).with_name("card.md").read_text(encoding="utf-8"))


def card_text(data: DatasetWriter) -> tuple[str, str]:
    """Return the card of a data set, and how much is in it, in words."""
    entries = data.entries
    rows, failures = (sum(entry[name] for entry in entries) for name in ("rows", "failures"))
    objects = counted(len({entry["object"] for entry in entries}), "object")
    words = f"{grasp_words(rows, failures)} of {objects} in {counted(len(entries), 'run')}"
    licences: dict[str, set[str]] = {}
    for entry in entries:
        name = " ".join(entry["licence"].split()) or "not stated"
        licences.setdefault(name, set()).add(entry["object"])
    left = [f"- `{run}`: {' '.join(reason.split())}" for run, reason in data.left_out.items()]
    text = CARD_TEMPLATE.substitute(
        fitness=FITNESS_MEANING,
        units=UNITS,
        head=to_yaml(_head(data)),
        words=words,
        evaluations=counted(sum(entry["evaluations"] for entry in entries), "evaluation"),
        frame=data.writer.frame,
        meaning=OBJECT_FRAMES[data.writer.frame].format("the mesh"),
        format=data.writer.format.name,
        licences="\n".join(f"| {name} | {len(each)} |" for name, each in sorted(licences.items())),
        left_out="\n".join(["", "## Left out", "", "Runs that could not be read:", "", *left, ""])
        if left
        else "",
    )
    return text, words


def _head(data: DatasetWriter) -> dict[str, Any]:
    """Return the head of the card; of formats that the hub shows as tables, with their files."""
    tables: dict[str, dict[str, str]] = {}
    for entry in data.entries if data.writer.format.name in TABLES else ():
        if entry["files"]:
            pattern = f"{entry['files'].rpartition('/')[0]}/*{data.writer.format.suffix}"
            tables.setdefault(entry["gripper"], {})[entry["split"] or TRAIN] = pattern
    configs = [
        {"config_name": job_name(hand),
         "data_files": [{"split": split, "path": path} for split, path in sorted(paths.items())],
         **({} if place else {"default": True})}
        for place, (hand, paths) in enumerate(sorted(tables.items()))
    ]  # fmt: skip
    index = {"config_name": "index", "data_files": [{"split": "train", "path": INDEX}]}
    tags = ["robotics", "grasping", "qdgrasp", data.writer.format.name]
    return {"tags": tags, "configs": [*configs, index]}
