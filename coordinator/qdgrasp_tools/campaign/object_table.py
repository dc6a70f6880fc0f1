"""The table of a campaign's objects: the grasps found on each, and why some have few.

A function of the campaign's runs with their counts and of the objects that were left out, without clock or
files. `qdgrasp info` and the monitors show the same table.
"""

import re
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from msgspec import Struct, structs

from qdgrasp_coordinator.metrics.job_status import MOST_NAMES, JobEvent, ObjectListing, ObjectState
from qdgrasp_coordinator.metrics.run_stats import NO_TOTALS, RunTotals
from qdgrasp_coordinator.storage.tables import aligned_text, csv_text
from qdgrasp_protocol.errors import UnknownName
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_protocol.text import counted
from qdgrasp_tools.campaign.object_library import SkippedObject

LITTLE_SHARE = 0.1
"""An object got little with less than this share of the median object's grasps or cells, for each run."""
MOST_WARNINGS = 4  # The most warnings about one object
NUMBERS = re.compile(r"(\d+)")


class ObjectRun(NamedTuple):
    """A run of an object, as far as it has got."""

    name: str
    spec: RunSpec
    totals: RunTotals | None = None
    """Counts of its rows; None: it has not begun."""
    is_done: bool = False


def list_objects(runs: Iterable[ObjectRun], skipped: Iterable[SkippedObject] = ()) -> list[ObjectListing]:
    """Return the objects of runs, in their order, and behind them those that were left out."""
    groups: dict[str, list[ObjectRun]] = {}
    for run in runs:
        groups.setdefault(run.spec.object, []).append(run)
    finished = {file: [run for run in group if run.is_done] for file, group in groups.items()}
    means = {file: _means(done) for file, done in finished.items() if done}
    medians = np.median(list(means.values()), axis=0).tolist() if means else [0.0, 0.0]
    listings = [
        _listing(file, group, _shortfall(finished[file], means[file], medians) if file in means else "")
        for file, group in groups.items()
    ]
    return listings + [_skipped_listing(each) for each in skipped]


def _means(done: Sequence[ObjectRun]) -> tuple[float, float]:
    """Return the mean grasps and cells of finished runs."""
    totals = sum((run.totals for run in done if run.totals), NO_TOTALS)
    return totals.grasps / len(done), totals.cells / len(done)


def _listing(file: str, group: Sequence[ObjectRun], little: str) -> ObjectListing:
    about, done = group[0].spec.about, sum(run.is_done for run in group)
    begun = [run.name for run in group if run.totals is not None]
    return ObjectListing(
        **structs.asdict(sum((run.totals for run in group if run.totals is not None), NO_TOTALS)),
        object=(about.id if about and about.id else "") or (Path(file).stem if "/" in file else file),
        file=file,
        category=(about.category if about else None) or "",
        hands=list({Path(run.spec.gripper).stem: None for run in group}),
        names=[*begun, *(run.name for run in group if run.totals is None)][:MOST_NAMES],
        runs=len(group),
        runs_done=done,
        state=_state(len(group), done, 0, has_begun=bool(begun)),
        little=little,
        warnings=_saturation(group),
    )


def _state(runs: int, done: int, failed: int, *, has_begun: bool, is_building: bool = False) -> ObjectState:
    if failed == runs:
        return "failed"
    if done + failed == runs:
        return "done"
    if has_begun:
        return "running"
    return "building" if is_building else "waiting"


def _skipped_listing(skipped: SkippedObject) -> ObjectListing:
    mend = f"; mend: {skipped.mend}" if skipped.mend else ""
    return ObjectListing(
        **structs.asdict(NO_TOTALS),
        object=skipped.object,
        file=skipped.file or skipped.object,
        state="skipped",
        warnings=[f"left out: {skipped.reason}{mend}"],
    )


def _saturation(group: Sequence[ObjectRun]) -> list[str]:
    """Return the warning that every run has ended because it found no new cell."""
    ends = {run.spec.no_new_cell for run in group if run.is_done and _is_early(run) and run.totals}
    if not all(run.is_done for run in group) or len(ends) != 1 or None in ends:
        return []
    has_found = all(run.totals and run.totals.grasps and _is_early(run) for run in group)
    return [f"saturated: the last {ends.pop()} evaluations found no new cell"] if has_found else []


