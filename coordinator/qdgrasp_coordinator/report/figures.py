"""Draws the figures of a campaign: curves of methods, distributions of nu, success voxels."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from qdgrasp_assets.scene import Scene
from qdgrasp_coordinator.metrics.cells import cells
from qdgrasp_coordinator.metrics.scores import ROBUST, scored_successes, survival
from qdgrasp_coordinator.metrics.success_metrics import FITNESS_COLOURS, FITNESS_WORDS
from qdgrasp_coordinator.metrics.trial_schedule import TrialPlan
from qdgrasp_coordinator.rendering.drawings import axes_triad, show_view
from qdgrasp_coordinator.rendering.ray_renderer import Floats
from qdgrasp_coordinator.rendering.views import best_azimuth, best_in_cells, hues_of_survival, view_of_cells
from qdgrasp_coordinator.report.bootstrap import LEAST_RUNS, ConfidenceInterval
from qdgrasp_coordinator.report.claims import near_nu_interval
from qdgrasp_coordinator.report.figure_grid import (
    CONTEXT,
    FAINT,
    FAMILIES,
    INK,
    PRIOR_HUES,
    PRIOR_ORDER,
    PRIOR_WORDS,
    Dashes,
    FigureGrid,
    LineStyle,
    MethodVariant,
    default_prior,
    evaluation_axis,
    family_of,
    hue_of,
    line_styles,
    panel_heading,
    plain_axes,
    value_axis,
    words_above,
)
from qdgrasp_coordinator.report.run_groups import (
    COVERAGE,
    CurvePanel,
    QuartileCurve,
    RunGroup,
    SceneName,
    default_groups,
    measure_words,
    number_span,
    run_words,
)
from qdgrasp_coordinator.report.run_history import NU_BINS, RunHistory
from qdgrasp_coordinator.search.registry import METHODS
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.rows import Rows
from qdgrasp_protocol.text import counted

BAND_OPACITY = 0.13  # Opacity of an interquartile range
CURVE_COLUMNS = 4  # Panels side by side that follow one another
LEAST_FILLED = 0.6  # The share of hands and objects that must have a panel for these to be rows and columns
PANEL_SIZES = {1: (5.6, 3.3), 2: (4.2, 2.7)}  # Size of a panel by how many stand side by side [inches]
CURVE_PANEL_SIZE = (3.1, 2.1)
LABEL_WIDTH = 1.85  # Width of a label of the legend [inches]
CURVE_CAPTION = "Median over seeds; shaded: quartiles. Circle: an unfinished run ends; thin: of fewer seeds."


def draw_curves(shown: Sequence[CurvePanel], *, log: bool = False) -> FigureGrid:
    """Draw every method on every scene: a row for each hand, or one scene after the other."""
    places = _panel_places([panel.scene for panel in shown])
    rows, columns = (1 + max(place[axis] for place in places) for axis in (0, 1))
    drawn = _panel_styles(shown)
    handles, across = _method_legend(drawn)
    size = PANEL_SIZES.get(columns, CURVE_PANEL_SIZE)
    grid = FigureGrid(
        rows, columns, size, legend_rows=len(handles) // across, least_width=0.4 + LABEL_WIDTH * across
    )
    for panel, (row, column) in zip(shown, places, strict=True):
        axes = grid.axes(row, column)
        _set_axes(axes, panel, log)
        runs = run_words([one.group for one in panel.curves], size[0])
        panel_heading(axes, panel.scene.words, measure_words(panel), runs)
        for one in panel.curves:
            draw_curve(axes, one, drawn[one.group.variant_key])
    grid.title(_curves_title(shown), CURVE_CAPTION)
    grid.legend(handles, across)
    return grid


def draw_prior_matrix(shown: Sequence[CurvePanel], *, log: bool = False) -> FigureGrid:
    """Draw a row for each scene, a column for each prior; in it the searches with that prior."""
    drawn = _panel_styles(shown)
    present = {default_prior(one.group.method) for panel in shown for one in panel.curves}
    priors = [prior for prior in PRIOR_ORDER if prior in present]
    families = {family_of(one.group.method) for panel in shown for one in panel.curves}
    grid = FigureGrid(len(shown), len(priors), (2.5, 1.9), legend_rows=1, space_above=0.84, least_width=8.8)
    for row, panel in enumerate(shown):
        for column, prior in enumerate(priors):
            axes = grid.axes(row, column)
            _set_axes(axes, panel, log)
            for one in panel.curves:
                if default_prior(one.group.method) == prior:
                    draw_curve(axes, one, drawn[one.group.variant_key])
                else:
                    axes.plot(one.evaluations, one.median, color=CONTEXT, linewidth=0.8, zorder=1)
            mine = [one.group for one in panel.curves if default_prior(one.group.method) == prior]
            words = (panel.scene.words, measure_words(panel)) if column == 0 else ("", "")
            panel_heading(axes, words[0], words[1], run_words(mine, 2.5) if mine else "not in this campaign")
            if row == 0:
                heading, hue = PRIOR_WORDS.get(prior, prior), PRIOR_HUES[prior]
                words_above(axes, heading, 44, size=10.5, weight="bold", color=hue)
    grid.title("Searches with each prior", f"{CURVE_CAPTION} Grey: the other priors.")
    lines = [_legend_line(family, INK, dashes) for family, dashes in FAMILIES.items() if family in families]
    grid.legend(lines, len(lines))
    return grid


def draw_curve(axes: Axes, one: QuartileCurve, style: LineStyle) -> None:
    """Draw a curve: thick where all its runs are in it, thin beyond."""
    if not one.runs.any():
        return
    colour, dashes, common = style.colour, style.dashes, one.common_points
    for part, width in ((slice(None, common), 1.9), (slice(common - 1, None), 0.8)):
        axes.plot(one.evaluations[part], one.median[part], color=colour, linestyle=dashes, linewidth=width)
    axes.fill_between(one.evaluations, one.low, one.high, color=colour, alpha=BAND_OPACITY, linewidth=0)
    for run in one.group.runs:
        if run.evaluations and not run.complete:
            end = one.measure.values(run, run.evaluations)
            axes.plot([run.evaluations], [end], marker="o", markersize=4.5, markerfacecolor="white",
                      color=colour, clip_on=False, zorder=5)  # fmt: skip


def _set_axes(axes: Axes, panel: CurvePanel, log: bool) -> None:
    plain_axes(axes)
    evaluation_axis(axes, panel.end, log=log)
    value_axis(axes, panel.greatest_value, share=panel.measure is COVERAGE, log=log)


def _curves_title(shown: Sequence[CurvePanel]) -> str:
    covered = [panel.measure is COVERAGE for panel in shown]
    mixed = "Coverage of S_G, or success cells," if any(covered) else "Success cells"
    return f"{'Coverage of S_G' if all(covered) else mixed} over evaluations"


def _panel_places(scenes: Sequence[SceneName]) -> list[tuple[int, int]]:
    """Place the scenes by hand and object, or in turn if that leaves many panels empty."""
    hands = list(dict.fromkeys((scene.gripper, scene.protocol) for scene in scenes))
    objects = sorted({scene.object for scene in scenes})
    if len(hands) == 1 or len(objects) == 1 or len(scenes) < LEAST_FILLED * len(hands) * len(objects):
        return [divmod(number, CURVE_COLUMNS) for number in range(len(scenes))]
    return [(hands.index((scene.gripper, scene.protocol)), objects.index(scene.object)) for scene in scenes]


def _panel_styles(shown: Sequence[CurvePanel]) -> dict[MethodVariant, LineStyle]:
    return line_styles(one.group.variant_key for panel in shown for one in panel.curves)


def _method_legend(drawn: Mapping[MethodVariant, LineStyle]) -> tuple[list[Line2D], int]:
    """Arrange methods as a matrix: a column for each prior, in it the families in their order."""
    columns = [
        [arm for f in FAMILIES for arm in drawn if (default_prior(arm[0]), family_of(arm[0])) == (prior, f)]
        for prior in PRIOR_ORDER
    ]
    filled = [column for column in columns if column]
    rows = max(map(len, filled))
    empty = _legend_line("", "none", "-")
    handles = [
        _legend_line(" ".join(column[row]).rstrip(), *drawn[column[row]]) if row < len(column) else empty
        for column in filled
        for row in range(rows)
    ]
    return handles, len(filled)


def _legend_line(label: str, colour: str, dashes: Dashes) -> Line2D:
    return Line2D([], [], color=colour, linestyle=dashes, linewidth=1.9, label=label)


NU_TICKS = (("0", 0.0), ("\u03c0/4", 0.25), ("\u03c0/2", 0.5), ("3\u03c0/4", 0.75), ("\u03c0", 1.0))
NU_PANEL_SIZE = (3.3, 1.3)
NU_PRIORS = ("contact", "approach")
"""Priors whose palm looks at the surface; antipodal hands lie along their points' line."""
NU_BOUNDS = {"approach": "at most \u03c0/4 by its prior"}  # Priors that leave nu no choice


