"""Exports all runs of a campaign as one data set: files by hand and split, an index, a card.

It is made in `OUT.part` and becomes OUT when it is whole. Each file there takes its place when it is
complete, and is then recorded in `progress.jsonl`: the same command goes on behind the last of them. Only
some thousand grasps are in memory at a time, and a line for each run.
"""

import hashlib
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
from msgspec import Struct

from qdgrasp_assets.code_version import file_digest
from qdgrasp_assets.geometry.collision_parts import Tell, ignore_progress
from qdgrasp_assets.geometry.mesh import parts_to_obj
from qdgrasp_coordinator.metrics.run_stats import RunTotals, count_rows
from qdgrasp_coordinator.storage import atomic_files
from qdgrasp_coordinator.storage.finished_runs import FinishedRuns
from qdgrasp_coordinator.storage.job_folder import JobFolder, hold_lock
from qdgrasp_coordinator.storage.journal import Journal
from qdgrasp_coordinator.storage.outputs import LOCK, RUNS, OutFolder
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.engines import DEFAULT_ENGINE, ENGINES
from qdgrasp_protocol.errors import FolderError, ImpossibleValue, InputError, OutputError, UnknownName
from qdgrasp_protocol.extras import check_packages
from qdgrasp_protocol.keys import job_name
from qdgrasp_protocol.spec import ObjectRecord
from qdgrasp_protocol.text import counted
from qdgrasp_tools.campaign.campaign_folder import open_campaign
from qdgrasp_tools.export import graspgen
from qdgrasp_tools.export.dataset_card import (
    CARD,
    INDEX_CSV,
    INDEX_PARQUET,
    DatasetOptions,
    IndexEntry,
    write_card,
    write_index,
)
from qdgrasp_tools.export.exporter import ExportFormat, format_of
from qdgrasp_tools.export.frames import frame_of, object_solid
from qdgrasp_tools.export.grasp_reader import ChosenGrasps, GraspChoice, GraspReader, choose_grasps
from qdgrasp_tools.export.metadata import GraspMetadata, grasp_metadata
from qdgrasp_tools.export.tabular import METADATA_KEY, ParquetShard, TarShard, grasp_table

SHARD_BYTES = 256 << 20  # A shard ends when it has so many bytes: hubs advise 100 to 500 MB
PROGRESS, UNFINISHED = "progress.jsonl", "unfinished"
DATA, MESHES = "data", "meshes"
OURS = (CARD, INDEX_CSV, INDEX_PARQUET, DATA, MESHES)  # Names in a data set, of which one is in a part of it
COPY, NAME = "copy", "name"
SPLIT_NAMES = ("train", "validation", "test")
DEFAULT_SPLIT = "train"
"""Split of an object that has none, in the names of files."""


def parse_shares(text: str) -> tuple[float, ...]:
    """Read the shares of train, validation and test, such as "80,10,10"."""
    with suppress(ValueError):
        shares = tuple(float(word) for word in text.split(","))
        if 1 <= len(shares) <= len(SPLIT_NAMES) and min(shares) >= 0 and 0 < sum(shares) < np.inf:
            return shares
    raise ImpossibleValue("split", text, "the shares of train, validation and test, such as 80,10,10")


def split_of(name: str, shares: tuple[float, ...]) -> str:
    """Return the split of an object, by a hash of its name.

    It is the same in every campaign. Shares (k,) are of any sum. Empty: there are none.
    """
    if not shares:
        return ""
    place = int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "big") / 2**64 * sum(shares)
    reached = np.cumsum(shares) > place
    return SPLIT_NAMES[int(reached.argmax())]


class DatasetRun(NamedTuple):
    """One run of a campaign; sorted, runs of one file and one object are neighbours."""

    gripper: str
    split: str
    object: str
    run: str
    about: ObjectRecord


class PartialRun(Struct, frozen=True):
    """A run whose first rows are in a complete file, and the others are not."""

    run: str
    rows: int
    mark: str
    """Mark of its journal (`Journal.mark`)."""
    files: tuple[str, ...]


class FileRecord(Struct, frozen=True):
    """A complete file, as it stands in a line of the progress."""

    file: str
    """Its path in the data set; empty: none, as of runs without a grasp."""
    runs: tuple[IndexEntry, ...]
    """The runs whose last grasp is in it, or that have none."""
    open_run: PartialRun | None = None
    left_out: dict[str, str] = field(default_factory=dict)
    """Runs that cannot be read, with the reason."""


