"""The process that replays an evaluation: `python -m qdgrasp_worker.replaying FOLDER` (`protocol.replay`)."""

import os
from pathlib import Path

import msgspec
import numpy as np
import typer

from qdgrasp_assets.scene import unpack_scene
from qdgrasp_protocol.command import run_command
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.lifetime import lifetime
from qdgrasp_protocol.replay import ANSWER, FRAMES, REQUEST, SCENE, Request
from qdgrasp_worker.replaying.replay import Frames, Replay

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)


@app.command()
def replay(folder: Path) -> None:
    """Replay what the folder's request asks for, and write what was seen beside it."""

    def make(frames: int, rows: int, columns: int) -> Frames:
        return np.lib.format.open_memmap(
            folder / FRAMES, mode="w+", dtype=np.uint8, shape=(frames, rows, columns, 3)
        )

    with lifetime("qdgrasp-replay") as stop:
        stop.tell(lambda: os._exit(stop.exit_code))  # nothing is left behind but a folder that is thrown away
        try:
            request = msgspec.json.decode((folder / REQUEST).read_bytes(), type=Request)
            answer = Replay(unpack_scene((folder / SCENE).read_bytes()), request).draw(make)
            (folder / ANSWER).write_bytes(msgspec.json.encode(answer))
        except OSError as error:
            raise InputError(
                f"The frames do not fit into {folder.parent}: {error.strerror or error}."
            ) from None


if __name__ == "__main__":
    run_command(app, "qdgrasp-replay")