def _is_early(run: ObjectRun) -> bool:
    """Return whether a finished run has counted fewer evaluations than its budget."""
    return run.totals is not None and run.totals.evaluations < run.spec.evaluations


def _shortfall(done: Sequence[ObjectRun], means: tuple[float, float], medians: Sequence[float]) -> str:
    """Return why an object got little in its finished runs; empty where it did not."""
    grasps, cells = means
    found = sum((run.totals for run in done if run.totals), NO_TOTALS)
    if not grasps:
        head, cause = "no grasp", main_loss(found)
    elif grasps < LITTLE_SHARE * medians[0]:
        head, cause = "few grasps", main_loss(found)
    elif cells < LITTLE_SHARE * medians[1]:
        head, cause = "few cells", found.found
    else:
        return ""
    early = [run for run in done if _is_early(run)]
    if not early:
        return f"{head}: {cause}"
    budget = sum(run.spec.evaluations for run in early)
    evaluations = sum(run.totals.evaluations for run in early if run.totals)
    return f"{head}: {cause}; ended early, after {evaluations} of {counted(budget, 'evaluation')}"


def main_loss(found: RunTotals) -> str:
    """Return what most evaluations were lost to, in words."""
    genomes = found.dead_ends + found.overlaps + found.simulated + found.errors
    dropped = found.successes - found.grasps
    losses = (
        (found.dead_ends, f"{found.dead_ends} of {counted(genomes, 'genome')} led to no pose"),
        (found.overlaps, f"the open hand overlaps it in {found.overlaps} of {counted(genomes, 'pose')}"),
        (found.simulated - found.successes,
         f"{found.successes} of {counted(found.simulated, 'simulation')} touched it"),
        (dropped, f"it was dropped in {dropped} of {counted(found.successes, 'success', 'successes')}"),
        (found.errors, f"the simulator failed on {found.errors} of {counted(genomes, 'row')}"),
    )  # fmt: skip
    count, words = max(losses, key=lambda loss: loss[0])
    return words if count else "no row is recorded"


def with_events(
    listings: Sequence[ObjectListing], events: Iterable[JobEvent], building: Collection[str] = ()
) -> list[ObjectListing]:
    """Return objects with a coordinator's notes on them.

    The notes say which runs failed, which shapes have a fault, and whose shape is being built.
    """
    failed: dict[str, dict[str, str]] = {}
    warned: dict[str, dict[str, None]] = {}
    for event in events:
        if event.kind == "warning" and event.object:
            warned.setdefault(event.object, {})[event.words] = None
        elif event.kind == "error" and event.object:
            failed.setdefault(event.object, {})[event.run] = event.words
    told = failed.keys() | warned.keys() | set(building)
    return [
        _told_listing(each, failed.get(each.file, {}), warned.get(each.file, {}), each.file in building)
        if each.file in told
        else each
        for each in listings
    ]


def _told_listing(
    each: ObjectListing, failed: Mapping[str, str], warned: Iterable[str], is_building: bool
) -> ObjectListing:
    if each.state == "skipped":
        return each
    count = min(each.runs - each.runs_done, max(each.runs_failed, len(failed)))
    words = dict.fromkeys([*each.warnings, *failed.values(), *warned])
    has_begun = each.state in ("running", "done")
    state = _state(each.runs, each.runs_done, count, has_begun=has_begun, is_building=is_building)
    return structs.replace(each, runs_failed=count, state=state, warnings=[*words][:MOST_WARNINGS])


Ordering = Callable[[ObjectListing], Any]
STATES: tuple[ObjectState, ...] = ("failed", "skipped", "building", "running", "waiting", "done")
SORT_KEYS: dict[str, Ordering] = {
    "object": lambda one: _name_parts(one.object),
    "state": lambda one: STATES.index(one.state),
    "runs": lambda one: (one.runs_done, one.runs),
    "evaluations": lambda one: one.evaluations,
    "share": lambda one: one.success_share,
    "cells": lambda one: one.cells,
    "grasps": lambda one: one.grasps,
    "errors": lambda one: one.errors,
    "note": lambda one: (not one.little, not one.warnings, one.note),
}
"""Keys by which objects are sorted; a note sorts those that got little first."""


