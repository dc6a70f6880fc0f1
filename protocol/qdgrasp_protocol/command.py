"""What every command of qdgrasp does alike: one clear sentence and an exit code, never a traceback."""

import sys
from collections.abc import Callable

import typer

from qdgrasp_protocol.errors import QdgraspError


def run_command(app: typer.Typer | Callable[[], None], name: str) -> None:
    """Run a command line; an error of ours ends it with its sentence and its exit code."""
    try:
        app(prog_name=name) if isinstance(app, typer.Typer) else app()
    except QdgraspError as error:
        print(f"{name}: {error}", file=sys.stderr)  # noqa: T201 - the one place that speaks without a logger
        sys.exit(error.exit_code)
    except KeyboardInterrupt:
        sys.exit(130)
    except BrokenPipeError:
        sys.exit(141)
