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
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.rows import Rows
from qdgrasp_protocol.text import counted
from qdgrasp_tools.rendering.drawings import OUTLINE, axes_triad, show_view
from qdgrasp_tools.rendering.ray_renderer import Floats
from qdgrasp_tools.rendering.views import (
    RenderedView,
    best_azimuth,
    best_in_cells,
    hues_of_survival,
    view_of_cells,
)
from qdgrasp_tools.report.bootstrap import LEAST_RUNS, ConfidenceInterval
from qdgrasp_tools.report.claims import near_nu_interval
from qdgrasp_tools.report.figure_grid import (
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
from qdgrasp_tools.report.run_groups import (
    COVERAGE,
    CurvePanel,
    QuartileCurve,
    RunGroup,
    SceneName,
    default_groups,
    hand_groups,
    number_span,
    run_words,
)
from qdgrasp_tools.report.run_history import NU_BINS, RunHistory

BAND_OPACITY = 0.13  # Opacity of an interquartile range
CURVE_COLUMNS = 4  # Panels side by side that follow one another
HAND_COLUMNS = 2  # Of them where each is a hand: the paper's arrangement
LEAST_FILLED = 0.6  # The share of hands and objects that must have a panel for these to be rows and columns
PANEL_SIZES = {1: (5.6, 3.3), 2: (4.2, 2.7)}  # Size of a panel by how many stand side by side [inches]
CURVE_PANEL_SIZE = (3.1, 2.1)
LABEL_WIDTH, LETTER_WIDTH = 1.85, 0.066
"""Least width of a column of the legend, and what each letter takes beside the line's 0.75 [inches]."""
CURVE_CAPTION = "Median over seeds; shaded: quartiles. Circle: an unfinished run ends; thin: of fewer seeds."
COMPARED_METHODS = ("contact_rand", "approach_rand", "antipodal_rand", "me_scs", "contact_me_scs", "aimed")
"""The methods of the paper's first figure of results, and the default of this project."""


def draw_comparison(shown: Sequence[CurvePanel], *, log: bool = False) -> FigureGrid:
    """Draw a panel for each hand, as the paper's first figure of results (`COMPARED_METHODS`)."""
    places = [divmod(number, HAND_COLUMNS) for number in range(len(shown))]
    words = "Solid: searches for quality and diversity; dashed: standard sampling schemes."
    return _draw_panels(shown, places, "Searches and standard sampling schemes", words, log=log)


def draw_variants(shown: Sequence[CurvePanel], *, log: bool = False) -> FigureGrid:
    """Draw a panel for each hand, as the paper's second figure: each search with each prior."""
    places = [divmod(number, HAND_COLUMNS) for number in range(len(shown))]
    words = "Colours are priors, lines are searches; dashed: standard sampling schemes."
    return _draw_panels(shown, places, "Searches with and without priors", words, log=log)


def draw_curves(shown: Sequence[CurvePanel], *, log: bool = False) -> FigureGrid:
    """Draw every method on every scene: a row for each hand, or one scene after the other."""
    places = _panel_places([panel.scene for panel in shown])
    return _draw_panels(shown, places, _curves_title(shown), "", log=log)


def _draw_panels(
    shown: Sequence[CurvePanel], places: Sequence[tuple[int, int]], title: str, words: str, *, log: bool
) -> FigureGrid:
    rows, columns = (1 + max(place[axis] for place in places) for axis in (0, 1))
    drawn = _panel_styles(shown)
    handles, across = method_legend(drawn)
    size = PANEL_SIZES.get(columns, CURVE_PANEL_SIZE)
    grid = FigureGrid(
        rows,
        columns,
        size,
        caption_rows=1 + bool(words),
        legend_rows=len(handles) // across,
        least_width=max(6.4, legend_width(handles, across)),
    )
    for panel, (row, column) in zip(shown, places, strict=True):
        axes = grid.axes(row, column)
        _set_axes(axes, panel, log)
        runs = run_words([one.group for one in panel.curves], size[0])
        panel_heading(axes, panel.scene.words, panel.measure_words, runs)
        for one in panel.curves:
            draw_curve(axes, one, drawn[one.group.variant_key])
    grid.title(title, *([words] if words else []), CURVE_CAPTION)
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
            words = (panel.scene.words, panel.measure_words) if column == 0 else ("", "")
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


def method_legend(drawn: Mapping[MethodVariant, LineStyle]) -> tuple[list[Line2D], int]:
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


def legend_width(handles: Sequence[Line2D], columns: int) -> float:
    """Return the width of a legend that is filled column by column [inches]."""
    letters = np.array([len(str(handle.get_label())) for handle in handles]).reshape(columns, -1).max(axis=1)
    return 0.4 + float(np.maximum(LABEL_WIDTH, 0.75 + LETTER_WIDTH * letters).sum())


def _legend_line(label: str, colour: str, dashes: Dashes) -> Line2D:
    return Line2D([], [], color=colour, linestyle=dashes, linewidth=1.9, label=label)


NU_TICKS = (("0", 0.0), ("\u03c0/4", 0.25), ("\u03c0/2", 0.5), ("3\u03c0/4", 0.75), ("\u03c0", 1.0))
NU_PANEL_SIZE = (2.9, 1.4)
NU_PRIOR = "contact"
"""The prior that leaves nu free; `approach` bounds it, and antipodal hands lie along their points' line."""


@dataclass(frozen=True)
class NuDistribution:
    """The distribution of nu of a method's successes with one hand."""

    hand: str
    """Hand and protocol in words; the object too where it is the only one."""
    method: str
    variant: str
    share: NDArray[np.float64]
    """(24,): mean over scenes of the mean over runs of the share of successes in each bin."""
    near: ConfidenceInterval
    """The share below pi / 4."""
    scenes: int
    runs: int
    """Runs with a success that has a nu."""
    evaluations: tuple[int, int]
    """Evaluations of the shortest and of the longest of these runs."""

    @property
    def row(self) -> str:
        """The row of its panel: hand and variant."""
        return f"{self.hand}{f', {self.variant}' if self.variant else ''}"


def nu_distributions(groups: Sequence[RunGroup]) -> list[NuDistribution]:
    """Distributions of each hand's contact-based methods, over the scenes with a success."""
    found = []
    for hand, here in hand_groups(groups).items():
        name = here[0].scene.words if len({group.scene for group in here}) == 1 else hand
        methods: dict[str, list[RunGroup]] = {}
        for group in here:
            if default_prior(group.method) == NU_PRIOR and any(run.nu.any() for run in group.finished_runs):
                methods.setdefault(group.name, []).append(group)
        found += [_nu_distribution(name, same) for same in methods.values()]
    return found


def _nu_distribution(hand: str, groups: Sequence[RunGroup]) -> NuDistribution:
    scenes = [[run for run in group.finished_runs if run.nu.any()] for group in groups]
    share = np.mean([np.mean([run.nu / run.nu.sum() for run in runs], axis=0) for runs in scenes], axis=0)
    ends = [run.evaluations for runs in scenes for run in runs]
    near, span = near_nu_interval(groups), (min(ends), max(ends))
    return NuDistribution(hand, *groups[0].variant_key, share, near, len(scenes), len(ends), span)


def draw_nu(found: Sequence[NuDistribution]) -> FigureGrid:
    """Draw a row for each hand and each variant, a column for each contact-based method."""
    rows = list(dict.fromkeys(one.row for one in found))
    families = [family for family in FAMILIES if any(family_of(one.method) == family for one in found)]
    grid = FigureGrid(len(rows), len(families), NU_PANEL_SIZE, space_above=0.84)
    for number, row in enumerate(rows):
        grid.row_heading(number, row)
        here = [one for one in found if one.row == row]
        top = max(float(one.share.max()) for one in here)
        for one in here:
            _draw_distribution(grid.axes(number, families.index(family_of(one.method))), one, top)
    words = "Share of successes in bins of 7.5\u00b0; each scene and each run counts alike."
    grid.title("Lean \u03bd of successes from the surface normal", words)
    return grid


def _draw_distribution(axes: Axes, lean: NuDistribution, top: float) -> None:
    plain_axes(axes)
    edges, hue = np.linspace(0, 1, NU_BINS + 1), hue_of(lean.method)
    for low, high, opacity in ((0, NU_BINS // 4, 0.9), (NU_BINS // 4, NU_BINS, 0.4)):
        axes.stairs(lean.share[low:high], edges[low : high + 1], fill=True, color=hue, alpha=opacity)
    axes.axvline(0.25, color=INK, linewidth=0.9, linestyle=(0, (4, 2)))
    axes.axhline(1 / NU_BINS, color=FAINT, linewidth=0.8, linestyle=(0, (1.5, 1.5)))
    axes.annotate(
        "uniform", (1, 1 / NU_BINS), (0, 3), textcoords="offset points", size=7, color=FAINT, ha="right",
        path_effects=[OUTLINE],
    )  # fmt: skip
    axes.set(xlim=(0, 1), ylim=(0, 1.08 * top))
    axes.set_xticks([place for _, place in NU_TICKS], [word for word, _ in NU_TICKS])
    axes.yaxis.set_major_formatter(lambda y, _: f"{100 * y:g}\u202f%")
    axes.yaxis.set_major_locator(MaxNLocator(3))
    panel_heading(axes, lean.method, near_words(lean), sample_words(lean), color=hue)


def near_words(lean: NuDistribution) -> str:
    """Describe the share below pi / 4 with its interval."""
    found = lean.near
    missing = f" (no interval: fewer than {LEAST_RUNS} runs)"
    span = f" ({found.low:.0%} to {found.high:.0%})" if found.is_known else missing
    return f"{found.value:.0%} below \u03c0/4{span}"


def sample_words(lean: NuDistribution) -> str:
    """Describe the sample behind a distribution."""
    ends, scenes = number_span(lean.evaluations), counted(lean.scenes, "scene")
    return f"{counted(lean.runs, 'run')} \u00d7 {ends} evaluations, {scenes}"


MOST_VOXEL_ROWS = (
    8  # Rows of views with several hands and methods; of more scenes, those of one object are drawn
)
VOXEL_COLUMNS = 4  # Views of one method side by side
VOXEL_PANEL_INCHES, VOXEL_PIXELS = 2.6, 420
TRIAD_LENGTH = 0.085  # Of the object's axes, as a share of a view's height
LEGEND_ETAS = (0.0, 0.25, 0.5, 0.75, 1.0)  # Etas that are named in the legend of robust runs


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
    def method(self) -> str:
        """Its method."""
        return self.run.spec.method

    @property
    def worth(self) -> NDArray[np.float64]:
        """(n,): eta, or the fitness of a run without trials."""
        return self.best["fitness"].astype(np.float64) if self.eta is None else self.eta

    @property
    def places(self) -> NDArray[np.int64]:
        """(n, 3) [cm]: the cells, CoM frame."""
        return cells(self.best["descriptor"][:, :3])


def drawn_methods(groups: Sequence[RunGroup]) -> list[str]:
    """Choose those of the compared methods that found anything, else the one with most cells."""
    found: dict[str, int] = {}
    for group in groups:
        found[group.method] = found.get(group.method, 0) + sum(run.cells.end for run in group.runs)
    compared = [method for method in COMPARED_METHODS if found.get(method)]
    best = max(found, key=lambda method: found[method], default="")
    return compared or ([best] if found.get(best) else [])


def run_voxels(
    groups: Sequence[RunGroup], methods: Sequence[str], objects: Sequence[str] = ()
) -> list[list[RunVoxels]]:
    """For each scene, the cells of each method's run with the median number of them.

    Scenes are those of `objects`; without any all, or where several hands and methods have more than eight,
    those of the object that most hands have. Runs without a scene in their folder, and scenes without a run,
    are left out.
    """
    chosen = default_groups(group for group in groups if group.method in methods and group.finished_runs)
    scenes = [scene for scene in dict.fromkeys(group.scene for group in groups) if scene in chosen]
    has_several = len(methods) > 1 and len({scene.gripper for scene in scenes}) > 1
    if has_several and not objects and len(scenes) > MOST_VOXEL_ROWS:
        names = [scene.object for scene in scenes]
        objects = [max(names, key=names.count)]
    rows = []
    for scene in scenes:
        runs = [median_run(chosen[scene][method]) for method in methods if method in chosen[scene]]
        if not objects or scene.object in objects:
            rows.append([_voxels_of_run(scene, run) for run in runs if RunFolder(run.path).has_bundle()])
    return [row for row in rows if row]


def median_run(group: RunGroup) -> RunHistory:
    """Return the run with the median number of cells; of an even number, the one below."""
    ordered = sorted(group.finished_runs, key=lambda run: run.cells.end)
    return ordered[(len(ordered) - 1) // 2]


def _voxels_of_run(name: SceneName, run: RunHistory) -> RunVoxels:
    folder, plan = RunFolder(run.path), TrialPlan.of(run.spec)
    with folder.journal() as journal:
        found = np.concatenate([journal.shape.empty(0), *scored_successes(journal.blocks(), plan)])
    best = best_in_cells(found)
    etas = plan.eta(best["fitness"]) if plan.stages else None
    return RunVoxels(name, run, folder.scene(), best, etas)


def draw_voxels(rows: Sequence[Sequence[RunVoxels]], methods: Sequence[str]) -> FigureGrid:
    """Draw a row for each scene, a column for each method; of one method, a view for each scene.

    All views of an object have one camera.
    """
    drawn = [method for method in methods if any(one.method == method for row in rows for one in row)]
    everything = [one for row in rows for one in row]
    is_lone, handles = len(drawn) == 1, _voxel_legend(everything)
    columns = min(VOXEL_COLUMNS, len(rows)) if is_lone else len(drawn)
    grid = FigureGrid(
        -(-len(rows) // columns) if is_lone else len(rows),
        columns,
        (VOXEL_PANEL_INCHES, VOXEL_PANEL_INCHES),
        legend_rows=1,
        space_above=0.62 if is_lone else 0.84,
        space_below=0.1,
        space_beside=0.3,
        left=0.3,
        least_width=0.4 + 1.75 * len(handles),
    )
    for number, row in enumerate(rows):
        beside = [one for one in everything if one.name.object == row[0].name.object]
        largest = max(beside, key=lambda one: len(one.best))
        azimuth = best_azimuth(largest.scene, largest.best)
        if not is_lone:
            grid.row_heading(number, row[0].name.words)
        for one in row:
            place = divmod(number, columns) if is_lone else (number, drawn.index(one.method))
            axes = grid.axes(*place)
            heading = (one.name.words, INK) if is_lone else (one.method, hue_of(one.method))
            _draw_cells(axes, one, azimuth, [other.places for other in beside], *heading)
    grid.title(
        f"Where {drawn[0] if is_lone else 'each method'} had successes",
        "Cells of 1 cm that held the hand, by the most robust success in each.",
    )
    grid.legend(handles, len(handles), length=1.0)
    return grid


def _draw_cells(
    axes: Axes, one: RunVoxels, azimuth: float, beside: Sequence[NDArray[np.int64]], heading: str, hue: str
) -> None:
    hues = hues_of_survival(survival(one.best)) if one.eta is None else _hues_of_eta(one.eta)
    view = view_of_cells(one.scene, one.best, azimuth, VOXEL_PIXELS, hues, beside)
    run = f"seed {one.run.spec.seed}, {one.run.evaluations:,} evaluations"
    run += "" if one.run.complete else ", unfinished"
    show_view(axes, view, "bicubic")
    axes_triad(axes, view, length=TRIAD_LENGTH)
    panel_heading(axes, heading, _voxel_counts(one, view), run, color=hue)


def _hues_of_eta(eta: NDArray[np.float64]) -> Floats:
    return np.asarray(matplotlib.colormaps["viridis_r"](eta)[:, :3], dtype=np.float32)


def _voxel_counts(one: RunVoxels, view: RenderedView) -> str:
    found, cut = counted(len(one.best), "cell", told="{:,}".format), "" if view.is_uncut else "; cut open"
    cut += "" if view.block == 1 else f"; blocks of {view.block} cm"
    if one.eta is None:
        return f"{found}, {int((survival(one.best) == ROBUST).sum()):,} robust{cut}"
    return f"{found}, median \u03b7 {np.median(one.eta) if len(one.eta) else 0:.2f}{cut}"


def _voxel_legend(shown: Sequence[RunVoxels]) -> list[Line2D]:
    fitness = [(to_rgb(hue), words) for hue, words in zip(FITNESS_COLOURS, FITNESS_WORDS, strict=True)]
    etas = [(tuple(_hues_of_eta(np.array([eta]))[0]), f"\u03b7 = {eta:g}") for eta in LEGEND_ETAS]
    kinds = {one.eta is None for one in shown}
    return [
        Line2D([], [], linestyle="none", marker="s", markersize=8, color=hue, label=words)
        for hue, words in [*(fitness if True in kinds else []), *(etas if False in kinds else [])]
    ]
