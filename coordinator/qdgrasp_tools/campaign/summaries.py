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
from msgspec import field, structs

from qdgrasp_assets.grippers.hand_model import coupling_error
from qdgrasp_coordinator.metrics.cells import niches
from qdgrasp_coordinator.metrics.job_status import (
    MOST_NAMES,
    JobEvent,
    ObjectListing,
    ObjectState,
    RunListing,
)
from qdgrasp_coordinator.metrics.run_stats import NO_TOTALS, RunCounter, RunTotals
from qdgrasp_coordinator.metrics.success_metrics import (
    Diversity,
    EtaSummary,
    NuSummary,
    SuccessMetrics,
    diversity,
)
from qdgrasp_coordinator.metrics.successes import TrialPlan, find_successes
from qdgrasp_coordinator.storage.engine_table import HeldShare, held_shares
from qdgrasp_coordinator.storage.job_folder import JobFolder
from qdgrasp_coordinator.storage.outputs import CAMPAIGN, SKIPPED
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.errors import UnknownName
from qdgrasp_protocol.rows import Outcome
from qdgrasp_protocol.spec import DEFAULT_ENGINE, RunSpec
from qdgrasp_protocol.text import aligned_text, counted
from qdgrasp_tools.campaign.campaign_file import read_campaign
from qdgrasp_tools.campaign.campaign_folder import campaign_progress
from qdgrasp_tools.campaign.object_library import SkippedObject, read_skip_report
from qdgrasp_tools.report.row_report import genome_reader

FIRST_FIELDS = (
    *("run", "gripper", "object", "scale", "method", "aim_for"),
    *("told_apart_by", "protocol", "engine", "seed", "overlaps_mode"),
    *("evaluations", "budget", "rows", "trials"),
)
"""Figures that a table begins with."""


class RunSummary(RunListing, frozen=True, kw_only=True):
    """The figures of a run."""

    scale: float = 1.0
    """Metres to a unit of the object's mesh file."""
    aim_for: str = ""
    """Objective of a method that has one; empty: none, or `touch` in runs recorded without it."""
    told_apart_by: str = ""
    """Diversity that the search looked for, `position`, `orientation` or `contact`; empty: no objective."""
    engine: str = DEFAULT_ENGINE
    """The physics engine."""
    overlaps_mode: str
    """Mode of counting overlaps, `count` or `redraw`."""
    diversity: Diversity
    """Niches of position, orientation and synergy with a success."""
    qd_score: float
    """Best fitness in each of these cells, summed; fitness as the search gets it."""
    success_share: float | None
    """`successes` over `evaluations`, 0 to 1; None before the first evaluation."""
    mean_fitness: float | None
    """Mean fitness of all successes; None without one."""
    nu: NuSummary
    """Lean of successes from the surface normal."""
    eta: EtaSummary | None
    """Estimated probability that successes transfer; None where the protocol has no trials."""
    cpu_seconds: float
    wall_seconds: float
    complete: bool
    collision_source: str
    """Source of the object's convex parts."""
    coupling_error: float | None
    """Farthest that a coupled joint is from its place in grasps that hold [rad or m]; None: there is none."""
    platform: dict[str, str]
    in_both: dict[str, HeldShare] = field(default_factory=dict)
    """Of grasps that hold, how many do so in another engine too, by its name, where the run has a table."""
    rows_by_host: dict[str, int] = field(default_factory=dict)
    """Rows that the workers of each host made."""

    @property
    def words(self) -> str:
        """One sentence for a person."""
        evaluations = counted(self.evaluations, "evaluation")
        return (
            f"{evaluations} of {self.method} with {self.gripper} on {self.object}: "
            f"{self.found}, {counted(self.grasps, 'grasp')}, {self.robust} robust; {self.screened}."
        )

    @property
    def table(self) -> str:
        """All figures, one to a line."""
        values = dict.fromkeys(FIRST_FIELDS, "") | structs.asdict(self)
        platform, _ = values.pop("platform"), values.pop("outcomes")
        values["diversity"], values["nu"] = self.diversity.words, self.nu.words
        values["eta"] = None if self.eta is None else self.eta.words
        shares, hosts = values.pop("in_both"), values.pop("rows_by_host")
        lines = [f"{name.replace('_', ' '):<16} {_text(value)}" for name, value in values.items()]
        lines += [f"{f'in {name} too':<16} {share.words}" for name, share in shares.items()]
        lines += [f"{'made on':<16} {host}: {counted(rows, 'row')}" for host, rows in hosts.items()]
        lines += [f"{'platform':<16} {name} {value[:24]}" for name, value in sorted(platform.items())]
        return "\n".join(lines)