@dataclass(frozen=True)
class Progress:
    """The record of the complete files of a data set."""

    path: Path

    def records(self) -> Iterator[FileRecord]:
        """Yield the complete files; a line that a kill cut off does not count."""
        with self.path.open("rb") as lines:
            next(lines, None)
            for line in lines:
                if line.endswith(b"\n"):
                    yield msgspec.json.decode(line, type=FileRecord)

    def entries(self) -> Iterator[IndexEntry]:
        """Yield the runs that are complete, in the order of the files."""
        for record in self.records():
            yield from record.runs

    def begin(self, options: DatasetOptions) -> None:
        """Write the options; raises OutputError where a data set of others was begun here."""
        line = msgspec.json.encode(options) + b"\n"
        if not self.path.exists():
            atomic_files.write(self.path, line)
        with self.path.open("rb+") as file:
            if (begun := file.readline()) != line:
                reason = f"holds the beginning of an export with other options: {_differences(begun, line)}"
                raise OutputError(self.path.parent, reason, "give those, remove it, or name another OUT")
            whole = file.read()
            file.truncate(len(line) + whole.rfind(b"\n") + 1)  # a line that a kill cut off

    def add(self, record: FileRecord) -> None:
        """Add a line; it is on the disk when this returns."""
        with self.path.open("ab") as file:
            file.write(msgspec.json.encode(record) + b"\n")
            file.flush()
            os.fsync(file.fileno())


def _differences(begun: bytes, asked: bytes) -> str:
    """Say which options differ, a line of JSON of the data set that was begun and one now."""
    then, now = dict[str, Any](), dict[str, Any]()
    for values, line in ((then, begun), (now, asked)):
        with suppress(msgspec.DecodeError):
            values.update(msgspec.json.decode(line, type=dict[str, Any]))
        values.update(values.pop("choice", {}))
        values.update(values.pop("limits", {}))
    words = [f"{name} was {then.get(name)} and is {now[name]}" for name in now if then.get(name) != now[name]]
    return ", ".join(words).replace("None", "not given") or "of another version"


def export_campaign(
    campaign: Path,
    out: Path,
    name: str,
    choice: GraspChoice,
    *,
    frame: str = "mesh",
    negatives: int | None = None,
    meshes: str = NAME,
    shares: tuple[float, ...] = (),
    force: bool = False,
    tell: Tell = ignore_progress,
    is_stopped: Callable[[], bool] = lambda: False,
    shard_bytes: int = SHARD_BYTES,
) -> str:
    """Write all runs of a campaign as one data set; returns a sentence, empty if it was stopped.

    The choice is made of each run. `meshes` "copy" writes the mesh of each object, "name" only its name and
    digests. `shares` split objects without a split of their own. Runs that cannot be read are left out, and
    named in the card. Raises InputError where it cannot be begun or written, or where there is no run.
    """
    check_packages("A data set", "pyarrow")  # of its index
    folder, form, object_frame = open_campaign(campaign), format_of(name), frame_of(frame)
    wanted = form.failures(negatives)
    if meshes not in (COPY, NAME):
        raise UnknownName("meshes", meshes, (COPY, NAME))
    options = DatasetOptions(
        campaign=folder.identity or folder.name, format=form.name, frame=object_frame, failures=wanted,
        choice=msgspec.to_builtins(choice), meshes=meshes, shares=shares,
    )  # fmt: skip
    OutFolder(out, force=force, is_kind=is_dataset).check()
    whole = out.absolute()
    old, part = whole.with_name(f".{whole.name}.old"), whole.with_name(f"{whole.name}.part")
    with atomic_files.writing(part), atomic_files.making_parents(part):
        if os.path.lexists(old) and not any(map(os.path.lexists, (old / name_ for name_ in OURS))):
            raise OutputError(old, "is no data set", "move it away, or name another OUT")
        if any(part.iterdir()) and not (part / PROGRESS).exists() and not (part / LOCK).exists():
            raise OutputError(part, "holds other files", "remove it, or name another OUT")
        with hold_lock(part):
            if is_dataset(old) and not os.path.lexists(whole):  # a killed command had moved it
                old.rename(whole)
                if not force:
                    (part / LOCK).unlink()
                OutFolder(out, force=force, is_kind=is_dataset).check()
            writer = DatasetWriter(part, folder, form, options, shard_bytes)
            runs = writer.begin(tell)
            for number, run in enumerate(runs, 1):
                tell(f"run {number} of {len(runs)}: {run.run}")
                if not writer.write(run, is_stopped):
                    return ""
            tell("writing the index and the card")
            said = writer.end()
            shutil.rmtree(old, ignore_errors=True)
            if (part / UNFINISHED).exists():
                shutil.rmtree(part / UNFINISHED)
            atomic_files.put_in_place(part, whole, old)
            shutil.rmtree(old, ignore_errors=True)
        for name_ in (PROGRESS, LOCK):
            (whole / name_).unlink(missing_ok=True)
    return f"{said} written to {out}, poses in the objects' {object_frame} frame."


