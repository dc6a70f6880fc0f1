"""Writes the figures and tables of a campaign into a folder."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from qdgrasp_coordinator.metrics.reference_coverage import ReferenceLookup
from qdgrasp_coordinator.report.claims import JudgedClaim, judge_claims
from qdgrasp_coordinator.report.figure_grid import FigureGrid, family_of
from qdgrasp_coordinator.report.figures import (
    draw_curves,
    draw_nu,
    draw_prior_matrix,
    draw_voxels,
    drawn_method,
    nu_distributions,
    run_voxels,
)
from qdgrasp_coordinator.report.run_groups import (
    CurvePanel,
    RunGroup,
    curve_panels,
    group_runs,
    pool_objects,
    read_histories,
    search_run_folders,
)
from qdgrasp_coordinator.report.run_history import has_curves
from qdgrasp_coordinator.report.tables import (
    CAPTIONS,
    CLAIMS_HEADING,
    Row,
    claim_rows,
    csv_text,
    curve_rows,
    markdown_page,
    method_rows,
    nu_rows,
    run_rows,
    voxel_rows,
)
from qdgrasp_coordinator.storage import atomic_files
from qdgrasp_coordinator.storage.outputs import SharedFolder
from qdgrasp_protocol.errors import FolderError, UnknownName

REPORT_FOLDER = "analysis"
PAGE_FILE = "tables.md"
SUFFIXES = (".png", ".svg", ".csv")


@dataclass(frozen=True)
class CampaignReport:
    """What was found and written."""

    out: Path
    entries: list[RunGroup]
    claims: list[JudgedClaim]
    figures: dict[str, str]
    """By name, why a figure was left out; empty for those that were drawn."""
    without_curves: list[str]
    """The names of runs that were left out: of their rows those that are kept do not suffice."""

    @property
    def left_out(self) -> dict[str, str]:
        """The figures that were not drawn, and why."""
        return {name: why for name, why in self.figures.items() if why}

    @property
    def runs(self) -> int:
        """How many runs there are."""
        return sum(len(entry.runs) for entry in self.entries)

    @property
    def unfinished(self) -> int:
        """How many of them have not spent their budget."""
        return sum(entry.unfinished for entry in self.entries)


def write_report(
    path: Path, out: Path, *, references: Sequence[Path] = (), method: str | None = None, log: bool = False
) -> CampaignReport:
    """Draw and tabulate a campaign, also while it goes on.

    Parameters
    ----------
    path
        A campaign's folder, a folder of run folders, or one run's folder.
    out
        The folder that is written to: a new one, an empty one, or that of an earlier analysis.
    references
        Reference sets that are looked at before the published ones on the asset path.
    method
        The method whose cells are drawn; None: the default one, or what found the most cells.
    log
        Whether curves are on logarithmic axes.

    Raises
    ------
    FolderError
        There is no run, none has recorded an evaluation or has curves, one cannot be read, or `out` cannot
        be written.
    UnknownName
        No run is of this method; those that there are are named.
    """
    folder = SharedFolder(out, is_kind=is_ours)
    folder.check()
    there = search_run_folders(path)
    folders = [folder for folder in there if has_curves(folder)]
    if not folders:
        raise FolderError(f"Of every run in {path} only the successes were kept; curves need every row.")
    without_curves = [folder.path.absolute().name for folder in there if folder not in folders]
    arms = group_runs(read_histories(folders, ReferenceLookup(references)))
    begun = [entry for entry in arms if any(run.evaluations for run in entry.runs)]
    if not begun:
        raise FolderError(f"No run in {path} has recorded an evaluation yet; there is nothing to draw.")
    methods = sorted({entry.method for entry in arms})
    if method is not None and method not in methods:
        raise UnknownName("method in this campaign", method, methods)
    claims = judge_claims(begun)
    earlier = _drawn_figures(out)
    with folder.filling() as made:
        figures = _draw(begun, made, method, log)
        tables = {"runs": run_rows(arms), "methods": method_rows(arms), "claims": claim_rows(claims)}
        for name, rows in tables.items():
            _write(made / f"{name}.csv", csv_text(rows))
        _write(made / PAGE_FILE, markdown_page(path.absolute().name, arms, claims, figures, without_curves))
    _remove_old(out, earlier, figures)
    return CampaignReport(out, arms, claims, figures, without_curves)


def _draw(begun: Sequence[RunGroup], out: Path, method: str | None, log: bool) -> dict[str, str]:
    """Draw each figure, or say why there is none."""
    shown, by_hand = curve_panels(begun), curve_panels(pool_objects(begun))
    curves = [one for panel in shown for one in panel.curves]
    matrix = _with_search([*by_hand, *shown])
    leaning = nu_distributions(begun)
    drawn = method or drawn_method(begun)
    seen = run_voxels(begun, drawn) if drawn else []
    return {
        "coverage": _write_figure(out / "coverage", draw_curves(shown, log=log), curve_rows(curves)),
        "hands": _write_figure(
            out / "hands",
            draw_curves(by_hand, log=log) if by_hand else "no hand has two objects with an S_G",
            curve_rows([one for panel in by_hand for one in panel.curves]),
        ),
        "priors": _write_figure(
            out / "priors",
            draw_prior_matrix(matrix, log=log)
            if matrix
            else "no run is of a search with quality and diversity",
            curve_rows([one for panel in matrix for one in panel.curves]),
        ),
        "nu": _write_figure(
            out / "nu", draw_nu(leaning) if leaning else "no success looks at a surface point", nu_rows(begun)
        ),
        "voxels": _write_figure(
            out / "voxels",
            draw_voxels(seen, drawn) if seen and drawn else "nothing was found",
            [row for one in seen for row in voxel_rows(one)],
        ),
    }


def _with_search(shown: Sequence[CurvePanel]) -> list[CurvePanel]:
    """The scenes with more than plain sampling."""
    return [panel for panel in shown if any(family_of(one.entry.method) != "rand" for one in panel.curves)]


def _write_figure(stem: Path, sheet: FigureGrid | str, rows: Sequence[Row]) -> str:
    """Write a figure and its data; or return why there is none."""
    if isinstance(sheet, str):
        return sheet
    sheet.write(stem)
    _write(stem.with_suffix(".csv"), csv_text(rows))
    return ""


def _write(file: Path, text: str) -> None:
    file.write_text(text, encoding="utf-8")


def is_ours(folder: Path) -> bool:
    """Whether a folder is that of an earlier analysis."""
    return f"\n{CLAIMS_HEADING}\n" in _earlier_page(folder)


def _drawn_figures(out: Path) -> list[str]:
    """The figures that an earlier analysis put into its folder."""
    return [name for name in CAPTIONS if f"({name}.png)" in _earlier_page(out)]


def _earlier_page(folder: Path) -> str:
    """The page of an earlier analysis; empty where there is none."""
    page = folder / PAGE_FILE
    return page.read_text(encoding="utf-8", errors="replace") if atomic_files.is_file(page) else ""


def _remove_old(out: Path, earlier: Iterable[str], figures: Mapping[str, str]) -> None:
    """Remove the figures of an earlier analysis that were left out of this one."""
    for name in earlier:
        for suffix in SUFFIXES if figures[name] else ():
            (out / name).with_suffix(suffix).unlink(missing_ok=True)