def run_summary(folder: RunFolder) -> RunSummary:
    """Count what is in a run's folder, also while the run goes on."""
    spec = folder.spec
    with folder.journal() as journal:
        plan, found, reader = TrialPlan.of(spec), RunCounter(spec), genome_reader(folder)
        metrics, keys, outcomes = SuccessMetrics(plan), [np.zeros(0, np.int64)], [np.zeros(0, np.uint8)]
        scene = folder.scene()
        postures = [np.zeros((0, len(scene.gripper.joints)), np.float32)]
        for part in find_successes(found.counting(journal.blocks()), plan):
            metrics.add(part)
            keys.append(niches(part.rows, reader))
            outcomes.append(part.rows["outcome"])
            postures.append(part.rows["joints"][outcomes[-1] == Outcome.HELD])
        totals, hosts = found.totals, Counter[str]()
        for _, n, _, host in journal.makers():
            hosts[host] += n
        return RunSummary(
            **structs.asdict(RunListing.of(journal.run, journal.scene, found)),
            scale=spec.scale or 1.0,
            aim_for=spec.aim_for or "",
            told_apart_by=spec.diversity or ("position" if spec.aim_for else ""),
            engine=spec.engine or DEFAULT_ENGINE,
            overlaps_mode=spec.overlaps,
            diversity=diversity(np.concatenate(keys), np.concatenate(outcomes)),
            qd_score=metrics.qd_score,
            success_share=totals.successes / totals.evaluations if totals.evaluations else None,
            mean_fitness=metrics.mean_fitness,
            nu=metrics.nu,
            eta=metrics.eta,
            cpu_seconds=journal.cpu_seconds,
            wall_seconds=journal.wall_seconds,
            complete=found.finished is not None,
            collision_source=scene.object.collision_source,
            coupling_error=coupling_error(scene.gripper, np.concatenate(postures)),
            platform=journal.platform,
            in_both=held_shares(folder),
            rows_by_host=dict(hosts.most_common()),
        )


def _text(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.1f}" if value >= 10 else f"{value:.3g}"
    return "none" if value is None else str(value)


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
        names=list(names | dict.fromkeys(group))[:MOST_NAMES],
        runs=len(group),
        runs_done=done,
        state=_state(len(group), done, 0, has_begun=bool(begun)),
        little=little,
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
    return " ".join((each.object, name, each.category, *each.hands, each.state, each.note)).lower()


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
        reasons, states = values.pop("reasons"), values.pop("states")
        ended = values.pop("ended")
        little = values.pop("little")
        lines = [f"{name.replace('_', ' '):<16} {value}" for name, value in values.items()]
        lines += [f"{'ended':<16} {count}: {reason}" for reason, count in ended.items()]
        lines += [f"{'left out':<16} {count}: {reason}" for reason, count in reasons.items()]
        lines.append(f"{'objects by state':<16} {', '.join(f'{n} {state}' for state, n in states.items())}")
        lines.append(f"{'got little':<16} {len(little)}")
        lines += [f"  {words}" for words in little[:LEAST_NAMED]]
        if len(little) > LEAST_NAMED:
            lines.append(f"  and {len(little) - LEAST_NAMED} more, which --objects lists")
        return "\n".join(lines)


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
