"""Evaluates recorded rows again by their genomes, and compares the results bit for bit.

Rows are drawn so that each outcome has its share, and evaluated as runs of a temporary job.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from msgspec import Struct, structs
from numpy.random import Generator
from numpy.typing import NDArray

from qdgrasp_assets.grippers.collision_shapes import check_convex
from qdgrasp_assets.scene import pack_scene
from qdgrasp_coordinator.scheduler.recorder_client import RowSink
from qdgrasp_coordinator.scheduler.run_plan import NamedRunQueue, ReevaluationPlan, RunPlan
from qdgrasp_coordinator.search.fixed_poses import as_given
from qdgrasp_coordinator.search.registry import prior_of
from qdgrasp_coordinator.storage.engine_table import check_table, write_table
from qdgrasp_coordinator.storage.platforms import platform_differences, platform_of
from qdgrasp_coordinator.storage.run_folder import PreparedScene, Provenance, RunFolder, provenance
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.process import Stop
from qdgrasp_protocol.rows import Outcome, Rows
from qdgrasp_protocol.spec import engine_names, run_spec, to_values
from qdgrasp_protocol.text import counted
from qdgrasp_tools.local.progress import ProgressDisplay
from qdgrasp_tools.local.supervisor import LocalJobConfig, check_engines, run_temporary_job, score_genomes
from qdgrasp_tools.verification.comparison import (
    DifferentRow,
    PlatformShare,
    VerificationReport,
    row_differences,
)

RowKinds = NDArray[np.unsignedinteger]


def balanced_sample(kinds: RowKinds, n: int, random: Generator) -> NDArray[np.int64]:
    """Choose `n` rows, as many of each kind (rows,) as of any other; their places, ascending.

    Of a kind that has fewer all are taken, of one that has more they are drawn uniformly; all, where there
    are fewer than `n`.
    """
    # rank the shuffled rows within their kinds, and take the least ranks
    order = random.permutation(len(kinds))
    order = order[np.argsort(kinds[order], kind="stable")]
    starts = np.concatenate([[0], np.cumsum(np.bincount(kinds))])
    ranks = np.arange(len(order)) - starts[kinds[order]]
    chosen = order[np.argsort(ranks, kind="stable")[:n]]
    return np.asarray(np.sort(chosen))


MOST_ROWS = 4096  # Rows in a selection


@dataclass(frozen=True)
class RowSelection:
    """Some rows of one run."""

    folder: RunFolder
    found_by: Provenance
    numbers: NDArray[np.int64]
    """(n,): of the rows in the folder's journal, ascending."""

    def rows(self) -> Rows:
        """Read the rows as they are recorded."""
        first, stop = int(self.numbers[0]), int(self.numbers[-1]) + 1
        with self.folder.journal() as journal:
            parts, begin = [], first
            for rows in journal.blocks(first, stop):
                here = self.numbers[(self.numbers >= begin) & (self.numbers < begin + len(rows))]
                parts.append(rows[here - begin])
                begin += len(rows)
        return np.concatenate(parts)


TRIAL_KIND = 16  # Offset of a trial's kind from that of a nominal row with the same outcome


class ReevaluationQueue(NamedRunQueue):
    """Queue of selections of rows that are evaluated again, and the results so far.

    Each selection is read when it is next.
    """

    def __init__(self, selections: Sequence[RowSelection]) -> None:
        self._selections = {str(number): one for number, one in enumerate(selections)}
        super().__init__(self._plan, {name: len(one.numbers) for name, one in self._selections.items()})
        self._sinks: list[RowSink] = []
        self.different: list[DifferentRow] = []
        self.columns: Counter[str] = Counter()
        self.outcomes: Counter[Outcome] = Counter()

    def _plan(self, name: str) -> RunPlan:
        selection = self._selections[name]
        spec, recorded = selection.found_by.spec, selection.rows()
        plan = ReevaluationPlan(spec, recorded, partial(self.add_row, selection, recorded))
        return RunPlan.of(spec, selection.folder.prepared_scene(), lambda _shape: plan, run=name)

    def make_sink(self, plan: RunPlan) -> RowSink:
        """Make the in-memory sink of a selection."""
        self._sinks.append(RowSink(plan.shape))
        return self._sinks[-1]

    def add_row(self, selection: RowSelection, rows: Rows, place: int, now: np.void, reason: str) -> None:
        """Compare a row with the one at its place in the recorded `rows` (n,), and count it."""
        recorded = rows[place]
        self.outcomes[Outcome(recorded["outcome"])] += 1
        differences = row_differences(recorded, now)
        if not differences:
            return
        self.columns.update(differences.keys())
        self.different.append(
            DifferentRow(
                folder=str(selection.folder.path),
                number=int(selection.numbers[place]),
                trial=int(recorded["trial"]),
                columns=differences,
                reason=reason,
            )
        )

    @property
    def platform(self) -> dict[str, str]:
        """Platform on which rows were evaluated."""
        return next((sink.platform for sink in self._sinks if sink.platform), {})


