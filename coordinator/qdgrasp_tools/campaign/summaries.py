"""Summaries: of a run, of a campaign, and of the objects of a campaign.

The table of objects says what was found on each, and why some have few grasps. It is a function of the runs
with their counts and of the objects that were left out, without clock or files. `qdgrasp info` and the
monitors show the same table.
"""

import re
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import structs

from qdgrasp_coordinator.metrics.job_status import (
    MOST_NAMES,
    JobEvent,
    ObjectListing,
    ObjectState,
    RunListing,
)
from qdgrasp_coordinator.metrics.run_stats import NO_TOTALS, RunTotals
from qdgrasp_coordinator.storage.job_folder import JobFolder
from qdgrasp_coordinator.storage.outputs import CAMPAIGN, SKIPPED
from qdgrasp_protocol.errors import UnknownName
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_protocol.text import aligned_text, counted
from qdgrasp_tools.campaign.campaign_file import read_campaign
from qdgrasp_tools.campaign.campaign_folder import campaign_progress
from qdgrasp_tools.campaign.object_library import SkippedObject, read_skip_report
from qdgrasp_tools.report.run_report import report_table

LITTLE_SHARE = 0.1
"""An object got little with less than this share of the median object's grasps or cells, for each run."""
MOST_WARNINGS = 4  # The most warnings about one object
NUMBERS = re.compile(r"(\d+)")


def list_objects(
    specs: Mapping[str, RunSpec], begun: Mapping[str, RunListing], skipped: Iterable[SkippedObject] = ()
) -> list[ObjectListing]:
    """Return the objects of runs, in their order, and behind them those that were left out.

    `specs` are those of all runs, by name; `begun` are the counts of those that have begun.
    """
    groups: dict[str, dict[str, RunSpec]] = {}
    for name, spec in specs.items():
        groups.setdefault(spec.object, {})[name] = spec
    found = {file: [begun[name] for name in group if name in begun] for file, group in groups.items()}
    finished = {file: [run for run in runs if run.finished] for file, runs in found.items()}
    means = {file: _means(done) for file, done in finished.items() if done}
    medians = np.median(list(means.values()), axis=0).tolist() if means else [0.0, 0.0]
    listings = [
        _listing(file, group, found[file], _shortfall(finished[file], medians))
        for file, group in groups.items()
    ]
    return listings + [_skipped_listing(each) for each in skipped]


def _means(done: Sequence[RunListing]) -> tuple[float, float]:
    """Return the mean grasps and cells of finished runs."""
    totals = sum(done, NO_TOTALS)
    return totals.grasps / len(done), totals.cells / len(done)


def _listing(
    file: str, group: Mapping[str, RunSpec], begun: Sequence[RunListing], little: str
) -> ObjectListing:
    about = next(iter(group.values())).about
    done, names = sum(bool(run.finished) for run in begun), dict.fromkeys(run.run for run in begun)
    return ObjectListing(
        **structs.asdict(sum(begun, NO_TOTALS)),
        object=(about.id if about and about.id else "") or (Path(file).stem if "/" in file else file),
        file=file,
        category=(about.category if about else None) or "",
        hands=list({Path(spec.gripper).stem: None for spec in group.values()}),
        regions="; ".join(filter(None, dict.fromkeys(map(region_words, group.values())))),
        names=list(names | dict.fromkeys(group))[:MOST_NAMES],
        runs=len(group),
        runs_done=done,
        state=_state(len(group), done, 0, has_begun=bool(begun)),
        little=little,
    )


def region_words(spec: RunSpec) -> str:
    """Return the regions of a spec, files by their names: "on handle, avoid rim"; empty: none."""
    regions = ((key, name) for key in ("on", "avoid") for name in getattr(spec, key) or ())
    return ", ".join(f"{key} {Path(name).name}" for key, name in regions)


def _state(runs: int, done: int, failed: int, *, has_begun: bool, is_building: bool = False) -> ObjectState:
    if failed == runs:
        return "failed"
    if done + failed == runs:
        return "done"
    if has_begun:
        return "running"
    return "building" if is_building else "waiting"


def _skipped_listing(skipped: SkippedObject) -> ObjectListing:
    return ObjectListing(
        **structs.asdict(NO_TOTALS),
        object=skipped.object,
        file=skipped.file or skipped.object,
        state="skipped",
        warnings=[f"left out: {skipped.reason}"],
    )


def _shortfall(done: Sequence[RunListing], medians: Sequence[float]) -> str:
    """Return why an object got little in its finished runs; empty where it did not, or none is."""
    if not done:
        return ""
    (grasps, cells), found = _means(done), sum(done, NO_TOTALS)
    if not grasps:
        return f"no grasp: {main_loss(found)}"
    if grasps < LITTLE_SHARE * medians[0]:
        return f"few grasps: {main_loss(found)}"
    return f"few cells: {found.found}" if cells < LITTLE_SHARE * medians[1] else ""


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
    return " ".join(
        (each.object, name, each.category, *each.hands, each.regions, each.state, each.note)
    ).lower()


