"""Writes the index and the card (README.md) of a data set.

The head of the card is what the Hugging Face hub reads: licence, size, and which files are which table.
"""

import csv
import itertools
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import msgspec
from msgspec import Struct

from qdgrasp_protocol.keys import job_name
from qdgrasp_protocol.rows import LIFT
from qdgrasp_protocol.text import counted
from qdgrasp_tools.export.frames import Frame
from qdgrasp_tools.export.metadata import (
    FITNESS_MEANING,
    GRASP_WORDS,
    LIFT_MEANING,
    OBJECT_FRAMES,
    SUCCESS_WORDS,
    UNITS,
)
from qdgrasp_tools.export.tabular import JOINT, PREGRASP
from qdgrasp_tools.export.text_format import yaml_block

CARD, INDEX_CSV, INDEX_PARQUET = "README.md", "index.csv", "index.parquet"
INDEX_BATCH = 2000  # Lines of the index that are in memory at a time


class DatasetOptions(Struct, frozen=True, kw_only=True):
    """Campaign and options that a data set is made from."""

    campaign: str
    """The identity of the campaign."""
    format: str
    frame: Frame
    failures: int
    choice: dict[str, Any]
    """A `GraspChoice` as plain values."""
    meshes: str
    shares: tuple[float, ...]


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
    mesh_sha256: str
    """Digest of that file; empty where it was missing when this was written."""
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
    min_fitness: int | None = None
    """Least fitness of the grasps that were taken; None: not recorded by an earlier version."""
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


def write_index(folder: Path, entries: Callable[[], Iterable[IndexEntry]]) -> None:
    """Write the index as CSV and as Parquet; of the latter alone `about` is a column."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    names = IndexEntry.__struct_fields__
    numbers = {"seed", "evaluations", "successes", "grasps", "robust", "min_fitness", "rows", "failures"}
    kinds = {"best_quality": pa.float64(), "files": pa.list_(pa.string())} | dict.fromkeys(
        numbers, pa.int64()
    )
    schema = pa.schema([(name, kinds.get(name, pa.string())) for name in names])
    with (
        (folder / INDEX_CSV).open("w", encoding="utf-8", newline="") as text,
        pq.ParquetWriter(folder / INDEX_PARQUET, schema, compression="zstd") as table,
    ):
        lines = csv.DictWriter(text, names[:-1], extrasaction="ignore", lineterminator="\n")
        lines.writeheader()
        every = iter(entries())
        while batch := [msgspec.to_builtins(entry) for entry in itertools.islice(every, INDEX_BATCH)]:
            lines.writerows(values | {"files": " ".join(values["files"])} for values in batch)
            table.write_table(pa.Table.from_pylist(batch, schema))


SIZES = (
    (1_000, "n<1K"), (10_000, "1K<n<10K"), (100_000, "10K<n<100K"), (1_000_000, "100K<n<1M"),
    (10_000_000, "1M<n<10M"), (100_000_000, "10M<n<100M"), (1_000_000_000, "100M<n<1B"),
)  # fmt: skip
"""Categories of the hub for the number of lines."""

READERS = {
    "parquet": """import glob
import pandas

index = pandas.read_csv("index.csv")
print(index.groupby(["gripper", "split"], dropna=False)[["rows", "grasps", "robust"]].sum())
for name in sorted(glob.glob("data/*/*.parquet")):
    grasps = pandas.read_parquet(name)
    poses = grasps[["x", "y", "z", "qx", "qy", "qz", "qw"]].to_numpy()          # (n, 7)
    print(name, grasps.object.nunique(), poses.shape, grasps.confidence.max())
""",
    "acronym": """import h5py
import pandas

index = pandas.read_csv("index.csv")
for name in index.files.dropna():
    with h5py.File(name) as file:
        transforms = file["grasps/transforms"][()]                              # (n, 4, 4)
        held = file["grasps/qualities/flex/object_in_gripper"][()] == 1         # (n,)
        print(name, file["object/file"].asstr()[()], transforms[held].shape)
""",
    "graspgen": """import json
import pandas

index = pandas.read_csv("index.csv")
for names in index.files.dropna():
    (name,) = [name for name in names.split() if name.endswith(".json")]
    with open(name) as file:
        grasps = json.load(file)["grasps"]
    print(name, len(grasps["transforms"]), sum(grasps["object_in_gripper"]))
""",
    "isaac": """import pandas
import yaml

index = pandas.read_csv("index.csv")
for name in index.files.dropna():
    with open(name) as file:
        grasps = yaml.safe_load(file)["grasps"]
    for key, grasp in grasps.items():
        print(name, key, grasp["confidence"], grasp["position"], grasp["orientation"])
""",
    "webdataset": """import glob, io, json, tarfile