def choose_rows(folders: Sequence[RunFolder], most: int | None, seed: int) -> list[RowSelection]:
    """Choose rows of all folders, as many of each kind as of any other; `most` None: all.

    Rows on which the simulator failed are tried again too: their machines may have been to blame. Raises
    InputError if there is nothing to compare.
    """
    stocks = list(map(_comparable_rows, folders))
    kinds = np.concatenate([np.zeros(0, dtype=np.uint8), *(kinds for _, kinds in stocks)])
    if not len(kinds):
        raise InputError("Nothing is recorded there that could be evaluated again.")
    places = balanced_sample(kinds, len(kinds) if most is None else most, np.random.default_rng(seed))
    chosen, first = [], 0
    for stock, _ in stocks:
        here = places[(places >= first) & (places < first + len(stock.numbers))] - first
        first += len(stock.numbers)
        chosen += _selections(stock.folder, stock.found_by, stock.numbers[here])
    return chosen


def select_rows(folder: RunFolder, numbers: Sequence[int]) -> list[RowSelection]:
    """Select rows of a run by their numbers in its journal, ascending."""
    with folder.journal() as journal:
        return _selections(folder, provenance(folder, journal), np.array(numbers, dtype=np.int64))


def _selections(folder: RunFolder, by: Provenance, numbers: NDArray[np.int64]) -> list[RowSelection]:
    starts = range(0, len(numbers), MOST_ROWS)
    return [RowSelection(folder, by, numbers[start : start + MOST_ROWS]) for start in starts]


def verify_rows(
    selections: Sequence[RowSelection], config: LocalJobConfig, display: ProgressDisplay, stop: Stop
) -> VerificationReport:
    """Evaluate rows again with workers of this machine, and compare every result bit for bit.

    Raises RunsFailed if a folder cannot be read, and EndedEarly if workers die again and again.
    """
    check_engines(selection.found_by.spec for selection in selections)
    found = ReevaluationQueue(selections)
    run_temporary_job("verify", found, found.make_sink, config, display, stop)
    rows = sum(found.outcomes.values())
    return VerificationReport(
        rows=rows,
        same=rows - len(found.different),
        outcomes={outcome.name.lower(): found.outcomes[outcome] for outcome in sorted(found.outcomes)},
        different=sorted(found.different, key=lambda one: (one.folder, one.number)),
        columns=dict(found.columns.most_common()),
        platform=found.platform,
        origins=list(_platform_shares(selections, found.platform)),
    )


def _comparable_rows(folder: RunFolder) -> tuple[RowSelection, NDArray[np.uint8]]:
    """Return the rows of a run with their kinds (n,): outcomes, trials apart."""
    with folder.journal() as journal:
        blocks = [journal.shape.empty(0)[["outcome", "trial"]]]
        blocks += [rows[["outcome", "trial"]] for rows in journal.blocks()]
        found_by = provenance(folder, journal)
    rows = np.concatenate(blocks)
    kinds = rows["outcome"] + TRIAL_KIND * (rows["trial"] > 0).astype(np.uint8)
    return RowSelection(folder, found_by, np.arange(len(kinds))), kinds


