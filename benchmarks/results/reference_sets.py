"""Reference sets of our own: the cells that the runs of a scene found, and an estimate of the others.

The published sets know neither the protocol `physical` nor which run found which cell, and have no set of the
hands and objects made here. A set here is built as `qdgrasp reference build` does, from the finished runs of
every method, and `runs.csv` beside the sets names these runs. Each further run of a scene goes into its set.
"""

import csv
import io
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
from benchmarks.results.comparison import Arm, spread
from benchmarks.results.measure import rows_digest
from benchmarks.results.table import Key, Row, disk_text
from numpy.typing import NDArray

from qdgrasp_coordinator.metrics.reference_coverage import ReferenceSet, read_references
from qdgrasp_coordinator.storage import atomic_files
from qdgrasp_coordinator.storage.run_folder import RunFolder, search_digest
from qdgrasp_protocol.errors import InputError
from qdgrasp_tools.cli.reference_commands import ENOUGH
from qdgrasp_tools.report.bootstrap import LEAST_RUNS
from qdgrasp_tools.report.reference_builder import build_reference_sets
from qdgrasp_tools.report.tables import markdown_table

FOLDER = "reference-sets"
"""Name of their folder beside the table."""
RUNS = "runs.csv"


class SetRun(NamedTuple):
    """A run that a set was built from."""

    key: Key
    """The key of its row in the table of runs, with the greatest budget with which it was added."""
    code: str
    """Beginning of the digest of the evaluation's code, as in that row."""
    run: str
    """Its name in the set: `search_digest`."""


COLUMNS = (*Key._fields, "code", "run")
Scene = tuple[str, str, str]


class MethodCoverage(NamedTuple):
    """The shares of a set that the runs of a method found."""

    budget: int
    method: str
    by_run: NDArray[np.float64]
    """(n,): by each of its runs."""
    together: float
    """By any of them."""
    alone: float
    """By any of them, and by no run of another method."""


@dataclass(frozen=True)
class SceneSet:
    """The set of a scene, and the runs that it was built from."""

    scene: Scene
    """Hand, object and protocol."""
    found: ReferenceSet
    runs: tuple[SetRun, ...]

    @property
    def counted(self) -> ReferenceSet:
        """The cells that coverage counts: under `physical` those that hold, else all with a success."""
        return self.found.robust if self.scene[2].startswith("physical") else self.found

    @property
    def by_seed(self) -> ReferenceSet:
        """The set with the runs of all methods with a seed as one run, for the seeds that every method has.

        Cells are estimated from these, as they are alike and independent: runs with one seed share the points
        of the surface, and of methods with one prior the first generation.
        """
        assert self.found.by_run is not None
        assert self.found.origin is not None
        by_arm: dict[Key, set[int]] = {}
        for run in self.runs:
            by_arm.setdefault(run.key._replace(seed=0), set()).add(run.key.seed)
        seeds = {run.run: run.key.seed for run in self.runs}
        of_runs = np.array([seeds[name] for name in self.found.origin.runs])
        whole = sorted(set.intersection(*by_arm.values()))
        found = [self.found.by_run[of_runs == seed].max(axis=0) for seed in whole]
        return replace(self.found, by_run=np.array(found, np.uint8).reshape(len(whole), len(self.found)))

    @property
    def coverage(self) -> list[MethodCoverage]:
        """The coverage of the set by each method, by budget; none where it counts no cell."""
        counted = self.counted
        assert counted.by_run is not None
        assert counted.origin is not None
        if not len(counted):
            return []
        lines = dict(zip(counted.origin.runs, counted.by_run > 0, strict=True))
        arms: dict[tuple[int, str], list[NDArray[np.bool_]]] = {}
        for run in self.runs:
            arms.setdefault((run.key.budget, Arm(run.key, (), {}).method), []).append(lines[run.run])
        found = []
        for (budget, method), reached in sorted(arms.items()):
            mine = np.any(reached, axis=0)
            others = [line for arm, some in arms.items() if arm[1] != method for line in some]
            alone = mine & ~np.any([np.zeros_like(mine), *others], axis=0)
            found.append(
                MethodCoverage(budget, method, np.mean(reached, axis=1), float(mine.mean()), alone.mean())
            )
        return found


def read(home: Path) -> list[SceneSet]:
    """The sets in a folder by scene; none where there is no folder.

    Raises
    ------
    InputError
        The list of runs cannot be read, or it and the sets differ; AssetError: a set is none.
    """
    scenes: dict[Scene, list[SetRun]] = {}
    for run in read_runs(home):
        scenes.setdefault(run.key.scene, []).append(run)
    return [_read_set(home / file_name(scene), scene, tuple(runs)) for scene, runs in scenes.items()]


def _read_set(file: Path, scene: Scene, runs: tuple[SetRun, ...]) -> SceneSet:
    if not file.exists():
        why = "it does not exist"
    else:
        (found,) = read_references(file).values()
        if found.origin is not None and {*found.origin.runs} == {run.run for run in runs}:
            return SceneSet(scene, found, runs)
        why = "it was built from other runs"
    raise InputError(
        f"{file} is not the set that {file.with_name(RUNS)} describes: {why}; delete it and the lines of its "
        "scene there, and add the folders of its runs again."
    )


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
                *of_key, code, run = (values[name] for name in COLUMNS)
                runs.append(SetRun(msgspec.convert(of_key, Key, strict=False), code, run))
            except msgspec.ValidationError as error:
                raise InputError(f"{file}, line {reader.line_num}: {error}; restore the line.") from None
    return sorted(runs)


