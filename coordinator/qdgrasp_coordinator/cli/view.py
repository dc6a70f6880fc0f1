"""`qdgrasp view`: the grasps of runs in folders, on a page in the browser."""

import os
import threading
import webbrowser
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import typer

from qdgrasp_coordinator.cli.web_place import web_place
from qdgrasp_protocol.lifetime import lifetime

HERE = "127.0.0.1:0"


def view(
    directories: Annotated[
        list[Path],
        typer.Argument(
            metavar="DIR...", help="Folders of runs and campaigns, or ones that hold such folders."
        ),
    ],
    web: Annotated[
        str,
        typer.Option(
            metavar="HOST:PORT",
            show_default=False,
            help="Serve the page there; default: on loopback, at a port that is free.",
        ),
    ] = HERE,
    no_open: Annotated[bool, typer.Option("--no-open", help="Open no browser.")] = False,
) -> None:
    """Look at the grasps of runs in the browser: in 3D, with filters, and the hand as it grasps.

    Runs may be finished or going on; nothing is changed. The page is there until Ctrl-C. Beyond loopback it
    wants a token, which is printed.

    Example: qdgrasp view runs/demo
    """
    host, port = web_place(web)
    with lifetime("qdgrasp-view") as stop:
        from qdgrasp_coordinator.monitor.collection import Collection
        from qdgrasp_coordinator.monitor.web.app import serve
        from qdgrasp_coordinator.monitor.web.folder_site import FolderSite

        def opened(address: str) -> None:
            typer.echo(f"The grasps are shown at {address} until Ctrl-C.")
            if not no_open and has_desktop(os.environ):
                threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()

        serve(FolderSite(Collection(directories)), host, port, "", stop, opened)
    raise typer.Exit(stop.exit_code)


def has_desktop(environment: Mapping[str, str]) -> bool:
    """Whether somebody sits in front of this machine who would see a browser open."""
    shown = environment.get("DISPLAY") or environment.get("WAYLAND_DISPLAY")
    return bool(shown) and not environment.get("SSH_CONNECTION")
