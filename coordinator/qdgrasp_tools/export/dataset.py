"""Exports runs and campaigns as one data set: files by hand and split, index, card.

Only some thousand grasps are in memory at a time. The head of the card is what the Hugging Face hub reads.
"""

import hashlib
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass, field
from pathlib import Path
from string import Template
from typing import Any, NamedTuple

import msgspec
import numpy as np
from msgspec import Struct

from qdgrasp_assets.geometry.collision_parts import Tell, ignore_progress
from qdgrasp_assets.geometry.mesh import parts_to_obj
from qdgrasp_coordinator.metrics.run_stats import count_rows
from qdgrasp_coordinator.storage.outputs import OutFolder
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_coordinator.storage.tables import csv_text
from qdgrasp_protocol.engines import DEFAULT_ENGINE, ENGINES
from qdgrasp_protocol.errors import FolderError, ImpossibleValue, InputError, UnknownName, check_packages
from qdgrasp_protocol.keys import job_name
from qdgrasp_protocol.spec import ObjectRecord
from qdgrasp_protocol.text import counted
from qdgrasp_tools.export import jaw_files
from qdgrasp_tools.export.exporter import ExportFormat, format_of
from qdgrasp_tools.export.frames import Frame, frame_of, object_solid
from qdgrasp_tools.export.grasp_reader import (
    ALL_GRASPS,
    OBJECT_FRAMES,
    ChosenGrasps,
    GraspChoice,
    GraspReader,
    choose_grasps,
    grasp_metadata,
)
from qdgrasp_tools.export.grasp_table import FITNESS_MEANING, GRASP_WORDS, SUCCESS_WORDS, UNITS, GraspMetadata
from qdgrasp_tools.export.tabular import METADATA_KEY, ParquetShard, TarShard, arrow_table
from qdgrasp_tools.export.yaml_files import to_yaml

SHARD_BYTES = 256 << 20  # A shard ends when it has so many bytes: hubs advise 100 to 500 MB
DATA, MESHES = "data", "meshes"
CARD, INDEX_CSV, INDEX_PARQUET = "README.md", "index.csv", "index.parquet"
COPY, NAME = "copy", "name"
SPLIT_NAMES = ("train", "validation", "test")
SHARDED = ("parquet", "webdataset")
"""Formats whose files hold the grasps of several runs."""
DATASET_WORDS = '{"dataset": "index.parquet, column about"}'
"""Metadata in the schema of a shard, in place of that of one run."""


def parse_shares(text: str) -> tuple[float, ...]:
    """Read the shares of train, validation and test, such as "80,10,10"."""
    with suppress(ValueError):
        shares = tuple(float(word) for word in text.split(","))
        if 1 <= len(shares) <= len(SPLIT_NAMES) and min(shares) >= 0 and 0 < sum(shares) < np.inf:
            return shares
    raise ImpossibleValue("split", text, "the shares of train, validation and test, such as 80,10,10")


def split_of(name: str, shares: tuple[float, ...]) -> str:
    """Return the split of an object, by a hash of its name; empty without shares.

    It is the same in every data set. Shares (k,) are of any sum.
    """
    if not shares:
        return ""
    place = int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "big") / 2**64 * sum(shares)
    return SPLIT_NAMES[int((np.cumsum(shares) > place).argmax())]


def asset_name(name: str) -> str:
    """Return the name of a gripper or an object, or that of its file."""
    return Path(name).stem if Path(name).suffix else name


def is_dataset(path: Path) -> bool:
    """Return whether a folder is a data set that was exported."""
    return all((path / name).is_file() for name in (CARD, INDEX_CSV, INDEX_PARQUET))


class DatasetRun(NamedTuple):
    """One run of a data set; sorted, runs of one file and one object are neighbours."""

    gripper: str
    split: str
    object: str
    name: str
    """Its name here: that of its folder, with a number where another one has that too."""
    folder: RunFolder
    about: ObjectRecord


