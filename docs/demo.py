"""`make demo`: the main job on a built-in gripper and object, and a picture of its grasps."""

import shutil
from pathlib import Path

import numpy as np
import typer
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from qdgrasp_assets.scene import Scene
from qdgrasp_coordinator.metrics.success_metrics import FITNESS_COLOURS, FITNESS_WORDS
from qdgrasp_coordinator.metrics.successes import survival
from qdgrasp_coordinator.scheduler.run_plan import asked_spec
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.cli_support import run_command
from qdgrasp_protocol.errors import FolderError
from qdgrasp_protocol.rows import Outcome, Rows
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_protocol.text import counted
from qdgrasp_tools.cli import options
from qdgrasp_tools.cli.run_commands import start_run
from qdgrasp_tools.export.grasp_reader import spread_places
from qdgrasp_tools.export.grasp_set import Grasps
from qdgrasp_tools.local.supervisor import LocalJobConfig
from qdgrasp_tools.rendering.drawings import FAINT, INK, axes_triad, figure_text, show_view
from qdgrasp_tools.rendering.views import (
    RenderedView,
    best_in_cells,
    broad_azimuth,
    view_of_cells,
    view_of_hands,
)

SPEC = {"gripper": "panda", "object": "mug", "evaluations": 3000}
MARKER = ".qdgrasp-demo"
app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)


@app.command()
def demo(out: Path = Path("runs/demo"), engine: str | None = None) -> None:
    """Fill an archive of grasps for the built-in Panda hand and mug, and draw them."""
    clear(out)
    spec = asked_spec(SPEC | ({"engine": engine} if engine else {}))
    start_run(spec, out, LocalJobConfig(options.worker_count(None)), more={MARKER: b""})
    picture = out / "grasps.png"
    folder = RunFolder.open(out)
    with folder.journal() as journal:
        rows = np.concatenate([journal.shape.empty(0), *journal.blocks()])
    draw_grasps(folder.scene(), rows, picture, folder.spec)
    typer.echo(f"Records: {out / 'run.sqlite'}\nPicture: {picture}")


GRASPS_SIZE = (16.0, 9.2)  # inches
HANDS_BOX, CELLS_BOX = (0.01, 0.02, 0.545, 0.87), (0.58, 0.24, 0.4, 0.6)
"""Left, bottom, width and height of the two panels, as shares of the figure."""
HANDS = 7  # Grasps in the picture
OUTCOME_NOUNS = {Outcome.DROPPED: "successes", Outcome.SHAKEN: "grasps", Outcome.HELD: "robust"}


def draw_grasps(scene: Scene, rows: Rows, path: Path, spec: RunSpec, pixels: int = 1040) -> None:
    """Draw some grasps of a run, and the cells that it filled, to a PNG file.

    There may be no success among the rows. The view of the hands is `pixels` wide, the picture 1.8 times as
    wide.
    """
    found = rows[(rows["trial"] == 0) & (rows["outcome"] >= Outcome.DROPPED)]
    best, side = best_in_cells(found), broad_azimuth(scene)
    figure = Figure(figsize=GRASPS_SIZE, dpi=pixels / (GRASPS_SIZE[1] * HANDS_BOX[3]), facecolor="white")
    title = f"{scene.gripper.name}  on  {scene.object.name}"
    figure.text(0.022, 0.951, figure_text(title), size=26, weight="bold", color=INK, va="center")
    counts = ", ".join(
        f"{int((found['outcome'] >= kind).sum()):,} {word}" for kind, word in OUTCOME_NOUNS.items()
    )
    words = f"{spec.method}, seed {spec.seed}, protocol {scene.protocol}:   {counts}"
    figure.text(0.022, 0.911, words, size=13.5, color=FAINT, va="center")
    hands = figure.add_axes(HANDS_BOX)
    view = view_of_hands(scene, _spread(scene, spec, found), side, pixels)
    show_view(hands, view)
    axes_triad(hands, view)
    cells = view_of_cells(scene, best, side, round(pixels * CELLS_BOX[3] / HANDS_BOX[3]))
    _draw_cells(figure.add_axes(CELLS_BOX), cells)
    figure.savefig(path, format="png")


def _spread(scene: Scene, spec: RunSpec, found: Rows) -> Rows:
    """Choose a few well-spread rows of the best outcome."""
    best = found[found["outcome"] == found["outcome"].max(initial=Outcome.DROPPED)]
    unknown, none = np.full(len(best), np.nan), np.zeros(len(best), np.int64)
    grasps = Grasps(scene, spec, "demo", np.arange(len(best)), best, unknown, none, unknown)
    return grasps[spread_places(grasps, HANDS)].rows


def _draw_cells(axes: Axes, view: RenderedView) -> None:
    show_view(axes, view)
    heading = f"{counted(len(view.shown), 'cell', told='{:,}'.format)} of 1 cm where the hand had a success"
    axes.set_title(heading + ("" if view.is_uncut else ", cut open"), size=13, color=INK, loc="left", pad=4)
    for best, (colour, word) in enumerate(zip(FITNESS_COLOURS, FITNESS_WORDS, strict=True)):
        axes.plot([], [], "s", color=colour, label=f"{int((survival(view.shown) == best).sum()):,}  {word}")
    axes.legend(
        loc="upper left", bbox_to_anchor=(0, 0), frameon=False, labelcolor=FAINT, fontsize=12, reverse=True
    )


def clear(out: Path) -> None:
    """Remove the folder of an earlier demo, and nothing else.

    Raises
    ------
    FolderError
        The folder is not an earlier demo's.
    """
    if not out.exists() or (out.is_dir() and not any(out.iterdir())):
        return
    if not (out / MARKER).is_file():
        raise FolderError(f"{out} is not an earlier demo's folder ({MARKER} is not in it); move it away.")
    shutil.rmtree(out)


def main() -> None:
    """Entry point of `python -m docs.demo`."""
    run_command(app, "qdgrasp demo")


if __name__ == "__main__":
    main()
