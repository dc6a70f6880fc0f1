"""Reference sets of our own: the cells that the runs of a scene found, and an estimate of the others.

The published sets have no hand of most scenes, or fewer cells than a single run finds, and none of them says
where a grasp holds. A set here is built as `qdgrasp reference build` does, from the finished runs of every
method, and `runs.csv` beside the sets names these runs. Each further run of a scene goes into its set.
"""

import csv
import io
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import msgspec
import numpy as np
from benchmarks.results.comparison import Arm, spread
from benchmarks.results.table import Key, Row, disk_text
from msgspec import Struct
from numpy.typing import NDArray

from qdgrasp_coordinator.metrics.reference_coverage import ReferenceSet, read_references
from qdgrasp_coordinator.metrics.richness import RichnessEstimate
from qdgrasp_coordinator.report.reference_builder import build_reference_sets
from qdgrasp_coordinator.report.tables import markdown_table
from qdgrasp_coordinator.storage import atomic_files
from qdgrasp_coordinator.storage.run_folder import RunFolder, search_digest
from qdgrasp_protocol.errors import InputError

FOLDER = "reference-sets"
"""Name of their folder beside the table."""
RUNS = "runs.csv"
COMPLETE = 0.95
"""Share of the estimated cells with which a set is complete enough, as in `qdgrasp reference build`."""


class SetRun(Struct, frozen=True, order=True):
    """A run that a set was built from."""

    gripper: str
    object: str
    protocol: str
    method: str
    overlaps: str
    settings: str
    seed: int
    budget: int
    """The greatest with which it was added."""
    code: str
    """Beginning of the digest of the evaluation's code, as in the table of runs."""
    run: str
    """Its name in the set: `search_digest`."""

    @property
    def key(self) -> Key:
        """The key of its row in the table of runs."""
        return Key(*(getattr(self, name) for name in Key._fields))


COLUMNS = tuple(field.name for field in msgspec.structs.fields(SetRun))
Scene = tuple[str, str, str]


@dataclass(frozen=True)
class SceneSet:
    """The set of a scene, and the runs that it was built from."""

    scene: Scene
    """Hand, object and protocol."""
    found: ReferenceSet
    runs: tuple[SetRun, ...]

    @property
    def counts_holding(self) -> bool:
        """Whether coverage counts cells where a grasp holds, and not all with a success."""
        return self.scene[2].startswith("physical")

    @property
    def estimate(self) -> RichnessEstimate | None:
        """Estimated number of the cells that coverage counts."""
        return (self.found.robust if self.counts_holding else self.found).estimate

    @cached_property
    def coverage(self) -> dict[str, NDArray[np.float64]]:
        """The share of the set that each run found (n,), by method: of cells that another run found too."""
        counted = self.found.robust if self.counts_holding else self.found
        assert counted.by_run is not None
        assert counted.origin is not None
        reached = counted.by_run > 0
        times = reached.sum(axis=0)
        lines = dict(zip(counted.origin.runs, reached, strict=True))
        shares: dict[str, list[float]] = {}
        for run in self.runs:
            line = lines[run.run]
            others = times - line > 0
            shares.setdefault(Arm(run.key, (), {}).method, []).append(float(line[others].mean()))
        return {method: np.array(found) for method, found in shares.items()}


def read(home: Path) -> list[SceneSet]:
    """The sets in a folder by scene; none where there is no folder.

    Raises
    ------
    InputError
        The list of runs or a set cannot be read; AssetError: a set is none.
    """
    scenes: dict[Scene, list[SetRun]] = {}
    for run in read_runs(home):
        scenes.setdefault(run.key.scene, []).append(run)
    sets = []
    for scene, runs in scenes.items():
        (found,) = read_references(home / file_name(scene)).values()
        sets.append(SceneSet(scene, found, tuple(runs)))
    return sets


def file_name(scene: Scene) -> str:
    """The name of the file of a scene's set."""
    gripper, target, protocol = scene
    return f"{Path(gripper).stem}-{Path(target).stem}-{protocol.replace(' ', '-')}.npz"


def read_runs(home: Path) -> list[SetRun]:
    """The runs behind the sets in a folder, sorted.

    Raises
    ------
    InputError
        The file is no such list: the line is named.
    """
    file, runs = home / RUNS, []
    if not file.exists():
        return []
    with disk_text(file) as lines:
        reader = csv.DictReader(lines, strict=True)
        for values in reader:
            try:
                runs.append(msgspec.convert(values, SetRun, strict=False))
            except msgspec.ValidationError as error:
                raise InputError(f"{file}, line {reader.line_num}: {error}; restore the line.") from None
    return sorted(runs)


