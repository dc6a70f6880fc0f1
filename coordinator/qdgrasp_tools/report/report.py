"""Writes the figures and tables of a campaign into a folder."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from qdgrasp_coordinator.metrics.reference_coverage import ReferenceLookup
from qdgrasp_coordinator.storage.outputs import OutFolder
from qdgrasp_coordinator.storage.tables import Row, Value, csv_text
from qdgrasp_protocol.errors import FolderError
from qdgrasp_protocol.text import aligned_text
from qdgrasp_tools.report.figures import (
    COMPARED_METHODS,
    draw_curves,
    draw_nu,
    draw_voxels,
    drawn_methods,
    family_of,
    nu_distributions,
    run_voxels,
    write_figure,
)
from qdgrasp_tools.report.run_groups import (
    CurvePanel,
    RunGroup,
    RunHistory,
    SceneName,
    find_runs,
    group_runs,
    hand_panels,
    mean_interval,
    read_histories,
    scene_panels,
)

REPORT_FOLDER = "analysis"
RUNS_FILE, CURVES_FILE = "runs.csv", "curves.csv"
FIGURES = ("figure1-comparison", "figure2-variants", "figure3-nu", "figure4-cells")
"""Names of the paper's figures of results."""
SUFFIXES = (".png", ".svg")


@dataclass(frozen=True)
class CampaignReport:
    """The groups and figures of a written report."""

    out: Path
    groups: list[RunGroup]
    panels: list[CurvePanel]
    left_out: list[str]
    """Figures that have nothing to show."""
    repeats: list[str]
    """Runs that were left out: another run of the same search is as long, or longer."""

    @property
    def runs(self) -> list[RunHistory]:
        """All runs."""
        return [run for group in self.groups for run in group.runs]

    @property
    def unfinished(self) -> int:
        """Number of runs that have not spent their budget."""
        return sum(not run.complete for run in self.runs)

    @property
    def table(self) -> str:
        """Results of each method on each scene after as many evaluations, with intervals."""
        head = ("scene", "method", "runs", "evaluations", "measure", "mean", "95% interval")
        return aligned_text([head, *(line for one in self.panels for line in _lines(one))], range(2))


def _lines(panel: CurvePanel) -> Iterable[tuple[str, ...]]:
    number = "{:.2%}".format if panel.is_share else "{:,.1f}".format
    for curve in (one for one in panel.curves if one.samples):
        end = panel.common_end
        reached = [float(panel.values(sample, end)) for sample in curve.samples]
        interval = mean_interval(reached)
        between = "few runs" if interval is None else " to ".join(map(number, interval))
        words = panel.scene.words, " ".join(curve.arm).rstrip(), str(len(reached)), f"{end:,}"
        yield *words, "coverage" if panel.is_share else "cells", number(np.mean(reached)), between


def write_report(path: Path, out: Path, references: Sequence[Path] = ()) -> CampaignReport:
    """Draw and tabulate a campaign, a folder of runs or one run, also while it goes on.

    `out` is a new folder, an empty one, or that of an earlier analysis; `references` are sets that take
    precedence over the published ones on the asset path. Raises FolderError if there is no run, none has
    recorded an evaluation, one cannot be read, or `out` cannot be written.
    """
    folder = OutFolder(out, force=True, is_kind=is_ours)
    folder.check()
    runs, copies = read_histories(find_runs(path), ReferenceLookup(references))
    groups = group_runs(runs)
    begun = [group for group in groups if any(run.evaluations for run in group.runs)]
    if not begun:
        raise FolderError(f"No run in {path} has recorded an evaluation yet; there is nothing to draw.")
    scenes, hands = scene_panels(begun), hand_panels(begun)
    pooled = [panel for panel in hands if panel.scene not in {one.scene for one in scenes}]
    figures = _figures(begun)
    with folder.writing() as made:
        made.mkdir()
        for name, figure in figures.items():
            write_figure(figure, made / name)
        rows = [_columns(each.scene, each.arm) | _run_columns(run) for each in groups for run in each.runs]
        (made / RUNS_FILE).write_text(csv_text(rows), encoding="utf-8")
        (made / CURVES_FILE).write_text(csv_text(curve_rows([*scenes, *pooled])), encoding="utf-8")
    left_out = [name for name in FIGURES if name not in figures]
    return CampaignReport(out, groups, scenes, left_out, [run.path.absolute().name for run in copies])


