"""Writes the figures and tables of a campaign into a folder."""

from collections.abc import Sequence
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
    """The groups, claims and figures of a written report."""

    out: Path
    groups: list[RunGroup]
    claims: list[JudgedClaim]
    figures: dict[str, str]
    """By name, the reason why a figure was left out; empty for those that were drawn."""
    without_curves: list[str]
    """Runs that were left out: too few of their rows were kept."""

    @property
    def left_out(self) -> dict[str, str]:
        """The figures that were not drawn, with the reason."""
        return {name: why for name, why in self.figures.items() if why}

    @property
    def runs(self) -> int:
        """Number of runs."""
        return sum(len(group.runs) for group in self.groups)

    @property
    def unfinished(self) -> int:
        """Number of runs that have not spent their budget."""
        return sum(group.unfinished for group in self.groups)


def write_report(
    path: Path, out: Path, *, references: Sequence[Path] = (), method: str | None = None, log: bool = False
) -> CampaignReport:
    """Draw and tabulate a campaign, a folder of runs or one run, also while it goes on.

    `out` is a new folder, an empty one, or that of an earlier analysis; `references` are sets that take
    precedence over the published ones on the asset path; `method` is the one whose cells are drawn (None: the
    default one, or what found the most cells); `log` makes axes of curves logarithmic. Raises FolderError if
    there is no run, none has recorded an evaluation or has curves, one cannot be read, or `out` cannot be
    written, and UnknownName if no run is of this method; it names those that there are.
    """
    folder = SharedFolder(out, is_kind=is_ours, mark=PAGE_FILE)
    folder.check()
    there = search_run_folders(path)
    folders = [folder for folder in there if has_curves(folder)]
    if not folders:
        raise FolderError(f"Of every run in {path} only the successes were kept; curves need every row.")
    without_curves = [folder.path.absolute().name for folder in there if folder not in folders]
    arms = group_runs(read_histories(folders, ReferenceLookup(references)))
    begun = [group for group in arms if any(run.evaluations for run in group.runs)]
    if not begun:
        raise FolderError(f"No run in {path} has recorded an evaluation yet; there is nothing to draw.")
    methods = sorted({group.method for group in arms})
    if method is not None and method not in methods:
        raise UnknownName("method in this campaign", method, methods)
    claims = judge_claims(begun)
    page = _earlier_page(out)
    earlier = [name for name in CAPTIONS if f"({name}.png)" in page]
    with folder.filling() as made:
        figures = _draw(begun, made, method, log)
        tables = {"runs": run_rows(arms), "methods": method_rows(arms), "claims": claim_rows(claims)}
        for name, rows in tables.items():
            (made / f"{name}.csv").write_text(csv_text(rows), encoding="utf-8")
        page = markdown_page(path.absolute().name, arms, claims, figures, without_curves)
        (made / PAGE_FILE).write_text(page, encoding="utf-8")
    for name in earlier:  # figures of an earlier analysis that were left out of this one
        for suffix in SUFFIXES if figures[name] else ():
            (out / name).with_suffix(suffix).unlink(missing_ok=True)
    return CampaignReport(out, arms, claims, figures, without_curves)


def _draw(begun: Sequence[RunGroup], out: Path, method: str | None, log: bool) -> dict[str, str]:
    """Draw each figure; returns by name the reason why one is left out, or ""."""
    shown, by_hand = curve_panels(begun), curve_panels(pool_objects(begun))
    # the scenes with more than plain sampling
    searched = [
        panel
        for panel in [*by_hand, *shown]
        if any(family_of(one.group.method) != "rand" for one in panel.curves)
    ]
    distributions = nu_distributions(begun)
    drawn = method or drawn_method(begun)
    voxels = run_voxels(begun, drawn) if drawn else []
    drawings: dict[str, tuple[FigureGrid | str, list[Row]]] = {
        "coverage": (draw_curves(shown, log=log), curve_rows(shown)),
        "hands": (
            draw_curves(by_hand, log=log) if by_hand else "no hand has two objects with an S_G",
            curve_rows(by_hand),
        ),
        "priors": (
            draw_prior_matrix(searched, log=log)
            if searched
            else "no run is of a search with quality and diversity",
            curve_rows(searched),
        ),
        "nu": (
            draw_nu(distributions) if distributions else "no success looks at a surface point",
            nu_rows(begun),
        ),
        "voxels": (
            draw_voxels(voxels, drawn) if voxels and drawn else "nothing was found",
            [row for one in voxels for row in voxel_rows(one)],
        ),
    }
    for name, (grid, rows) in drawings.items():
        if not isinstance(grid, str):
            grid.write(out / name)
            (out / f"{name}.csv").write_text(csv_text(rows), encoding="utf-8")
    return {name: grid if isinstance(grid, str) else "" for name, (grid, _) in drawings.items()}


def is_ours(folder: Path) -> bool:
    """Return whether a folder is that of an earlier analysis."""
    return f"\n{CLAIMS_HEADING}\n" in _earlier_page(folder)


def _earlier_page(folder: Path) -> str:
    page = folder / PAGE_FILE
    return page.read_text(encoding="utf-8", errors="replace") if atomic_files.is_file(page) else ""