def gather(
    home: Path, folders: Mapping[Key, RunFolder], rows: Mapping[Key, Row], current: Collection[str]
) -> bool:
    """Add runs to the sets of their scenes; returns whether there were some.

    Left out are folders that are not those of their rows, and scenes on which no run has a success yet. A set
    with a run of code that is not current is begun anew. A set is written before the list of runs: after a
    stop between the two, the same runs are added again, which changes nothing.

    Parameters
    ----------
    rows
        The rows of finished runs, of current code.
    current
        Digests of evaluation code that count as today's.
    """
    listed = read_runs(home)
    known = {
        run.run: run for run in listed if run.code in current and (home / file_name(run.key.scene)).exists()
    }
    there = {(run.key, run.code) for run in known.values()}
    new: dict[Scene, dict[str, SetRun]] = {}
    for key in sorted(folders.keys() & rows.keys()):
        run = None if (key, rows[key].code) in there else _set_run(folders[key], rows[key])
        if run is not None and (run.run not in known or known[run.run].key.budget < run.key.budget):
            new.setdefault(run.key.scene, {})[run.run] = run  # of equal runs the longest comes last
    is_more = False
    for scene, added in new.items():
        here = {name: run for name, run in known.items() if run.key.scene == scene}
        if not here and not any(rows[run.key].successes for run in added.values()):
            continue
        file, is_more = home / file_name(scene), True
        if not here:
            file.unlink(missing_ok=True)
        build_reference_sets([folders[run.key] for run in added.values()], file)
        listed = sorted([run for run in listed if run.key.scene != scene] + [*(here | added).values()])
        _write_runs(home, listed)
    return is_more


def _set_run(folder: RunFolder, row: Row) -> SetRun | None:
    """The run in a folder; None: the row is that of another folder."""
    with folder.journal() as journal:
        rows = journal.rows(0, journal.count)
        if rows_digest(rows) != row.journal:
            return None
        return SetRun(row.key, row.code, search_digest(folder.spec, journal.scene))


def _write_runs(home: Path, runs: Collection[SetRun]) -> None:
    lines = io.StringIO()
    writer = csv.writer(lines, lineterminator="\n")
    writer.writerow(COLUMNS)
    writer.writerows((*run.key, run.code, run.run) for run in runs)
    with atomic_files.writing(home):
        atomic_files.write(home / RUNS, lines.getvalue().encode())


SIZES = (
    "hand", "object", "protocol", "runs", "seeds", "cells", "estimated cells", "of the estimate, %",
    "cells that hold", "estimated to hold", "of this estimate, %",
)  # fmt: skip
COVERED = (
    "hand", "object", "protocol", "evaluations", "method", "runs", "coverage, %", "together, %", "alone, %",
)  # fmt: skip


def sets_part(sets: Sequence[SceneSet], scenes: int) -> str:
    """The section of the page, with the number of scenes of which there are runs; empty without a set."""
    if not sets:
        return ""
    lines = [
        (*one.scene, f"{each.budget:,}", each.method, str(len(each.by_run)), spread(100 * each.by_run),
         f"{100 * each.together:.1f}", f"{100 * each.alone:.1f}")
        for one in sets
        for each in one.coverage
    ]  # fmt: skip
    return "\n".join(
        [
            "## Reference sets of our own\n\n"
            "The cells of all successes, and those that hold, of the runs of all methods on a scene. The "
            "published sets are of another protocol, and do not say which run found which cell, so that "
            "nothing can be estimated from them. *Estimated*: the least number of cells that more seeds of "
            "these methods would find, with its 95% interval. All runs with a seed count as one; *seeds*: "
            "those that every method has, from which it is estimated ([how, and how far it can be too "
            f"low](../coverage.md#how-it-is-estimated)). There is no estimate where these are fewer than "
            f"{LEAST_RUNS}, or did not find all cells of the set. A set of {ENOUGH:.0%} of the estimate "
            f"would be complete enough. There are sets of {len(sets)} of the "
            f"{scenes} scenes of the benchmark and of the claims that have runs: a set needs the folders of "
            f"its runs. They are in [{FOLDER}]({FOLDER}), to be used with `qdgrasp coverage --reference`.\n",
            markdown_table(SIZES, [(*one.scene, str(len(one.runs)), *_sizes(one.by_seed)) for one in sets]),
            "*Coverage*: the share of the set that a run found, its own finds among them, median over runs, "
            "and in brackets their range; under `physical` of the cells that hold, else of all. *Together*: "
            "that all runs of the method with as many evaluations found; *alone*: that no run of another "
            "method found. As shares of all cells these would be lower: a set has no greater share of them "
            "than of its estimate.\n",
            markdown_table(COVERED, lines),
        ]
    )


def _sizes(found: ReferenceSet) -> Iterator[str]:
    assert found.by_run is not None
    yield str(len(found.by_run))
    for some in (found, found.robust):
        assert some.by_run is not None
        yield str(len(some))
        is_whole = len(some.by_run) >= LEAST_RUNS and (some.by_run > 0).any(axis=0).all()
        if not is_whole or (estimate := some.estimate) is None:
            yield from ("", "")
        else:
            yield estimate.total_words().removeprefix("an estimated ").removesuffix(" or more")
            yield f"{100 * len(some) / estimate.total:.0f}"