def gather(home: Path, folders: Mapping[Key, RunFolder], rows: Mapping[Key, Row]) -> bool:
    """Add runs with a row, which are finished, to the sets of their scenes; returns whether there were some.

    A set with a run of other evaluation code than the new ones is begun anew. It is written before the list
    of runs: after a stop between the two, the same runs are added again, which changes nothing.
    """
    known = read_runs(home)
    here = {(run.key, run.code) for run in known}
    new: dict[Scene, list[Key]] = {}
    for key in sorted(folders.keys() & rows.keys()):
        if (key, rows[key].code) not in here:
            new.setdefault(key.scene, []).append(key)
    for scene, keys in new.items():
        added = [_set_run(folders[key], rows[key]) for key in keys]
        old = [run for run in known if run.key.scene == scene]
        file = home / file_name(scene)
        if {run.code for run in old} - {run.code for run in added}:
            file.unlink(missing_ok=True)
            old = []
        build_reference_sets([folders[key] for key in keys], file)
        names = {run.run for run in added}
        others = [run for run in known if run.key.scene != scene]
        known = sorted([*others, *(run for run in old if run.run not in names), *added])
        _write_runs(home, known)
    return bool(new)


def _set_run(folder: RunFolder, row: Row) -> SetRun:
    with folder.journal() as journal:
        return SetRun(*row.key, code=row.code, run=search_digest(folder.spec, journal.scene))


def _write_runs(home: Path, runs: Collection[SetRun]) -> None:
    lines = io.StringIO()
    writer = csv.DictWriter(lines, COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(map(msgspec.structs.asdict, runs))
    with atomic_files.writing(home):
        atomic_files.write(home / RUNS, lines.getvalue().encode())


SIZES = (
    "hand", "object", "protocol", "runs", "cells", "estimated cells", "in the set, %",
    "cells that hold", "estimated to hold", "in the set of these, %",
)  # fmt: skip


def sets_part(sets: Sequence[SceneSet]) -> str:
    """The section of the page; empty while there is no set."""
    if not sets:
        return ""
    parts = [
        "## Reference sets of our own\n\n"
        "The cells of all successes, and those that hold, of the runs of all methods on a scene: published "
        "sets have no hand or object of most of these, and count first touches alone. *Estimated*: the "
        "number of cells that runs like these can find, a lower bound, with its 95% interval "
        f"([how](../coverage.md#how-it-is-estimated)); a set of {COMPLETE:.0%} of them would be complete "
        f"enough. The sets are in [{FOLDER}]({FOLDER}), to be used with `qdgrasp coverage --reference`.\n",
        markdown_table(SIZES, [(*one.scene, *_sizes(one.found)) for one in sets]),
        "*Coverage* of these sets by a run, in percent: under `physical` of cells that hold, else of all. "
        "Those that no other run found do not count, so that no run is measured by its own finds; median "
        "over runs, and in brackets their range; the greatest median stands out. *Complete*: the estimated "
        "share of such cells that the set has. A method that finds more has a greater part in the set.\n",
        *_coverage_tables(sets),
    ]
    return "\n".join(parts)


def _sizes(found: ReferenceSet) -> Iterator[str]:
    assert found.by_run is not None
    yield str(len(found.by_run))
    for some in (found, found.robust):
        yield str(len(some))
        estimate = some.estimate
        if estimate is None:
            yield from ("", "")
        else:
            yield f"{estimate.total:.0f}" + (
                "" if estimate.low is None else f" ({estimate.low:.0f} to {estimate.high:.0f})"
            )
            yield f"{100 * estimate.completeness:.0f}"


def _coverage_tables(sets: Sequence[SceneSet]) -> Iterator[str]:
    """A table for each protocol, with a column for each method."""
    for protocol in dict.fromkeys(one.scene[2] for one in sets):
        here = [one for one in sets if one.scene[2] == protocol]
        methods = sorted({method for one in here for method in one.coverage})
        lines = []
        for one in here:
            complete = f"{100 * one.estimate.completeness:.0f}" if one.estimate else ""
            best = max(float(np.median(shares)) for shares in one.coverage.values())
            shares = (one.coverage.get(method, np.zeros(0)) for method in methods)
            lines.append((*one.scene, complete, *(_share(share, best) for share in shares)))
        yield markdown_table(("hand", "object", "protocol", "complete, %", *methods), lines)


def _share(shares: NDArray[np.float64], best: float) -> str:
    words = spread(100 * shares)
    return f"**{words}**" if words and np.median(shares) == best else words