def _name_parts(name: str) -> list[str | int]:
    """Split a name into words and numbers in turn, so that part 2 stands before part 10."""
    parts = NUMBERS.split(name.lower())
    return [int(part) if place % 2 else part for place, part in enumerate(parts)]


def select_objects(
    listings: Iterable[ObjectListing], search: str = "", sort: str = "", *, down: bool = False
) -> list[ObjectListing]:
    """Return the objects that match a search, sorted.

    All of its words are to occur in what is said of an object. Without `sort` the order stays. Raises
    UnknownName if there is no such key to sort by.
    """
    if sort and sort not in SORT_KEYS:
        raise UnknownName("key to sort by", sort, SORT_KEYS)
    words = search.lower().split()
    found = [each for each in listings if all(word in _searched(each) for word in words)]
    return sorted(found, key=SORT_KEYS[sort], reverse=down) if sort else found


def _searched(each: ObjectListing) -> str:
    name = Path(each.file).name
    return " ".join((each.object, name, each.category, *each.hands, each.state, each.note)).lower()


def least_objects(listings: Iterable[ObjectListing], most: int) -> list[ObjectListing]:
    """Return the objects with a finished run that got least, by grasps and then by cells."""
    return sorted(filter(_has_finished, listings), key=lambda one: (one.grasps, one.cells))[:most]


def _has_finished(each: ObjectListing) -> bool:
    return each.runs_done > 0


class ObjectQuantiles(Struct, frozen=True, kw_only=True):
    """Quantiles of a count over the objects with a finished run."""

    least: float
    quarter: float
    median: float
    three_quarters: float
    most: float

    @classmethod
    def of(cls, values: Sequence[float]) -> "ObjectQuantiles":
        """Return the quantiles of at least one value."""
        found = np.quantile(values, (0, 0.25, 0.5, 0.75, 1)).tolist()
        return cls(**dict(zip(cls.__struct_fields__, found, strict=True)))

    @property
    def words(self) -> str:
        """All of them, from least to most."""
        return " / ".join(f"{value:.0f}" for value in structs.astuple(self))


def object_quantiles(listings: Iterable[ObjectListing]) -> dict[str, ObjectQuantiles]:
    """Return the quantiles of grasps and cells; empty before the first run is finished."""
    judged = list(filter(_has_finished, listings))
    names = ("grasps", "cells") if judged else ()
    return {name: ObjectQuantiles.of([getattr(one, name) for one in judged]) for name in names}


def count_states(listings: Iterable[ObjectListing]) -> dict[str, int]:
    """Return the number of objects in each state that one is in."""
    counts = Counter(each.state for each in listings)
    return {state: counts[state] for state in STATES if counts[state]}


COLUMNS: dict[str, Callable[[ObjectListing], object]] = {
    "object": lambda one: one.object,
    "state": lambda one: one.state,
    "runs": lambda one: f"{one.runs_done}/{one.runs}",
    "evaluations": lambda one: one.evaluations,
    "successes": lambda one: one.successes,
    "share": lambda one: f"{100 * one.success_share:.1f} %",
    "cells": lambda one: one.cells,
    "grasps": lambda one: one.grasps,
    "errors": lambda one: one.errors,
    "note": lambda one: one.note,
}
"""Columns of the table as text."""
LEFT_ALIGNED = ("object", "state", "note")


def table_lines(listings: Sequence[ObjectListing]) -> list[str]:
    """Return the table as text: a line with the names of columns, and one for each object."""
    cells = [[str(text(each)) for text in COLUMNS.values()] for each in listings]
    left = [list(COLUMNS).index(name) for name in LEFT_ALIGNED]
    return aligned_text([list(COLUMNS), *cells], left).splitlines()


def to_csv(listings: Iterable[ObjectListing]) -> bytes:
    """Return the table in CSV with all figures of an object; lists are joined by semicolons."""
    names = ObjectListing.__struct_fields__
    first = ("object", "file", "category", "state", "little", "warnings")
    columns = [*first, *(name for name in names if name not in (*first, "names"))]
    rows = [{name: getattr(each, name) for name in columns} for each in listings]
    joined = [
        {name: "; ".join(value) if isinstance(value, list) else value for name, value in row.items()}
        for row in rows
    ]
    return csv_text(joined, columns).encode()
