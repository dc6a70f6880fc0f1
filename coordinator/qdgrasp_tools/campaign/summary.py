"""Summary of a run: the figures that `info` prints, counted from its journal."""

import numpy as np
from msgspec import field, structs

from qdgrasp_coordinator.metrics.cells import niches
from qdgrasp_coordinator.metrics.job_status import RunListing
from qdgrasp_coordinator.metrics.run_stats import RunCounter
from qdgrasp_coordinator.metrics.success_metrics import (
    Diversity,
    EtaSummary,
    NuSummary,
    SuccessMetrics,
    diversity,
)
from qdgrasp_coordinator.metrics.successes import TrialPlan, find_successes
from qdgrasp_coordinator.storage.engine_table import HeldShare, held_shares
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.spec import DEFAULT_ENGINE
from qdgrasp_protocol.text import counted
from qdgrasp_tools.report.row_report import genome_reader

FIRST_FIELDS = (
    *("run", "gripper", "object", "scale", "method", "aim_for"),
    *("told_apart_by", "grasps_per_cell", "protocol", "engine", "seed", "overlaps_mode"),
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
    """Diversity that the search looked for, `position`, `orientation` or `posture`; empty: no objective."""
    grasps_per_cell: int | None = None
    """Grasps of different kinds that fill a cell, as the spec has it."""
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
    platform: dict[str, str]
    in_both: dict[str, HeldShare] = field(default_factory=dict)
    """Of grasps that hold, how many do so in another engine too, by its name, where the run has a table."""

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
        platform, _, _ = values.pop("platform"), values.pop("outcomes"), values.pop("folder")
        values["diversity"], values["nu"] = self.diversity.words, self.nu.words
        values["eta"] = None if self.eta is None else self.eta.words
        shares = values.pop("in_both")
        lines = [f"{name.replace('_', ' '):<16} {_text(value)}" for name, value in values.items()]
        lines += [f"{f'in {name} too':<16} {share.words}" for name, share in shares.items()]
        lines += [f"{'platform':<16} {name} {value[:24]}" for name, value in sorted(platform.items())]
        return "\n".join(lines)


def run_summary(folder: RunFolder) -> RunSummary:
    """Count what is in a run's folder, also while the run goes on."""
    spec = folder.spec
    with folder.journal() as journal:
        plan, found, reader = TrialPlan.of(spec), RunCounter.of(spec), genome_reader(folder)
        metrics, keys, outcomes = SuccessMetrics(plan), [np.zeros(0, np.int64)], [np.zeros(0, np.uint8)]
        for part in find_successes(found.counting(journal.blocks(), spec), plan):
            metrics.add(part)
            keys.append(niches(part.rows, reader))
            outcomes.append(part.rows["outcome"])
        totals = found.totals
        return RunSummary(
            **structs.asdict(RunListing.of(journal.run, spec, journal.scene, found)),
            scale=spec.scale or 1.0,
            aim_for=spec.aim_for or "",
            told_apart_by=spec.diversity or ("position" if spec.aim_for else ""),
            grasps_per_cell=spec.grasps_per_cell,
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
            collision_source=folder.scene().object.collision_source,
            platform=journal.platform,
            in_both=held_shares(folder),
        )


def _text(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.1f}" if value >= 10 else f"{value:.3g}"
    return "none" if value is None else str(value)
