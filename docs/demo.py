"""`make demo`: the main job on a built-in gripper and object, and a picture of its grasps."""

import shutil
from pathlib import Path

import numpy as np
import typer

from qdgrasp_coordinator.scheduler.run_plan import RUN_DEFAULTS, full_spec
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.cli_support import run_command
from qdgrasp_protocol.errors import FolderError
from qdgrasp_protocol.spec import DEFAULT_ENGINE, has_bullet
from qdgrasp_tools.cli import options
from qdgrasp_tools.cli.run_commands import start_run
from qdgrasp_tools.local.supervisor import LocalJobConfig
from qdgrasp_tools.rendering.drawings import draw_grasps

SPEC = {"gripper": "panda", "object": "mug", "evaluations": 3000}
MARKER = ".qdgrasp-demo"
app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)


@app.command()
def demo(out: Path = Path("runs/demo"), engine: str | None = None) -> None:
    """Fill an archive of grasps for the built-in Panda hand and mug, and draw them."""
    clear(out)
    chosen = engine or (DEFAULT_ENGINE if has_bullet() else "mujoco")
    spec = full_spec(RUN_DEFAULTS | SPEC | {"engine": chosen})
    start_run(spec, out, LocalJobConfig(options.cores()), begun=mark)
    picture = out / "grasps.png"
    folder = RunFolder.open(out)
    with folder.journal() as journal:
        rows = np.concatenate([journal.shape.empty(0), *journal.blocks()])
    draw_grasps(folder.scene(), rows, picture, spec=folder.spec)
    typer.echo(f"Records: {out / 'run.sqlite'}\nPicture: {picture}")


def mark(folder: RunFolder) -> None:
    """Mark a folder as the demo's, so that the next demo may replace it."""
    (folder.path / MARKER).touch()


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