class IndexEntry(Struct, frozen=True, kw_only=True):
    """A line of the index: one run."""

    object: str
    gripper: str
    run: str
    split: str
    """Split of the object; empty: none."""
    category: str
    licence: str
    """Licence of the object."""
    source: str
    object_file: str
    """The name of its mesh file; empty: it is built in."""
    object_sha256: str
    """Digest of the object as it was simulated."""
    mesh: str
    """The copy of its mesh in this data set [m]; empty: there is none."""
    method: str
    seed: int
    protocol: str
    engine: str
    evaluations: int
    successes: int
    grasps: int
    robust: int
    min_fitness: int
    """Least fitness of the grasps that were taken."""
    rows: int
    """Lines in this data set, failures included."""
    failures: int
    best_quality: float | None
    digest: str
    """sha256 over the rows of the run."""
    scene: str
    """sha256 of the scene bundle."""
    files: tuple[str, ...] = ()
    about: str
    """Metadata of a file of this run alone, as JSON; not in CSV."""


def export_dataset(
    folders: Sequence[RunFolder],
    out: Path,
    name: str,
    choice: GraspChoice = ALL_GRASPS,
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
    """Write runs as one data set; returns a sentence, empty if it was stopped.

    The choice is made of each run; nothing is left of an export that was stopped. `meshes` "copy" writes the
    mesh of each object. `shares` split objects without a split of their own. Runs that cannot be read are
    left out, and named in the card. Raises InputError where it cannot be written, or there is no grasp.
    """
    check_packages("A data set", "pyarrow")  # of its index
    form = format_of(name)
    if meshes not in (COPY, NAME):
        raise UnknownName("meshes", meshes, (COPY, NAME))
    failures = form.failures(negatives)
    output = OutFolder(out, force=force, is_kind=is_dataset)
    output.check()
    with suppress(_StopExport), output.writing() as made:
        made.mkdir()
        writer = DatasetWriter(made, form, choice, frame_of(frame), failures, meshes, shares, shard_bytes)
        with closing(writer):
            for run in sorted(writer.runs(folders)):
                tell(f"run {run.name}, {len(writer.entries)} of {len(folders)} written")
                writer.write(run, is_stopped)
        return f"{writer.write_lists()} written to {out}, poses in the objects' {frame} frame."
    return ""


class _StopExport(Exception):
    """The export was stopped; nothing of it is left."""


@dataclass
class DatasetWriter:
    """Writes the files of a data set into a folder, run by run."""

    path: Path
    format: ExportFormat
    choice: GraspChoice
    frame: Frame
    failures: int
    """Failures of each run, at most."""
    meshes: str
    shares: tuple[float, ...]
    shard_bytes: int
    entries: list[IndexEntry] = field(default_factory=list)
    left_out: dict[str, str] = field(default_factory=dict)
    """Runs that cannot be read, with the reason."""

    def __post_init__(self) -> None:
        self._numbers: Counter[str] = Counter()  # Complete shards, by what their names begin with
        self._shard: tuple[str, ParquetShard | TarShard, ExitStack] | None = None
        self._engines: tuple[str, ...] = ()  # Those that any run has a table of

    def runs(self, folders: Sequence[RunFolder]) -> Iterator[DatasetRun]:
        """Yield the runs that can be read."""
        names: Counter[str] = Counter()
        self._engines = tuple(
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
            about = spec.about or ObjectRecord()
            object_ = about.id or asset_name(spec.object)
            split = about.split or split_of(object_, self.shares)
            yield DatasetRun(asset_name(spec.gripper), split, object_, unique, folder, about)

    def write(self, run: DatasetRun, is_stopped: Callable[[], bool]) -> None:
        """Write the grasps of a run, or note why it cannot be read."""
        if is_stopped():
            raise _StopExport
        with ExitStack() as stack:
            try:
                journal = stack.enter_context(run.folder.journal())
                reader = GraspReader(run.folder, journal, self._engines, run.name)
                chosen = choose_grasps(reader, self.choice, self.failures)
                metadata = grasp_metadata(chosen, self.frame, self.format.places)
                entry = self._entry(run, chosen, metadata)
            except InputError as error:
                self.left_out[run.name] = str(error)
                return
            is_sharded = self.format.name in SHARDED
            write = self._write_rows if is_sharded else self._write_file
            files = write(run, chosen, metadata, entry) if len(chosen) else ()
            self.entries.append(msgspec.structs.replace(entry, files=tuple(files)))

    def _write_file(
        self, run: DatasetRun, chosen: ChosenGrasps, metadata: GraspMetadata, _: IndexEntry
    ) -> list[str]:
        """Write the file of a run, in formats that have one for each; returns its names."""
        form, home = self.format, self.path / DATA / job_name(run.gripper)
        home.mkdir(parents=True, exist_ok=True)
        if form.suffix:
            made = [home / f"{run.name}{form.suffix}"]
            form.write(made[0], chosen, metadata)
        else:
            parts = (part.table(metadata.frame, metadata) for part in chosen)
            jaw_files.write_graspgen_object(home, run.name, parts)
            ends = {jaw_files.DATA: "json", jaw_files.OBJECTS: "obj"}
            made = [home / folder / f"{run.name}.{end}" for folder, end in ends.items()]
        return [file.relative_to(self.path).as_posix() for file in made]

    def _write_rows(
        self, run: DatasetRun, chosen: ChosenGrasps, metadata: GraspMetadata, entry: IndexEntry
    ) -> list[str]:
        """Write the grasps of a run into shards that hold those of several; returns their names."""
        begin = f"{DATA}/{job_name(run.gripper)}/{run.split or SPLIT_NAMES[0]}"
        same: dict[str, str | int] = {
            "object": run.object, "gripper": run.gripper, "category": entry.category,
            "method": entry.method, "seed": entry.seed, "protocol": entry.protocol, "engine": entry.engine,
        }  # fmt: skip
        files, first = dict[str, None](), 0
        for part in chosen:
            table = part.table(metadata.frame, metadata)
            rows = None
            if self.format.name == "parquet":
                rows = arrow_table(table, {METADATA_KEY: DATASET_WORDS}, same)
            shard = self._open_shard(begin, rows)
            if isinstance(shard, TarShard):
                shard.add(f"{run.name}-{first:09}", table, metadata.values | same)
            else:
                shard.add(rows)
            first += len(part)
            files[self._shard_name(begin)] = None
            if shard.size >= self.shard_bytes:
                self.close()
        return list(files)

    def _open_shard(self, begin: str, rows: Any) -> ParquetShard | TarShard:
        """Return the open shard, or a new one where its rows are others'."""
        if self._shard:
            other, shard, _ = self._shard
            if other == begin and (isinstance(shard, TarShard) or shard.fits(rows)):
                return shard
            self.close()
        path = self.path / self._shard_name(begin)
        path.parent.mkdir(parents=True, exist_ok=True)
        made = TarShard(path) if path.suffix == ".tar" else ParquetShard(path)
        stack = ExitStack()
        stack.push(made.__exit__)
        self._shard = begin, made, stack
        return made

    def _shard_name(self, begin: str) -> str:
        return f"{begin}-{self._numbers[begin]:05}{self.format.suffix}"

    def close(self) -> None:
        """Complete the open shard."""
        if self._shard is not None:
            begin, _, stack = self._shard
            stack.close()
            self._shard = None
            self._numbers[begin] += 1

    def _entry(self, run: DatasetRun, chosen: ChosenGrasps, metadata: GraspMetadata) -> IndexEntry:
        spec, body = chosen.spec, chosen.scene.object
        totals = count_rows(spec, chosen.reader.journal.blocks()).totals
        return IndexEntry(
            object=run.object, gripper=run.gripper, run=run.name, split=run.split,
            category=run.about.category, licence=run.about.licence or body.licence,
            source=run.about.source or body.source, object_file=metadata.object_file,
            object_sha256=metadata.object_sha256, mesh=self._mesh(run.object, chosen, metadata),
            method=spec.method, seed=spec.seed, protocol=spec.protocol, engine=spec.engine or DEFAULT_ENGINE,
            evaluations=totals.evaluations, successes=totals.successes, grasps=totals.grasps,
            robust=totals.robust, rows=len(chosen), min_fitness=chosen.min_fitness,
            failures=chosen.failures, best_quality=chosen.best, digest=metadata.runs[0].digest,
            scene=metadata.scene, about=metadata.json,
        )  # fmt: skip

    def _mesh(self, name: str, chosen: ChosenGrasps, metadata: GraspMetadata) -> str:
        """Copy the mesh of an object where that is asked for; returns its file."""
        if self.meshes != COPY or not len(chosen):
            return ""
        file = f"{MESHES}/{job_name(name)}-{metadata.object_sha256[:12]}.obj"
        if not (self.path / file).exists():
            (self.path / MESHES).mkdir(exist_ok=True)
            solid = object_solid(chosen.scene.object, metadata.frame)
            (self.path / file).write_bytes(parts_to_obj([solid.mesh]))
        return file

    def write_lists(self) -> str:
        """Write the index and the card; returns how much was written, in words."""
        if not any(entry.rows for entry in self.entries):
            why = "; --min-fitness 1 takes what survived some disturbance, 0 all successes."
            if self.left_out:
                number, first = counted(len(self.left_out), "run"), next(iter(self.left_out.values()))
                why = f": {number} could not be read, the first: {first}"
            raise FolderError(f"There is no grasp to write{why}")
        if not self.format.suffix:
            self._write_graspgen_lists()
        write_index(self.path, self.entries)
        text, words = card_text(self)
        (self.path / CARD).write_text(text, encoding="utf-8")
        beside = f"; {counted(len(self.left_out), 'run')} left out, see {CARD}" if self.left_out else ""
        return f"{words}{beside}"

    def _write_graspgen_lists(self) -> None:
        hands: dict[str, dict[str, tuple[str, ...]]] = {}
        for entry in self.entries:
            if entry.rows:
                split = "valid" if entry.split == "validation" else entry.split
                splits = (split,) if split else ("train", "valid")
                hands.setdefault(job_name(entry.gripper), {})[entry.run] = splits
        for hand, objects in hands.items():
            jaw_files.write_graspgen_index(self.path / DATA / hand, objects)


def write_index(folder: Path, entries: Sequence[IndexEntry]) -> None:
    """Write the index as CSV and as Parquet; of the latter alone `about` is a column."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    names = IndexEntry.__struct_fields__
    rows = [msgspec.to_builtins(entry) for entry in entries]
    text = csv_text((row | {"files": " ".join(row["files"])} for row in rows), names[:-1])
    (folder / INDEX_CSV).write_text(text, encoding="utf-8")
    numbers = ("seed", "evaluations", "successes", "grasps", "robust", "min_fitness", "rows", "failures")
    kinds: dict[str, Any] = dict.fromkeys(numbers, pa.int64())
    kinds |= {"best_quality": pa.float64(), "files": pa.list_(pa.string())}
    schema = pa.schema([(name, kinds.get(name, pa.string())) for name in names])
    pq.write_table(pa.Table.from_pylist(rows, schema), folder / INDEX_PARQUET, compression="zstd")


def read_index(folder: Path) -> list[dict[str, Any]]:
    """Return the lines of the index of a data set as plain values."""
    import pyarrow.parquet as pq

    lines: list[dict[str, Any]] = pq.read_table(folder / INDEX_PARQUET, use_threads=False).to_pylist()
    return lines


SIZES = ("n<1K", "1K<n<10K", "10K<n<100K", "100K<n<1M", "1M<n<10M", "10M<n<100M", "100M<n<1B", "n>1T")
"""Categories of the hub for the number of lines, each for ten times as many."""
CARD_TEMPLATE = Template(f"""---
$head---

# Grasps of qdgrasp

$words.

| hand | split | objects | lines |
|---|---|---|---|
$hands

## Simulation

An open hand without an arm is placed at a commanded pose, closes, and the object is disturbed
($evaluations in all, under the protocols and engines of the index):

- success: {SUCCESS_WORDS}
- grasp: {GRASP_WORDS}
- fitness: {FITNESS_MEANING}
- quality (`confidence`): 0 to 1, higher is better: the estimated probability of transfer where it is known,
  else the share of the disturbances that was survived

## Frames

Units are {UNITS}. Poses are those of the hand's root link in the object's `$frame` frame: $meaning.
The commanded pose goes with the open joints, the settled pose with the joints after closing. Quaternions in
tables are x, y, z, w. The column `about` of `{INDEX_PARQUET}` has, for each run, all that a file of it alone
says of itself: link, axes, scale, masses, centre of mass, digests, and the spec that repeats it.

## Files

`{INDEX_CSV}` and `{INDEX_PARQUET}` have a line for each run: object, hand, counts, digests, files. The files
in `{DATA}/HAND` are of the format `$format`; docs/formats.md of qdgrasp explains it. Poses of an object in a
data set of Parquet are scored again by `qdgrasp import DIR --gripper HAND --object MESH -o poses.npz`.

## Licences

Meshes $copies; each keeps its own licence.

| licence of the object | objects |
|---|---|
$licences
$left_out
## How to cite

Huber, J., Hélénon, F., Kappel, M., Chelly, E., Khoramshahi, M., Ben Amar, F., Doncieux, S. (2024). Speeding
up 6-DoF Grasp Sampling with Quality-Diversity. arXiv:2403.06173.
""")


def card_text(data: DatasetWriter) -> tuple[str, str]:
    """Return the card of a data set, and how much is in it, in words."""
    entries = data.entries
    rows, failures = (sum(getattr(entry, name) for entry in entries) for name in ("rows", "failures"))
    objects = counted(len({entry.object for entry in entries}), "object")
    beside = f" and {counted(failures, 'failure')}" if failures else ""
    words = f"{counted(rows - failures, 'grasp')}{beside} of {objects} in {counted(len(entries), 'run')}"
    lines, known, licences = (
        Counter[tuple[str, str]](),
        dict[tuple[str, str], set[str]](),
        dict[str, set[str]](),
    )
    for entry in entries:
        lines[entry.gripper, entry.split] += entry.rows
        known.setdefault((entry.gripper, entry.split), set()).add(entry.object)
        licences.setdefault(" ".join(entry.licence.split()) or "not stated", set()).add(entry.object)
    hands = [f"| {hand} | {split or 'none'} | {len(known[hand, split])} | {count} |"
             for (hand, split), count in sorted(lines.items())]  # fmt: skip
    left = [f"- `{run}`: {' '.join(reason.split())}" for run, reason in data.left_out.items()]
    text = CARD_TEMPLATE.substitute(
        head=to_yaml(_head(data, rows)),
        words=words,
        hands="\n".join(hands),
        evaluations=counted(sum(entry.evaluations for entry in entries), "evaluation"),
        frame=data.frame,
        meaning=OBJECT_FRAMES[data.frame].format("the mesh"),
        format=data.format.name,
        copies="are copied" if data.meshes == COPY else "are only named, with their digests",
        licences="\n".join(f"| {name} | {len(each)} |" for name, each in sorted(licences.items())),
        left_out="\n".join(["", "## Left out", "", "Runs that could not be read:", "", *left, ""])
        if left
        else "",
    )
    return text, words


def _head(data: DatasetWriter, rows: int) -> dict[str, Any]:
    """Return the head of the card; of formats that the hub shows as tables, with their files."""
    tables: dict[str, dict[str, str]] = {}
    for entry in data.entries if data.format.name in SHARDED else ():
        if entry.files:
            pattern = f"{entry.files[0].rpartition('-')[0]}-*{data.format.suffix}"
            tables.setdefault(entry.gripper, {})[entry.split or SPLIT_NAMES[0]] = pattern
    configs = [
        {"config_name": job_name(hand),
         "data_files": [{"split": split, "path": path} for split, path in sorted(paths.items())]}
        for hand, paths in sorted(tables.items())
    ]  # fmt: skip
    index = {"config_name": "index", "data_files": [{"split": "train", "path": INDEX_PARQUET}]}
    return {
        "pretty_name": "Grasps of qdgrasp",
        "license": "other",
        "license_name": "see-the-table-of-licences",
        "license_link": CARD,
        "task_categories": ["robotics"],
        "tags": ["robotics", "grasping", "qdgrasp", data.format.name],
        "size_categories": [SIZES[min(max(len(str(rows)) - 3, 0), len(SIZES) - 1)]],
        "configs": [*configs, index],
    }