def _platform_shares(selections: Sequence[RowSelection], now: dict[str, str]) -> Iterator[PlatformShare]:
    """Yield the platforms that rows were made on, those of most rows first."""
    counts: Counter[tuple[tuple[str, str], ...]] = Counter()
    for selection in selections:
        platform = platform_of(selection.found_by.spec.engine, selection.found_by.platform)
        counts[tuple(sorted(platform.items()))] += len(selection.numbers)
    for items, rows in counts.most_common():
        differences = platform_differences(dict(items), now)
        yield PlatformShare(rows=rows, platform=dict(items), differences=differences)


class EngineComparison(Struct, frozen=True, kw_only=True):
    """Verdicts of another engine on recorded successes."""

    engine: str
    rows: int
    """Rows that the other engine has judged."""
    failed: int
    """Rows besides on which it failed."""
    same_verdict: int
    """Rows that both engines call robust, or neither."""
    outcomes: dict[str, dict[str, int]]
    """Rows by their recorded outcome, and by that in the other engine."""
    file: str
    """The table of all rows that were judged."""

    @property
    def table(self) -> str:
        """Lines for a person."""
        lines = [
            f"recorded {name}: {', '.join(f'{number} {now}' for now, number in found.items())}"
            for name, found in self.outcomes.items()
        ]
        if self.failed:
            lines.append(f"{self.engine} failed on {self.failed} more, which are not in the table")
        share = f"{self.same_verdict} of {counted(self.rows, 'success', 'successes')}"
        verdicts = f"{share} have the same verdict in {self.engine}, robust or not"
        return "\n".join([verdicts, *lines, self.file])


OF_TRIALS = ("base", "trials")  # Keys of a spec that a comparison has no use for


def compare_engine(
    folder: RunFolder,
    engine: str,
    most: int | None,
    seed: int,
    config: LocalJobConfig,
    display: ProgressDisplay,
    stop: Stop,
) -> EngineComparison | None:
    """Simulate successes of a run in another engine, and write the table in its folder.

    Their commanded poses are what is simulated: `most` of them, None all. None where it was stopped. Raises
    InputError for a run of `released` or without successes, and for two engines.
    """
    if len(engine_names(engine)) > 1:
        raise InputError(f"verify compares with one engine, and '{engine}' names two; name one of them.")
    values = to_values(folder.spec) | {"engine": engine, "protocol": folder.spec.nominal_protocol}
    spec = run_spec({key: value for key, value in values.items() if key not in OF_TRIALS}, "verify")
    check_engines([spec])
    found = folder.successes()
    if not len(found):
        raise InputError(f"{folder.path} has no success that could be simulated in {engine}.")
    check_table(folder, engine)
    random = np.random.default_rng(seed)
    found = found[balanced_sample(found.rows["outcome"], most or len(found), random)]
    scene = structs.replace(folder.scene(), engine=spec.engine, protocol=spec.protocol, base=spec.base)
    if scene.engine:
        check_convex(scene.gripper)
    genomes = as_given(scene, prior_of(folder.spec), found.rows)
    prepared = PreparedScene(scene, pack_scene(scene))
    rows = score_genomes(spec, prepared, genomes, config, display, stop)
    if stop.is_set:
        return None
    judged = rows["outcome"] != Outcome.ERROR
    if not judged.any():
        raise InputError(f"{engine} failed on every success of {folder.path}; `qdgrasp run` in it tells why.")
    recorded, now = found.rows[judged], rows[judged]
    table = write_table(folder, engine, found.numbers[judged], recorded, now)
    outcomes: dict[str, dict[str, int]] = {}
    pairs = Counter(zip(recorded["outcome"].tolist(), now["outcome"].tolist(), strict=True))
    for (before, after), number in sorted(pairs.items(), reverse=True):
        outcomes.setdefault(Outcome(before).name.lower(), {})[Outcome(after).name.lower()] = number
    same = int(((recorded["outcome"] >= Outcome.HELD) == (now["outcome"] >= Outcome.HELD)).sum())
    failed = int((~judged).sum())
    return EngineComparison(
        engine=engine, rows=len(now), failed=failed, same_verdict=same, outcomes=outcomes, file=str(table)
    )
