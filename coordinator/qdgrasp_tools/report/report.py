"""Writes the figures and tables of a campaign into a folder."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

from qdgrasp_coordinator.metrics.reference_coverage import ReferenceLookup
from qdgrasp_coordinator.storage import atomic_files
from qdgrasp_coordinator.storage.outputs import SharedFolder
from qdgrasp_protocol.errors import FolderError, UnknownName
from qdgrasp_tools.report.claims import JudgedClaim, judge_claims
from qdgrasp_tools.report.figure_grid import FigureGrid, family_of
from qdgrasp_tools.report.figures import (
    COMPARED_METHODS,
    draw_comparison,
    draw_curves,
    draw_nu,
    draw_prior_matrix,
    draw_variants,
    draw_voxels,
    drawn_methods,
    nu_distributions,
    run_voxels,
)
from qdgrasp_tools.report.run_groups import (
    RunGroup,
    curve_panels,
    distinct_searches,
    group_runs,
    pool_objects,
    read_histories,
    search_run_folders,
)
from qdgrasp_tools.report.setting_sweeps import SettingSweep, draw_sweeps, setting_sweeps
from qdgrasp_tools.report.tables import (
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
    sweep_rows,
    voxel_rows,
)

REPORT_FOLDER = "analysis"
PAGE_FILE = "tables.md"
SUFFIXES = (".png", ".svg", ".csv")
FORMER_FIGURES = ("hands",)  # Drawn by earlier versions, and no more


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
    repeats: list[str]
    """Runs that were left out: another run of the same search is as long, or longer."""

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
    path: Path,
    out: Path,
    *,
    references: Sequence[Path] = (),
    methods: Sequence[str] = (),
    objects: Sequence[str] = (),
    log: bool = False,
) -> CampaignReport:
    """Draw and tabulate a campaign, a folder of runs or one run, also while it goes on.

    `out` is a new folder, an empty one, or that of an earlier analysis; `references` are sets that take
    precedence over the published ones on the asset path; `methods` are those whose cells are drawn (none: the
    compared ones, or what found the most cells), on `objects` (none: see `run_voxels`); `log` makes axes of
    curves logarithmic. Raises FolderError if there is no run, none has recorded an evaluation or has curves,
    one cannot be read, or `out` cannot be written, and UnknownName if no run is of such a method or object;
    it names those that there are.
    """
    folder = SharedFolder(out, is_kind=is_ours, mark=PAGE_FILE)
    folder.check()
    runs, copies = distinct_searches(read_histories(search_run_folders(path), ReferenceLookup(references)))
    arms, repeats = group_runs(runs), [run.path.absolute().name for run in copies]
    begun = [group for group in arms if any(run.evaluations for run in group.runs)]
    if not begun:
        raise FolderError(f"No run in {path} has recorded an evaluation yet; there is nothing to draw.")
    for kind, asked, known in (
        ("method", methods, {group.method for group in arms}),
        ("object", objects, {group.scene.object for group in arms}),
    ):
        for name in asked:
            if name not in known:
                raise UnknownName(f"{kind} in this campaign", name, sorted(known))
    claims, sweeps = judge_claims(begun), setting_sweeps(begun)
    page = _earlier_page(out)
    earlier = [name for name in (*CAPTIONS, *FORMER_FIGURES) if f"({name}.png)" in page]
    with folder.filling() as made:
        figures = _draw(begun, sweeps, made, methods, objects, log=log)
        tables = {"runs": run_rows(arms), "methods": method_rows(arms), "claims": claim_rows(claims)}
        for name, rows in tables.items():
            (made / f"{name}.csv").write_text(csv_text(rows), encoding="utf-8")
        page = markdown_page(path.absolute().name, arms, claims, figures, sweeps, ((), repeats))
        (made / PAGE_FILE).write_text(page, encoding="utf-8")
    for name in earlier:  # figures of an earlier analysis that were left out of this one
        for suffix in SUFFIXES if figures.get(name, "no more") else ():
            (out / name).with_suffix(suffix).unlink(missing_ok=True)
    return CampaignReport(out, arms, claims, figures, [], repeats)


def _draw(
    begun: Sequence[RunGroup],
    sweeps: Sequence[SettingSweep],
    out: Path,
    methods: Sequence[str],
    objects: Sequence[str],
    *,
    log: bool,
) -> dict[str, str]:
    """Draw each figure; returns by name the reason why one is left out, or ""."""
    searched = {group.scene for group in begun if family_of(group.method) != "rand"}
    with_searches = [group for group in begun if group.scene in searched]
    compared = curve_panels(pool_objects([group for group in begun if group.method in COMPARED_METHODS]))
    scenes, variants = curve_panels(begun), curve_panels(pool_objects(with_searches))
    pooled = [panel for panel in variants if panel.scene not in searched]
    by_prior = [*pooled, *(panel for panel in scenes if panel.scene in searched)]
    distributions = nu_distributions(begun)
    drawn = list(dict.fromkeys(methods)) or drawn_methods(begun)
    voxels = run_voxels(begun, drawn, objects)
    no_search = "no run is of a search with quality and diversity"
    drawings: dict[str, tuple[FigureGrid | str, list[Row]]] = {
        "comparison": (
            draw_comparison(compared, log=log) if compared else "no method of the paper's comparison is here",
            curve_rows(compared),
        ),
        "variants": (draw_variants(variants, log=log) if variants else no_search, curve_rows(variants)),
        "nu": (
            draw_nu(distributions) if distributions else "no success is of a method with the prior contact",
            nu_rows(begun),
        ),
        "voxels": (
            draw_voxels(voxels, drawn) if voxels else "nothing was found",
            [row for one in chain(*voxels) for row in voxel_rows(one)],
        ),
        "coverage": (draw_curves(scenes, log=log), curve_rows(scenes)),
        "priors": (draw_prior_matrix(by_prior, log=log) if by_prior else no_search, curve_rows(by_prior)),
        "settings": (
            draw_sweeps(sweeps) if sweeps else "no numeric setting differs within a method",
            [row for one in sweeps for row in sweep_rows(one)],
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