def _figures(begun: Sequence[RunGroup]) -> dict[str, Figure]:
    """Draw each figure of the paper that has something to show."""
    searched = {group.scene for group in begun if family_of(group.method) != "rand"}
    compared = hand_panels([group for group in begun if group.method in COMPARED_METHODS])
    variants = hand_panels([group for group in begun if group.scene in searched])
    distributions = nu_distributions(begun)
    drawn = drawn_methods(begun)
    voxels = run_voxels(begun, drawn)
    found = (
        compared and draw_curves(compared, "Searches and standard sampling schemes"),
        variants and draw_curves(variants, "Searches with and without priors"),
        distributions and draw_nu(distributions),
        voxels and draw_voxels(voxels, drawn),
    )
    return {name: one for name, one in zip(FIGURES, found, strict=True) if isinstance(one, Figure)}


def is_ours(folder: Path) -> bool:
    """Return whether a folder is that of an earlier analysis, and holds nothing else."""
    ours = {RUNS_FILE, CURVES_FILE, *(f"{name}{suffix}" for name in FIGURES for suffix in SUFFIXES)}
    there = {file.name for file in folder.iterdir()}
    return {RUNS_FILE, CURVES_FILE} <= there <= ours


def _columns(scene: SceneName, arm: tuple[str, str]) -> dict[str, Value]:
    return {
        "gripper": scene.gripper, "object": scene.object, "protocol": scene.protocol,
        "method": arm[0], "variant": arm[1],
    }  # fmt: skip


def _run_columns(run: RunHistory) -> dict[str, Value]:
    """Return figures of a run; shares are of S_G, robust ones of its entries of fitness 2."""
    summary, known = run.summary, run.target.reference
    size, robust = run.target.size, len(known.robust) if known else 0
    return {
        "run": run.path.name,
        "seed": run.spec.seed,
        "overlaps_mode": run.spec.overlaps,
        "finished": "yes" if run.complete else "no",
        **{name: getattr(summary, name) for name in COUNTS},
        "cells": run.cells.end,
        "robust_cells": run.robust_cells.end,
        "qd_score": summary.qd_score,
        "coverage": run.found.end / size if run.found and size else None,
        "robust_coverage": run.robust_found.end / robust if run.robust_found and robust else None,
        "nu_below_quarter_pi": summary.nu.below_quarter_pi,
        "eta": summary.eta.mean if summary.eta else None,
        "trials_per_success": summary.eta.trials if summary.eta else None,
        "cpu_seconds": summary.cpu_seconds,
        "set_size": size or None,
        "stand_in": ("yes" if run.target.stand_in else "no") if size else None,
        "why_no_set": run.target.why,
    }


COUNTS = ("evaluations", "simulated", "steps", "overlaps", "dead_ends", "successes")


def curve_rows(panels: Iterable[CurvePanel]) -> list[Row]:
    """One row for each point of each curve: quartiles over the runs that have got that far."""
    rows: list[Row] = []
    for panel in panels:
        for one in panel.curves:
            names = _columns(panel.scene, one.arm) | {"measure": "coverage" if panel.is_share else "cells"}
            columns = (one.evaluations, one.runs, one.low, one.median, one.high)
            rows += [
                names | dict(zip(("evaluations", "runs", "q1", "median", "q3"), values, strict=True))
                for values in zip(*(column.tolist() for column in columns), strict=True)
            ]
    return rows