@dataclass(frozen=True)
class NuDistribution:
    """The distribution of nu of a method's successes."""

    method: str
    variant: str
    share: NDArray[np.float64]
    """(24,): mean over scenes of the mean over runs of the share of successes in each bin."""
    near: ConfidenceInterval
    """The share below pi / 4."""
    scenes: int
    runs: int
    """With a success that has a nu."""
    evaluations: tuple[int, int]
    """Of the shortest and of the longest of these runs."""


def nu_distributions(groups: Sequence[RunGroup]) -> list[NuDistribution]:
    """Distributions of all methods whose palm looks at the surface, over scenes with a success."""
    methods: dict[str, list[RunGroup]] = {}
    for group in groups:
        if default_prior(group.method) in NU_PRIORS and any(run.nu.any() for run in group.finished_runs):
            methods.setdefault(group.name, []).append(group)
    return [_nu_distribution(same) for same in methods.values()]


def _nu_distribution(groups: Sequence[RunGroup]) -> NuDistribution:
    scenes = [[run for run in group.finished_runs if run.nu.any()] for group in groups]
    share = np.mean([np.mean([run.nu / run.nu.sum() for run in runs], axis=0) for runs in scenes], axis=0)
    ends = [run.evaluations for runs in scenes for run in runs]
    near = near_nu_interval(groups)
    return NuDistribution(*groups[0].variant_key, share, near, len(scenes), len(ends), (min(ends), max(ends)))


