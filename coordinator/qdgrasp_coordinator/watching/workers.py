"""The workers that a command starts on this machine, and how long they may take to leave."""

from collections.abc import Iterable

from qdgrasp_protocol.crew import Crew

GRACE = 1.2
"""Seconds that a command's processes may take to stop, of the two in which it stops itself: whoever takes
longer loses nothing but its time."""


def hire_worker(crew: Crew, number: int, arguments: Iterable[str]) -> None:
    """Start a worker, that leaves before the crew loses its patience."""
    grace = ["--grace", f"{crew.members_grace:g}"]
    crew.hire(f"worker-{number}", "qdgrasp_worker.cli", [*arguments, *grace])
