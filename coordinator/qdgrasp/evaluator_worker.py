"""Serves the jobs on a bus with an evaluator of one's own, as a worker like any other."""

import inspect
import os
import sys

from typer.exceptions import TyperException

from qdgrasp_protocol.cli_support import usage_error
from qdgrasp_protocol.errors import InputError
from qdgrasp_worker.cli import app
from qdgrasp_worker.runtime.evaluator_api import EvaluatorFactory


def serve(
    evaluator: EvaluatorFactory | str,
    *,
    connect: str | None = None,
    job: str | None = None,
    security: str | os.PathLike[str] | None = None,
    workers: int = 1,
    row_seconds: float = 30.0,
    wait: float = 30.0,
) -> None:
    """Serve jobs on a bus with a custom evaluator; `qdgrasp-worker --evaluator` does the same.

    It joins, holds leases and credit, and returns batches that it cannot finish, as every worker does. The
    evaluator runs in a process of its own, which may die: its rows are then tried again, one by one. Workers
    with different evaluators, or different files of one, do not serve one job.

    Parameters
    ----------
    evaluator
        Called once with each `Scene`, it gives a function from `Hands` to `Verdicts`: a class with
        `__init__(scene)` and `__call__(hands)`, or a function that returns one. It must stand at the top
        of its module. Its verdict on a hand depends on scene and hand alone: so a run's
        journal is a function of its spec. Or "FILE.py:NAME", "MODULE:NAME".
    connect
        Endpoint of the router; None: port 7447 on loopback.
    job
        The only job to serve; None: every job there is.
    security
        Folder of a worker's certificates; None: links are not encrypted.
    workers
        How many processes evaluate.
    row_seconds
        CPU seconds that loading a scene may take, and so may the hands that are shown at once: sixteen, or as
        many as the evaluator's attribute `at_once` says.
    wait
        Seconds that the router is waited for.

    Raises
    ------
    InputError
        A value that cannot be; the evaluator cannot be found by another process, no router answers, or the
        job does not take it.

    Notes
    -----
    Returns when the process is asked to stop, or when a job that is the only one to serve drains this worker.
    Call it in the main thread, in a script under `if __name__ == "__main__":`.

    Examples
    --------
    >>> qdgrasp.serve(Ballistic, connect="tcp/127.0.0.1:7447", job="mine")
    """
    flags = {
        "--evaluator": evaluator if isinstance(evaluator, str) else evaluator_name(evaluator),
        "--connect": connect,
        "--job": job,
        "--security": security,
        "--workers": workers,
        "--row-seconds": row_seconds,
        "--wait": wait,
    }
    given = [str(word) for flag, value in flags.items() if value is not None for word in (flag, value)]
    try:
        code = app(given, prog_name="qdgrasp-worker", standalone_mode=False)
    except TyperException as error:
        raise InputError(usage_error(error, "qdgrasp-worker")) from None
    if code == InputError.exit_code:
        raise InputError("The workers ended at their start; what they said stands above.")


def evaluator_name(evaluator: EvaluatorFactory) -> str:
    """Return FILE.py:NAME of an evaluator, or MODULE:NAME in a package, for other processes.

    Raises InputError if it does not stand at the top of a module that lies in a file.
    """
    name = getattr(evaluator, "__qualname__", "")
    module = sys.modules.get(getattr(evaluator, "__module__", None) or "")
    if module is None or not name or "<" in name:
        raise InputError(
            f"{evaluator!r} cannot be found by another process: an evaluator is a class or function at the "
            "top of a module."
        )
    if "." in module.__name__:
        return f"{module.__name__}:{name}"
    try:
        return f"{inspect.getsourcefile(module)}:{name}"
    except TypeError:
        raise InputError(
            f"'{name}' was typed at a prompt, where no other process finds it; write it to a file."
        ) from None