def draw_nu(found: Sequence[NuDistribution]) -> FigureGrid:
    """Draw a column for each prior, a row for each family of searches and each variant."""
    priors = [prior for prior in NU_PRIORS if any(default_prior(lean.method) == prior for lean in found)]
    rows = sorted({_matrix_row(one) for one in found}, key=lambda row: (list(FAMILIES).index(row[0]), row[1]))
    grid = FigureGrid(len(rows), len(priors), NU_PANEL_SIZE, space_above=0.7)
    for lean in found:
        row = _matrix_row(lean)
        top = max(float(one.share.max()) for one in found if _matrix_row(one) == row)
        _draw_distribution(grid.axes(rows.index(row), priors.index(default_prior(lean.method))), lean, top)
    words = "Share of successes in bins of 7.5\u00b0; each scene and each run counts alike."
    grid.title("Lean \u03bd of successes from the surface normal", words)
    return grid


def _matrix_row(lean: NuDistribution) -> tuple[str, str]:
    return family_of(lean.method), lean.variant


def _draw_distribution(axes: Axes, lean: NuDistribution, top: float) -> None:
    plain_axes(axes)
    edges, hue = np.linspace(0, 1, NU_BINS + 1), hue_of(lean.method)
    for low, high, opacity in ((0, NU_BINS // 4, 0.9), (NU_BINS // 4, NU_BINS, 0.4)):
        axes.stairs(lean.share[low:high], edges[low : high + 1], fill=True, color=hue, alpha=opacity)
    axes.axvline(0.25, color=INK, linewidth=0.9, linestyle=(0, (4, 2)))
    if default_prior(lean.method) not in NU_BOUNDS:
        axes.axhline(1 / NU_BINS, color=FAINT, linewidth=0.8, linestyle=(0, (1.5, 1.5)))
        axes.annotate(
            "uniform", (1, 1 / NU_BINS), (0, 3), textcoords="offset points", size=7, color=FAINT, ha="right"
        )
    axes.set(xlim=(0, 1), ylim=(0, 1.08 * top))
    axes.set_xticks([place for _, place in NU_TICKS], [word for word, _ in NU_TICKS])
    axes.yaxis.set_major_formatter(lambda y, _: f"{100 * y:g}\u202f%")
    axes.yaxis.set_major_locator(MaxNLocator(3))
    panel_heading(axes, lean.method, near_words(lean), sample_words(lean), color=hue)


def near_words(lean: NuDistribution) -> str:
    """Describe the share below pi / 4 with its interval."""
    if bound := NU_BOUNDS.get(default_prior(lean.method)):
        return bound
    found = lean.near
    missing = f" (no interval: fewer than {LEAST_RUNS} runs)"
    span = f" ({found.low:.0%} to {found.high:.0%})" if found.is_known else missing
    return f"{found.value:.0%} below \u03c0/4{span}"


def sample_words(lean: NuDistribution) -> str:
    """Describe the sample behind a distribution."""
    ends, scenes = number_span(lean.evaluations), counted(lean.scenes, "scene")
    variant = f"{lean.variant}: " if lean.variant else ""
    return f"{variant}{counted(lean.runs, 'run')} \u00d7 {ends} evaluations, {scenes}"


DEFAULT_DRAWN_METHOD = next(iter(METHODS))  # Drawn where it is in a campaign and no other is asked for
VOXEL_COLUMNS, VOXEL_PANEL_INCHES, VOXEL_PIXELS = 4, 3.1, 460
LEGEND_ETAS = (0.0, 0.25, 0.5, 0.75, 1.0)  # Named in the legend of robust runs


@dataclass(frozen=True)
class RunVoxels:
    """The cells of one run with a success, and the most robust success in each."""

    name: SceneName
    run: RunHistory
    scene: Scene
    best: Rows
    """(n,): the fittest success of each cell, of equals the first; `fitness` sums its trials."""
    eta: NDArray[np.float64] | None
    """(n,): share of disturbances survived in all trials; None where the protocol has none."""

    @property
    def worth(self) -> NDArray[np.float64]:
        """(n,): eta, or the fitness of a run without trials."""
        return self.best["fitness"].astype(np.float64) if self.eta is None else self.eta

    @property
    def places(self) -> NDArray[np.int64]:
        """(n, 3) [cm]: the cells, CoM frame."""
        return cells(self.best["descriptor"][:, :3])


def drawn_method(groups: Sequence[RunGroup]) -> str | None:
    """Choose the default method if it found anything, else the one with most cells, or None."""
    found: dict[str, int] = {}
    for group in groups:
        found[group.method] = found.get(group.method, 0) + sum(run.cells.end for run in group.runs)
    best = max(found, key=lambda method: found[method], default="")
    return DEFAULT_DRAWN_METHOD if found.get(DEFAULT_DRAWN_METHOD) else best if found.get(best) else None


def run_voxels(groups: Sequence[RunGroup], method: str) -> list[RunVoxels]:
    """On each scene, the cells of the run with the median number of them; needs its scene."""
    chosen = default_groups(group for group in groups if group.method == method and group.finished_runs)
    scenes = [scene for scene in dict.fromkeys(group.scene for group in groups) if scene in chosen]
    runs = [(scene, median_run(chosen[scene][method])) for scene in scenes]
    return [_voxels_of_run(scene, run) for scene, run in runs if RunFolder(run.path).has_bundle()]


def median_run(group: RunGroup) -> RunHistory:
    """Return the run with the median number of cells; of an even number, the one below."""
    ordered = sorted(group.finished_runs, key=lambda run: run.cells.end)
    return ordered[(len(ordered) - 1) // 2]


def _voxels_of_run(name: SceneName, run: RunHistory) -> RunVoxels:
    folder, plan = RunFolder(run.path), TrialPlan.of(run.spec)
    with folder.journal() as journal:
        found = np.concatenate([journal.shape.empty(0), *scored_successes(journal.kept(), plan)])
    best = best_in_cells(found)
    etas = plan.eta(best["fitness"]) if plan.stages else None
    return RunVoxels(name, run, folder.scene(), best, etas)


def draw_voxels(shown: Sequence[RunVoxels], method: str) -> FigureGrid:
    """Draw one view for each scene."""
    columns = min(VOXEL_COLUMNS, len(shown))
    handles = _voxel_legend(shown)
    grid = FigureGrid(
        -(-len(shown) // columns),
        columns,
        (VOXEL_PANEL_INCHES, VOXEL_PANEL_INCHES),
        legend_rows=1,
        space_below=0.1,
        space_beside=0.3,
        left=0.3,
        least_width=0.4 + 1.75 * len(handles),
    )
    for number, one in enumerate(shown):
        axes = grid.axes(*divmod(number, columns))
        hues = hues_of_survival(survival(one.best)) if one.eta is None else _hues_of_eta(one.eta)
        view = view_of_cells(one.scene, one.best, best_azimuth(one.scene, one.best), VOXEL_PIXELS, hues)
        run = f"seed {one.run.spec.seed}, {one.run.evaluations:,} evaluations"
        run += "" if one.run.complete else ", unfinished"
        show_view(axes, view, "bicubic")
        axes_triad(axes, view)
        panel_heading(axes, one.name.words, _voxel_counts(one, view.is_uncut), run)
    grid.title(
        f"Where {method} had successes",
        "Cells of 1 cm that held the hand, by the most robust success in each.",
    )
    grid.legend(handles, len(handles), length=1.0)
    return grid


def _hues_of_eta(eta: NDArray[np.float64]) -> Floats:
    return np.asarray(matplotlib.colormaps["viridis_r"](eta)[:, :3], dtype=np.float32)


def _voxel_counts(one: RunVoxels, is_uncut: bool) -> str:
    cut = "" if is_uncut else "; cut open"
    if one.eta is None:
        return f"{len(one.best):,} cells, {int((survival(one.best) == ROBUST).sum()):,} robust{cut}"
    return f"{len(one.best):,} cells, median \u03b7 {np.median(one.eta) if len(one.eta) else 0:.2f}{cut}"


def _voxel_legend(shown: Sequence[RunVoxels]) -> list[Line2D]:
    fitness = [(to_rgb(hue), words) for hue, words in zip(FITNESS_COLOURS, FITNESS_WORDS, strict=True)]
    etas = [(tuple(_hues_of_eta(np.array([eta]))[0]), f"\u03b7 = {eta:g}") for eta in LEGEND_ETAS]
    kinds = {one.eta is None for one in shown}
    return [
        Line2D([], [], linestyle="none", marker="s", markersize=8, color=hue, label=words)
        for hue, words in [*(fitness if True in kinds else []), *(etas if False in kinds else [])]
    ]
