"""Sweeps of a numeric setting: the measure of a method by its value, all else equal.

A setting that differs between runs of one method on a scene is an axis, such as the mutation's sigma that the
paper chose by a grid search (Huber et al. 2024, appendix, "Algorithms").
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from math import log

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from qdgrasp_coordinator.search import registry
from qdgrasp_tools.report.figure_grid import (
    FAINT,
    INK,
    FigureGrid,
    LineStyle,
    line_styles,
    panel_heading,
    plain_axes,
    short_number,
    value_axis,
)
from qdgrasp_tools.report.figures import CURVE_COLUMNS, PANEL_SIZES, legend_width, method_legend
from qdgrasp_tools.report.run_groups import (
    COVERAGE,
    FLIGHT_SETTINGS,
    SPEC_UNITS,
    CurveMeasure,
    RunGroup,
    SceneName,
    measure_of,
    measure_words,
    number_span,
    pool_objects,
    scene_groups,
    setting_words,
    usual_settings,
)

NOT_AN_AXIS = {"surface_seed"}
"""Numbers of a spec that are no quantities."""
LEAST_LOG_RATIO = 8.0  # Values spread over a factor of this or more stand on a logarithmic axis
APART = 0.012  # Lines of a panel stand so far beside each other, as a share of its width
BEYOND = 0.06  # Room left and right of the outermost values, as a share of their distance


@dataclass(frozen=True)
class SettingValue:
    """The measure of a method with one value of a setting."""

    value: float
    reached: NDArray[np.float64]
    """(n,): of each of its finished runs."""

    @property
    def range(self) -> tuple[float, float, float]:
        """Least, median and greatest over its runs."""
        return float(self.reached.min()), float(np.median(self.reached)), float(self.reached.max())


@dataclass(frozen=True)
class SettingSweep:
    """The measure of a method on a scene by the value of a setting."""

    setting: str
    """Its name in a spec."""
    group: RunGroup
    """One of its groups: scene, method and target are those of all."""
    variant: str
    """Other settings that differ within the method, in words."""
    measure: CurveMeasure
    evaluations: int
    """Counted evaluations of each run after which the measure is taken: the same on the scene."""
    values: tuple[SettingValue, ...]
    """Two at least, ascending."""

    @property
    def scene(self) -> SceneName:
        """Its scene, or its hand with several objects."""
        return self.group.scene

    @property
    def method_variant(self) -> tuple[str, str]:
        """Method and other settings."""
        return self.group.method, self.variant

    @property
    def best(self) -> SettingValue:
        """The value with the greatest median, of equals the least."""
        return max(self.values, key=lambda one: one.range[1])

    @property
    def default(self) -> SettingValue | None:
        """The value that the method has unless a spec says otherwise; None: it is not among them."""
        usual = {usual_settings(self.group.method)[self.setting]}
        if self.setting in FLIGHT_SETTINGS:
            usual.add(getattr(registry.method(self.group.method), self.setting))
        return next((one for one in self.values if one.value in usual), None)


def setting_sweeps(groups: Sequence[RunGroup]) -> list[SettingSweep]:
    """Make the sweeps of all settings, each by hand over its objects and then scene by scene."""
    scenes = scene_groups(groups)
    pooled = scene_groups(group for group in pool_objects(groups) if group.scene not in scenes)
    found = [sweep for here in (*pooled.values(), *scenes.values()) for sweep in _sweeps_of_scene(here)]
    order = list(dict.fromkeys(sweep.setting for sweep in found))
    return sorted(found, key=lambda sweep: order.index(sweep.setting))


def _sweeps_of_scene(groups: Sequence[RunGroup]) -> list[SettingSweep]:
    lines: dict[tuple[str, str, str], dict[float, RunGroup]] = {}
    for group in groups:
        for name, value in group.settings.items():
            is_number = isinstance(value, int | float) and not isinstance(value, bool)
            if is_number and name not in NOT_AN_AXIS and group.finished_runs:
                others = {key: other for key, other in group.settings.items() if key != name}
                lines.setdefault((name, group.method, setting_words(others)), {})[value] = group
    swept = {key: by_value for key, by_value in lines.items() if len(by_value) > 1}
    chosen = list(chain(*(by_value.values() for by_value in swept.values())))
    end = min((run.evaluations for group in chosen for run in group.finished_runs), default=0)
    measure = measure_of(chosen)
    return [
        SettingSweep(name, next(iter(by_value.values())), variant, measure, end, tuple(
            SettingValue(value, np.array([measure.values(run, end) for run in by_value[value].finished_runs]))
            for value in sorted(by_value)
        ))
        for (name, _, variant), by_value in swept.items()
    ]  # fmt: skip


def draw_sweeps(shown: Sequence[SettingSweep]) -> FigureGrid:
    """Draw a panel for each setting and scene, a line for each method; a setting begins a row."""
    panels = sweep_panels(shown)
    places = _places([setting for setting, _ in panels])
    rows, columns = (1 + max(place[axis] for place in places) for axis in (0, 1))
    drawn = line_styles(sweep.method_variant for sweep in shown)
    handles, across = method_legend(drawn)
    size = PANEL_SIZES.get(columns, PANEL_SIZES[2])
    grid = FigureGrid(
        rows,
        columns,
        size,
        legend_rows=len(handles) // across,
        least_width=max(6.4, legend_width(handles, across)),
    )
    for here, place in zip(panels.values(), places, strict=True):
        _draw_panel(grid.axes(*place), here, drawn)
    words = "Median over seeds after as many evaluations; bars: least to greatest. Dashed: the default."
    grid.title("Effect of a setting", words)
    grid.legend(handles, across)
    return grid


def sweep_panels(sweeps: Sequence[SettingSweep]) -> dict[tuple[str, SceneName], list[SettingSweep]]:
    """Sort sweeps by setting and scene."""
    panels: dict[tuple[str, SceneName], list[SettingSweep]] = {}
    for sweep in sweeps:
        panels.setdefault((sweep.setting, sweep.scene), []).append(sweep)
    return panels


def _places(settings: Sequence[str]) -> list[tuple[int, int]]:
    """Place panels in turn; each setting begins a row."""
    places: list[tuple[int, int]] = []
    for number, setting in enumerate(settings):
        row, column = places[-1] if places else (-1, 0)
        is_new = not number or setting != settings[number - 1] or column + 1 == CURVE_COLUMNS
        places.append((row + 1, 0) if is_new else (row, column + 1))
    return places


def _draw_panel(axes: Axes, here: Sequence[SettingSweep], drawn: dict[tuple[str, str], LineStyle]) -> None:
    plain_axes(axes)
    values = sorted({one.value for sweep in here for one in sweep.values})
    is_log = values[0] > 0 and values[-1] / values[0] >= LEAST_LOG_RATIO
    place = {value: log(value) if is_log else value for value in values}
    width = place[values[-1]] - place[values[0]]
    for number, sweep in enumerate(here):
        aside = (number - (len(here) - 1) / 2) * APART * width
        least, median, greatest = np.array([one.range for one in sweep.values]).T
        colour, dashes = drawn[sweep.method_variant]
        axes.errorbar(
            [place[one.value] + aside for one in sweep.values],
            median,
            (median - least, greatest - median),
            color=colour, linestyle=dashes, linewidth=1.6, elinewidth=0.9, capsize=2, marker="o",
            markersize=3.5,
        )  # fmt: skip
    for value in sorted({sweep.default.value for sweep in here if sweep.default}):
        axes.axvline(place[value], color=INK, linewidth=0.9, linestyle=(0, (4, 2)), zorder=1)
    value_axis(axes, max(one.range[2] for sweep in here for one in sweep.values),
               share=here[0].measure is COVERAGE, log=False)  # fmt: skip
    axes.set_xlim(place[values[0]] - BEYOND * width, place[values[-1]] + BEYOND * width)
    axes.set_xticks([place[value] for value in values], [short_number(value) for value in values])
    setting = here[0].setting
    axes.set_xlabel(setting.replace("_", " ") + SPEC_UNITS.get(setting, ""), size=8, color=FAINT, labelpad=2)
    panel_heading(axes, here[0].scene.words, measure_words(here[0].measure, here[0].group), run_span(here))


def run_span(here: Sequence[SettingSweep]) -> str:
    """Describe seeds and evaluations behind the sweeps on a scene."""
    seeds = number_span([len(one.reached) for sweep in here for one in sweep.values])
    return f"{seeds} seed{'' if seeds == '1' else 's'} after {here[0].evaluations:,} evaluations"
