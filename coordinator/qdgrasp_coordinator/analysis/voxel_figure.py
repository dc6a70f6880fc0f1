"""The figure of voxels: the cells where a method's runs had successes, coloured by how robust they are."""

from collections.abc import Sequence
from dataclasses import dataclass

import matplotlib
import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from qdgrasp_assets.scene import Scene
from qdgrasp_coordinator.analysis.entries import Entry, SceneName, usual
from qdgrasp_coordinator.analysis.fitness import COLOURS, WORDS
from qdgrasp_coordinator.analysis.history import History
from qdgrasp_coordinator.analysis.picture import scale_bar, triad
from qdgrasp_coordinator.analysis.rays import Floats
from qdgrasp_coordinator.analysis.sheet import Sheet, heading
from qdgrasp_coordinator.analysis.views import best_in_cells, hues_of_fitness, side_of, view_of_cells
from qdgrasp_coordinator.counts.cells import cells
from qdgrasp_coordinator.counts.scores import ROBUST, eta, scored
from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_coordinator.searches.search import METHODS
from qdgrasp_protocol.rows import Rows
from qdgrasp_protocol.trials import trials

FAVOURITE = next(iter(METHODS))
"""The method that is drawn where it is in a campaign and no other is asked for: the default one."""
WRAPPED, PANEL, PIXELS = 4, 3.1, 460
ETAS = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Named in the legend of robust runs."""


@dataclass(frozen=True)
class Voxels:
    """The cells of one run with a success, and how robust the best one in each is."""

    name: SceneName
    run: History
    scene: Scene
    best: Rows
    """(n,): the fittest success of each cell, of equals the first; with trials, `fitness` is their sum."""
    eta: NDArray[np.float64] | None
    """(n,): the share of shakes it survived in all trials; None where the protocol has none."""

    @property
    def worth(self) -> NDArray[np.float64]:
        """(n,): eta, or the fitness of a run without trials."""
        return self.best["fitness"].astype(np.float64) if self.eta is None else self.eta

    @property
    def places(self) -> NDArray[np.int64]:
        """(n, 3) [cm]: the cells, CoM frame."""
        return cells(self.best["descriptor"][:, :3])


def drawn_method(entries: Sequence[Entry]) -> str | None:
    """The favourite where it found anything, else what found the most cells; None: nothing did."""
    found: dict[str, int] = {}
    for entry in entries:
        found[entry.method] = found.get(entry.method, 0) + sum(run.cells.end for run in entry.runs)
    best = max(found, key=lambda method: found[method], default="")
    return FAVOURITE if found.get(FAVOURITE) else best if found.get(best) else None


def voxels(entries: Sequence[Entry], method: str) -> list[Voxels]:
    """On each scene the cells of the method's run with the median number of them; needs the run's scene."""
    chosen = usual(entry for entry in entries if entry.method == method and entry.settled)
    scenes = [scene for scene in dict.fromkeys(entry.scene for entry in entries) if scene in chosen]
    runs = [(scene, median_run(chosen[scene][method])) for scene in scenes]
    return [_voxels(scene, run) for scene, run in runs if RunFolder(run.path).has_bundle()]


def median_run(entry: Entry) -> History:
    """The run with the median number of success cells; of an even number, the one below."""
    ordered = sorted(entry.settled, key=lambda run: run.cells.end)
    return ordered[(len(ordered) - 1) // 2]


def _voxels(name: SceneName, run: History) -> Voxels:
    folder, per_success = RunFolder(run.path), trials(run.spec.protocol)
    with folder.journal() as journal:
        found = np.concatenate([journal.shape.empty(0), *scored(journal.kept(), per_success)])
    best = best_in_cells(found)
    return Voxels(name, run, folder.scene(), best, eta(best["fitness"], per_success) if per_success else None)


def draw_voxels(shown: Sequence[Voxels], method: str) -> Sheet:
    """One view for each scene."""
    columns = min(WRAPPED, len(shown))
    handles = _legend(shown)
    sheet = Sheet(
        -(-len(shown) // columns), columns, (PANEL, PANEL), legend_rows=1, below=0.1, aside=0.3, left=0.3,
        least=0.4 + 1.75 * len(handles),
    )  # fmt: skip
    for number, one in enumerate(shown):
        axes = sheet.axes(*divmod(number, columns))
        view = view_of_cells(one.scene, one.best, side_of(one.scene, one.best), PIXELS, _hues(one))
        axes.imshow(view.image, interpolation="bicubic")
        axes.set_axis_off()
        scale_bar(axes, view)
        triad(axes, view)
        heading(axes, one.name.words, _counts(one, view.whole), _behind(one.run))
    sheet.title(
        f"Where {method} had successes",
        "Cells of 1 cm that held the hand, by the most robust success in each.",
    )
    sheet.legend(handles, len(handles), length=1.0)
    return sheet


def _hues(one: Voxels) -> Floats:
    return hues_of_fitness(one.best["fitness"]) if one.eta is None else _hues_of_eta(one.eta)


def _hues_of_eta(eta: NDArray[np.float64]) -> Floats:
    hues: Floats = matplotlib.colormaps["viridis_r"](eta)[:, :3].astype(np.float32)
    return hues


def _counts(one: Voxels, whole: bool) -> str:
    cut = "" if whole else "; cut open"
    if one.eta is None:
        return f"{len(one.best):,} cells, {int((one.best['fitness'] == ROBUST).sum()):,} robust{cut}"
    return f"{len(one.best):,} cells, median \u03b7 {np.median(one.eta) if len(one.eta) else 0:.2f}{cut}"


def _behind(run: History) -> str:
    mark = "" if run.complete else ", unfinished"
    return f"seed {run.spec.seed}, {run.evaluations:,} evaluations{mark}"


def _legend(shown: Sequence[Voxels]) -> list[Line2D]:
    fitness = [(to_rgb(hue), words) for hue, words in zip(COLOURS, WORDS, strict=True)]
    etas = [(tuple(_hues_of_eta(np.array([eta]))[0]), f"\u03b7 = {eta:g}") for eta in ETAS]
    kinds = [
        (fitness, any(one.eta is None for one in shown)),
        (etas, any(one.eta is not None for one in shown)),
    ]
    return [
        Line2D([], [], linestyle="none", marker="s", markersize=8, color=hue, label=words)
        for kind, present in kinds
        if present
        for hue, words in kind
    ]