import numpy

for name in sorted(glob.glob("data/*/*.tar")):
    with tarfile.open(name) as tar:
        for member in tar:                                                      # KEY.json, then KEY.npz
            payload = tar.extractfile(member).read()
            if member.name.endswith(".json"):
                about = json.loads(payload)
            else:
                grasps = numpy.load(io.BytesIO(payload))                        # columns, each (n,)
                print(about["object"], about["gripper"], grasps["confidence"].shape)
""",
}
"""Readers of a data set without qdgrasp and torch, run in its folder."""

CITATION = """@article{huber2024speeding,
  title   = {Speeding up 6-DoF Grasp Sampling with Quality-Diversity},
  author  = {Huber, Johann and H{\\'e}l{\\'e}non, Fran{\\c c}ois and Kappel, Mathilde and Chelly, Elie and
             Khoramshahi, Mahdi and Ben Amar, Fa{\\"\\i}z and Doncieux, St{\\'e}phane},
  journal = {arXiv preprint arXiv:2403.06173},
  year    = {2024}
}"""


def write_card(
    folder: Path,
    options: DatasetOptions,
    entries: Callable[[], Iterable[IndexEntry]],
    left_out: Mapping[str, str],
) -> str:
    """Write the card of a data set; returns how much is in it, in words."""
    figures = DatasetFigures(entries())
    sections = [
        _head(folder, options, figures),
        f"# Grasps of a campaign of qdgrasp\n\n{figures.words}.\n\n{figures.table}",
        _meaning(options, figures),
        _fields(folder, options, figures),
        _reading(options),
        _licences(figures, options),
        f"## How to cite\n\nqdgrasp, and the paper that it implements:\n\n```bibtex\n{CITATION}\n```",
    ]
    if left_out:
        lines = [f"- `{run}`: {' '.join(reason.split())}" for run, reason in left_out.items()]
        sections.append("## Left out\n\nRuns that could not be read:\n\n" + "\n".join(lines))
    (folder / CARD).write_text("\n\n".join(sections) + "\n", encoding="utf-8")
    return figures.words


class DatasetFigures:
    """Figures of all runs in a data set; they grow with the objects, not with the grasps."""

    def __init__(self, entries: Iterable[IndexEntry]) -> None:
        self.rows, self.failures, self.runs, self.evaluations = 0, 0, 0, 0
        self.files: dict[str, dict[str, str]] = {}
        """One file for each hand and split."""
        self.lines: Counter[tuple[str, str]] = Counter()
        self.objects: dict[tuple[str, str], set[str]] = {}
        self.conditions: Counter[str] = Counter()
        self.least: set[int | None] = set()  # Least fitnesses of the grasps that were taken
        self.licences: dict[str, set[str]] = {}
        for entry in entries:
            self.runs += 1
            self.rows += entry.rows
            self.failures += entry.failures
            self.evaluations += entry.evaluations
            self.least.add(entry.min_fitness)
            self.conditions[f"protocol `{entry.protocol}`, engine `{entry.engine}`"] += 1
            self.licences.setdefault(entry.licence.strip() or "not stated", set()).add(entry.object)
            place = entry.gripper, entry.split
            self.lines[place] += entry.rows
            self.objects.setdefault(place, set()).add(entry.object)
            if entry.files:
                self.files.setdefault(entry.gripper, {}).setdefault(entry.split, entry.files[0])

    @property
    def words(self) -> str:
        """One sentence without its end."""
        failures = f" and {counted(self.failures, 'failure')}" if self.failures else ""
        grasps, runs = counted(self.rows - self.failures, "grasp"), counted(self.runs, "run")
        objects = counted(len(set[str]().union(*self.objects.values())), "object")
        return f"{grasps}{failures} of {objects} in {runs}"

    @property
    def table(self) -> str:
        """Lines and objects of each hand and split."""
        lines = [
            f"| {hand} | {split or 'none'} | {len(self.objects[hand, split])} | {self.lines[hand, split]} |"
            for hand, split in sorted(self.objects)
        ]
        return "\n".join(["| hand | split | objects | lines |", "|---|---|---|---|", *lines])


def _head(folder: Path, options: DatasetOptions, figures: DatasetFigures) -> str:
    configs: list[dict[str, Any]] = []
    if options.format in ("parquet", "webdataset"):
        for hand, splits in sorted(figures.files.items()):
            paths = {
                split or "train": f"{file.rpartition('-')[0]}-*{Path(file).suffix}"
                for split, file in sorted(splits.items())
            }
            files = [{"split": split, "path": path} for split, path in paths.items()]
            configs.append({"config_name": job_name(hand), "data_files": files})
    configs.append({"config_name": "index", "data_files": [{"split": "train", "path": INDEX_PARQUET}]})
    values = {
        "pretty_name": "Grasps of qdgrasp",
        "license": "other",
        "license_name": "see-the-table-of-licences",
        "license_link": CARD,
        "task_categories": ["robotics"],
        "tags": ["robotics", "grasping", "qdgrasp", options.format],
        "size_categories": [next((name for most, name in SIZES if figures.rows < most), "n>1T")],
        "configs": configs,
    }
    return f"---\n{yaml_block(values)}---"


def _meaning(options: DatasetOptions, figures: DatasetFigures) -> str:
    conditions = "\n".join(
        f"- {words}: {counted(n, 'run')}" for words, n in sorted(figures.conditions.items())
    )
    least = " or ".join(map(str, sorted(filter(None, figures.least))))
    taken = options.choice | ({"min_fitness": least} if options.choice["min_fitness"] is None else {})
    given = {name: each for name, each in taken.items() if each is not None and (each or "min_" not in name)}
    limits = given.pop("limits", {})
    given |= {name: value for name, value in limits.items() if value is not None}
    chosen = ", ".join(f"{name} {value}" for name, value in given.items()) or "every success"
    frame = OBJECT_FRAMES[options.frame].format("the mesh")
    lifted = f"; under `{LIFT}` {LIFT_MEANING}" if any(f"`{LIFT}`" in it for it in figures.conditions) else ""
    return f"""## Simulation

An open hand without an arm stands at a commanded pose, closes, and the object is disturbed
({counted(figures.evaluations, "evaluation")} in all):

{conditions}

- success: {SUCCESS_WORDS}
- grasp: {GRASP_WORDS}
- fitness: {FITNESS_MEANING}{lifted}
- quality (`confidence`): 0 to 1, higher is better: the estimated probability of transfer where it is known,
  else the share of the disturbances that was survived
- taken of each run: {chosen}

## Frames

Units are {UNITS}. Poses are those of the hand's root link in the object's `{options.frame}` frame: {frame}.
The commanded pose goes with the open joints, the settled pose with the joints after closing. Quaternions in
tables are x, y, z, w. The column `about` of `{INDEX_PARQUET}` has, for each run, all that a file of it alone
says of itself: link, axes, scale, masses, centre of mass, digests, and the spec that repeats it."""


def _fields(folder: Path, options: DatasetOptions, figures: DatasetFigures) -> str:
    words = (
        f"`{INDEX_CSV}` and `{INDEX_PARQUET}` have a line for each run: object, hand, counts, digests, files."
    )
    if options.format != "parquet" or not figures.files:
        return f"## Files\n\n{words} The files in `data/HAND` are of the format `{options.format}`."
    import pyarrow.parquet as pq

    schema = pq.read_schema(folder / next(iter(next(iter(figures.files.values())).values())))
    lines = dict[str, str]()
    for field in schema:
        for begin in (JOINT, PREGRASP):
            name = f"{begin}NAME" if field.name.startswith(begin) else field.name
            if name != field.name:
                break
        meaning = field.metadata[b"meaning"].decode()
        lines.setdefault(
            name, f"| `{name}` | {field.type if name != 'contact_points' else 'list'} | {meaning} |"
        )
    table = "\n".join(["| column | type | meaning |", "|---|---|---|", *lines.values()])
    return f"## Files\n\n{words} Shards in `data/HAND` are sorted by object.\n\n{table}"


def _reading(options: DatasetOptions) -> str:
    back = (
        "\n\nPoses of an object, to be scored again:\n\n```sh\n"
        "qdgrasp import DIR --gripper HAND --object MESH -o poses.npz\n```"
    )
    reader = READERS.get(options.format)
    code = f"In this folder:\n\n```python\n{reader}```" if reader else "See docs/formats.md of qdgrasp."
    return f"## Reading\n\n{code}{back if options.format == 'parquet' else ''}"


def _licences(figures: DatasetFigures, options: DatasetOptions) -> str:
    lines = [
        f"| {' '.join(licence.split())} | {len(objects)} |"
        for licence, objects in sorted(figures.licences.items())
    ]
    table = "\n".join(["| licence of the object | objects |", "|---|---|", *lines])
    copies = "are copied" if options.meshes == "copy" else "are only named, with their digests"
    return f"## Licences\n\nMeshes {copies}; each keeps its own licence.\n\n{table}"


def read_index(folder: Path) -> Iterator[dict[str, Any]]:
    """Yield the lines of the index of a data set as plain values; raises errors of Arrow."""
    import pyarrow.parquet as pq

    with pq.ParquetFile(folder / INDEX_PARQUET) as file:
        for batch in file.iter_batches(INDEX_BATCH):
            yield from batch.to_pylist()