def count_states(listings: Iterable[ObjectListing]) -> dict[str, int]:
    """Return the number of objects in each state that one is in."""
    counts = Counter(each.state for each in listings)
    return {state: counts[state] for state in STATES if counts[state]}


WORDS = ("object", "state", "regions", "note")  # Columns of words; others are numbers
COLUMNS = (*WORDS[:3], "runs", "evaluations", "successes", "share", "cells", "grasps", "errors", WORDS[3])
"""Columns of the table as text; `regions` is there if a run has some."""


def table_lines(listings: Sequence[ObjectListing]) -> list[str]:
    """Return the table as text: a line with the names of columns, and one for each object."""
    names = [name for name in COLUMNS if name != "regions" or any(each.regions for each in listings)]
    cells = [[_cell(each, name) for name in names] for each in listings]
    return aligned_text([names, *cells], [names.index(name) for name in WORDS if name in names]).splitlines()


def _cell(each: ObjectListing, name: str) -> str:
    if name == "runs":
        return f"{each.runs_done}/{each.runs}"
    return f"{100 * each.success_share:.1f} %" if name == "share" else str(getattr(each, name))


CAMPAIGN_FIELDS = ("campaign", "runs", "runs_done", "objects", "budget")  # Of a table's beginning


class CampaignSummary(RunTotals, frozen=True, kw_only=True):
    """Counts of all rows of a campaign, of what is asked for, finished and left out."""

    campaign: str
    runs: int
    runs_done: int
    objects: int
    budget: int
    """Sum of the budgets of all runs."""
    skipped: int
    """Objects that cannot be used, and are left out."""
    ended: dict[str, int]
    """Number of finished runs for each reason of their end, the most frequent first, as in `reasons`."""
    reasons: dict[str, int]
    """Number of objects left out for each reason, the most frequent first; numbers in it are left out."""
    states: dict[str, int]
    """Number of objects in each state."""
    little: list[str]
    """The objects that got little, with the reason."""

    @property
    def table(self) -> str:
        """All counts, one to a line."""
        values = dict.fromkeys(CAMPAIGN_FIELDS, "") | structs.asdict(self)
        ended, reasons, states, little = map(values.pop, ("ended", "reasons", "states", "little"))
        values["ended"] = [f"{count}: {reason}" for reason, count in ended.items()]
        values["left_out"] = [f"{count}: {reason}" for reason, count in reasons.items()]
        values["objects_by_state"] = ", ".join(f"{n} {state}" for state, n in states.items())
        more = len(little) - LEAST_NAMED
        named = [f"and {more} more, which --objects lists"] if more > 0 else []
        values["got_little"] = [str(len(little)), *little[:LEAST_NAMED], *named]
        return report_table(values)


DIGITS = re.compile(r"-?\d+(?:\.\d+)?(?:e-?\d+)?|'[^']*'")
"""Numbers and names, which reasons are told apart without."""
LEAST_NAMED = 10  # The most objects that a summary's table names


def campaign_objects(folder: JobFolder) -> list[ObjectListing]:
    """Return the table of a campaign's objects, also while it goes on."""
    return list_objects(*_runs_so_far(folder), read_skip_report(folder.path / SKIPPED))


def campaign_summary(folder: JobFolder) -> CampaignSummary:
    """Count what a campaign asks for, has finished and left out, also while it goes on."""
    runs, begun = _runs_so_far(folder)
    skipped = read_skip_report(folder.path / SKIPPED)
    objects = list_objects(runs, begun, skipped)
    reasons = Counter(DIGITS.sub("N", each.reason.partition("; ")[0]) for each in skipped)
    ended = Counter(DIGITS.sub("N", found.finished) for found in begun.values() if found.finished)
    return CampaignSummary(
        **structs.asdict(sum((found.totals for found in begun.values()), NO_TOTALS)),
        campaign=folder.name,
        runs=len(runs),
        runs_done=ended.total(),
        objects=len({spec.object for spec in runs.values()}),
        budget=sum(spec.evaluations for spec in runs.values()),
        skipped=reasons.total(),
        ended=dict(ended.most_common()),
        reasons=dict(reasons.most_common()),
        states=count_states(objects),
        little=[f"{one.object}: {one.note}" for one in objects if one.little],
    )


def _runs_so_far(folder: JobFolder) -> tuple[Mapping[str, RunSpec], dict[str, RunListing]]:
    """Return the runs that a begun campaign asks for, and the counts of those that have begun."""
    runs = read_campaign(folder.path / CAMPAIGN, here=False).runs
    return runs, campaign_progress(folder, runs)