def is_dataset(path: Path) -> bool:
    """Return whether a folder is a data set that was exported."""
    return all((path / name).is_file() for name in (CARD, INDEX_CSV, INDEX_PARQUET))


class DatasetWriter:
    """Writes the files of a data set into a folder, run by run."""

    def __init__(
        self, path: Path, campaign: JobFolder, form: ExportFormat, options: DatasetOptions, shard_bytes: int
    ) -> None:
        self._path, self._campaign, self._form, self._options = path, campaign, form, options
        self._shard_bytes = shard_bytes
        self._progress = Progress(path / PROGRESS)
        self._numbers: dict[str, int] = {}  # Complete shards, by what their names begin with
        self._meshes: dict[str, str] = {}  # Digests of objects by the mesh files that are theirs
        self._open_run: PartialRun | None = None
        self._shard: tuple[str, ParquetShard | TarShard, ExitStack] | None = None
        self._waiting: list[IndexEntry] = []  # Runs whose last grasp is in the open shard
        self._left_out: dict[str, str] = {}
        self._finished = FinishedRuns(campaign.path)
        self._engines: tuple[str, ...] = ()  # Those that any run has a table of

    def begin(self, tell: Tell) -> list[DatasetRun]:
        """Return the runs that are to be written, in their order; what is complete is kept."""
        shutil.rmtree(self._path / UNFINISHED, ignore_errors=True)
        (self._path / UNFINISHED).mkdir()
        self._progress.begin(self._options)
        done = set[str]()
        for record in self._progress.records():
            done |= {entry.run for entry in record.runs} | record.left_out.keys()
            self._meshes |= {entry.mesh: entry.object_sha256 for entry in record.runs if entry.mesh}
            self._open_run = record.open_run
            begin = record.file.rpartition("-")[0]
            self._numbers[begin] = self._numbers.get(begin, 0) + 1
        self._finished.refresh()
        tell(f"reading the specs of {self._campaign.path}")
        runs = sorted(self._runs(done))
        begun = self._open_run.run if self._open_run else ""
        return sorted(runs, key=lambda run: run.run != begun)  # its other rows come before those of others

    def _runs(self, done: set[str]) -> Iterator[DatasetRun]:
        judged = {file.stem for file in (self._campaign.path / RUNS).glob("*/engine-*.csv")}
        self._engines = tuple(name for name in ENGINES if f"engine-{name}" in judged)
        for path in self._campaign.run_paths:
            if path.name in done:
                continue
            try:
                spec = RunFolder.open(path).spec
            except InputError as error:
                self._left_out[path.name] = str(error)
                continue
            found = spec.about or ObjectRecord()
            object_ = found.id or asset_name(spec.object)
            split = found.split or split_of(object_, self._options.shares)
            yield DatasetRun(asset_name(spec.gripper), split, object_, path.name, found)

    def write(self, run: DatasetRun, is_stopped: Callable[[], bool]) -> bool:
        """Write the grasps of a run; False if it was stopped, and the open file is not complete."""
        folder = RunFolder(self._campaign.run_path(run.run))
        with ExitStack() as stack:
            try:
                journal = stack.enter_context(folder.journal())
                reader = GraspReader(folder, journal, self._engines)
                chosen = choose_grasps(reader, self._choice, self._options.failures)
                metadata = grasp_metadata(folder, chosen, self._options.frame, self._form.places)
                totals = self._totals(folder, journal)
            except InputError as error:
                self._left_out[run.run] = str(error)
                return True
            entry = self._entry(run, chosen, metadata, totals)
            if self._form.name in SHARDED:
                return self._write_rows(run, chosen, metadata, entry, journal.mark, is_stopped)
            return not is_stopped() and self._write_file(run, chosen, metadata, entry)

    def _totals(self, folder: RunFolder, journal: Journal) -> RunTotals:
        """Return the counts of a run, as the campaign's index has them or counted now."""
        spec = folder.spec
        if known := self._finished.find(folder.path, spec):
            return known.totals
        return count_rows(spec, journal.blocks()).totals

    @property
    def _choice(self) -> GraspChoice:
        return msgspec.convert(self._options.choice, GraspChoice)

    def _write_file(
        self, run: DatasetRun, chosen: ChosenGrasps, metadata: GraspMetadata, entry: IndexEntry
    ) -> bool:
        """Write the file of a run, in formats that have one for each."""
        if not len(chosen):
            self._waiting.append(entry)
            return True
        home, made = self._path / DATA / job_name(run.gripper), self._path / UNFINISHED
        home.mkdir(parents=True, exist_ok=True)
        if self._form.suffix:
            self._form.write(made / f"{run.run}{self._form.suffix}", chosen, metadata)
        else:
            graspgen.write_object(made, run.run, chosen, metadata)
        files = sorted(file for file in made.rglob("*") if file.is_file())
        for file in files:
            self._place(file, home / file.relative_to(made))
        names = tuple(f"{DATA}/{home.name}/{file.relative_to(made)}" for file in files)
        self._waiting.append(msgspec.structs.replace(entry, files=names))
        self._record(names[0])
        return True

    def _write_rows(
        self,
        run: DatasetRun,
        chosen: ChosenGrasps,
        metadata: GraspMetadata,
        entry: IndexEntry,
        mark: str,
        is_stopped: Callable[[], bool],
    ) -> bool:
        """Write the grasps of a run into shards that hold those of several."""
        first, files = 0, []
        if self._open_run and self._open_run.run == run.run:
            if self._open_run.mark != mark:
                reason = f"was begun with other rows of run '{run.run}', which went on meanwhile"
                raise OutputError(self._path, reason, "remove it, and export again")
            first, files = self._open_run.rows, list(self._open_run.files)
        begin = f"{DATA}/{job_name(run.gripper)}/{run.split or DEFAULT_SPLIT}"
        if self._shard and self._shard[0] != begin:
            self._end_shard()
        same: dict[str, str | int] = {
            "object": run.object, "gripper": run.gripper, "category": entry.category,
            "method": entry.method, "seed": entry.seed, "protocol": entry.protocol, "engine": entry.engine,
        }  # fmt: skip
        about = metadata.values | same
        for part in chosen.after(first):
            if is_stopped():
                return False
            table = None
            if self._form.name == "parquet":
                table = grasp_table(part, metadata.frame, {METADATA_KEY: DATASET_WORDS}, same)
            shard, name = self._open_shard(begin, table)
            if isinstance(shard, TarShard):
                shard.add(f"{run.run}-{first:09}", part, metadata.frame, about)
            else:
                shard.add(table)
            first += len(part)
            files += [] if name in files else [name]
            if shard.size >= self._shard_bytes:
                self._end_shard(PartialRun(run.run, first, mark, tuple(files)))
        self._open_run = None
        self._waiting.append(msgspec.structs.replace(entry, files=tuple(files)))
        return True

    def _open_shard(self, begin: str, table: Any) -> tuple[ParquetShard | TarShard, str]:
        """Return the open shard, or a new one, for a table, and its name when it is complete."""
        if self._shard and isinstance(self._shard[1], ParquetShard) and not self._shard[1].fits(table):
            self._end_shard()  # a hand of the same name with other joints
        if self._shard is None:
            path = self._path / UNFINISHED / f"shard{self._form.suffix}"
            shard = TarShard(path) if self._form.suffix == ".tar" else ParquetShard(path)
            stack = ExitStack()
            stack.push(shard.__exit__)
            self._shard = begin, shard, stack
        return self._shard[1], self._shard_name(begin)

    def _shard_name(self, begin: str) -> str:
        return f"{begin}-{self._numbers.get(begin, 0):05}{self._form.suffix}"

    def _end_shard(self, open_run: PartialRun | None = None) -> None:
        """Complete the open shard, if there is one, and record it."""
        if self._shard is not None:
            begin, _, stack = self._shard
            name = self._shard_name(begin)
            stack.close()
            self._shard = None
            self._place(self._path / UNFINISHED / f"shard{self._form.suffix}", self._path / name)
            self._numbers[begin] = self._numbers.get(begin, 0) + 1
            self._record(name, open_run)

    def _record(self, file: str, open_run: PartialRun | None = None) -> None:
        self._progress.add(FileRecord(file, tuple(self._waiting), open_run, dict(self._left_out)))
        self._waiting.clear()
        self._left_out.clear()

    @staticmethod
    def _place(made: Path, path: Path) -> None:
        """Have a file take its place, whole and on the disk."""
        path.parent.mkdir(parents=True, exist_ok=True)
        atomic_files.sync(made)
        made.replace(path)
        atomic_files.sync(path.parent)

    def _entry(
        self, run: DatasetRun, chosen: ChosenGrasps, metadata: GraspMetadata, totals: RunTotals
    ) -> IndexEntry:
        spec, body = chosen.spec, chosen.scene.object
        return IndexEntry(
            object=run.object, gripper=run.gripper, run=run.run, split=run.split,
            category=run.about.category, licence=run.about.licence or body.licence,
            source=run.about.source or body.source, object_file=metadata.object_file,
            mesh_sha256=mesh_digest(spec.object), object_sha256=metadata.object_sha256,
            mesh=self._mesh(run.object, chosen, metadata), method=spec.method, seed=spec.seed,
            protocol=spec.protocol, engine=spec.engine or DEFAULT_ENGINE, evaluations=totals.evaluations,
            successes=totals.successes, grasps=totals.grasps, robust=totals.robust, rows=len(chosen),
            min_fitness=chosen.min_fitness, failures=chosen.failures, best_quality=chosen.best,
            digest=metadata.runs[0].digest, scene=metadata.scene, about=metadata.json,
        )  # fmt: skip

    def _mesh(self, name: str, chosen: ChosenGrasps, metadata: GraspMetadata) -> str:
        """Copy the mesh of an object where that is asked for; returns its file."""
        if self._options.meshes != COPY or not len(chosen):
            return ""
        digest = metadata.object_sha256
        file = f"{MESHES}/{job_name(name)}.obj"
        if self._meshes.get(file, digest) != digest:
            file = f"{MESHES}/{job_name(name)}-{digest[:12]}.obj"
        if file not in self._meshes:
            solid = object_solid(chosen.scene.object, metadata.frame)
            (self._path / MESHES).mkdir(exist_ok=True)
            atomic_files.write(self._path / file, parts_to_obj([solid.mesh]))
            self._meshes[file] = digest
        return file

    def end(self) -> str:
        """Write what is about all files; returns how much was written, in words."""
        self._end_shard()
        self._record("")
        left_out = {run: reason for each in self._progress.records() for run, reason in each.left_out.items()}
        if not any(entry.rows for entry in self._progress.entries()):
            shutil.rmtree(self._path)
            why = "; --min-fitness 1 takes what survived some disturbance, 0 all successes."
            if left_out:
                number, first = counted(len(left_out), "run"), next(iter(left_out.values()))
                why = f": {number} could not be read, the first: {first}"
            raise FolderError(f"{self._campaign.path} has no grasp to write{why}")
        if not self._form.suffix:
            self._write_graspgen_lists()
        write_index(self._path, self._progress.entries)
        figures = write_card(self._path, self._options, self._progress.entries, left_out)
        beside = f"; {counted(len(left_out), 'run')} left out, see {CARD}" if left_out else ""
        return f"{figures}{beside}"

    def _write_graspgen_lists(self) -> None:
        hands: dict[str, dict[str, tuple[str, ...]]] = {}
        for entry in self._progress.entries():
            if entry.rows:
                split = "valid" if entry.split == "validation" else entry.split
                splits = (split,) if split else ("train", "valid")
                hands.setdefault(job_name(entry.gripper), {})[entry.run] = splits
        for hand, objects in hands.items():
            graspgen.write_index(self._path / DATA / hand, objects)


SHARDED = ("parquet", "webdataset")
"""Formats whose files hold the grasps of several objects."""
DATASET_WORDS = '{"dataset": "index.parquet, column about"}'
"""Metadata in the schema of a shard, in place of that of one run."""


def asset_name(name: str) -> str:
    """Return the name of a gripper or an object, or that of its file."""
    return Path(name).stem if Path(name).suffix else name


def mesh_digest(name: str) -> str:
    """Return the sha256 of an object's mesh file; empty: it is built in, or not on this machine."""
    path = Path(name)
    return file_digest(path) if path.suffix and path.is_file() else ""
