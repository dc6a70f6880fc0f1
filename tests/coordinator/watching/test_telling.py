"""What is said of a command that takes its time."""

import io
import threading
from queue import SimpleQueue

import pytest
from rich.console import Console

from qdgrasp_coordinator.watching import telling
from qdgrasp_coordinator.watching.telling import now_and_then

PATIENCE = 60.0


def test_the_latest_sentence_is_said_again_and_again_until_the_end() -> None:
    said: SimpleQueue[str] = SimpleQueue()
    with now_and_then(said.put, 0.001) as tell:
        tell("reading\nmugs.yaml")
        lines = {said.get(timeout=PATIENCE) for _ in range(3)}
        assert lines <= {"starting, 0 s", "reading\\nmugs.yaml, 0 s"}
        tell("writing")
        while not said.get(timeout=PATIENCE).startswith("writing, "):
            pass
    assert "telling" not in {thread.name for thread in threading.enumerate()}


def test_what_is_done_soon_says_nothing_where_nobody_sees_it_move(capsys: pytest.CaptureFixture[str]) -> None:
    with telling.telling() as tell:
        tell("reading mugs.yaml")
    assert capsys.readouterr().err == ""


def test_a_terminal_shows_it_and_is_left_clean(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = io.StringIO()
    monkeypatch.setattr(
        telling, "Console", lambda stderr: Console(file=terminal, force_terminal=True, width=60)
    )
    with telling.telling() as tell:
        tell("reading [mugs].yaml")
    shown = terminal.getvalue()
    assert "reading [mugs].yaml" in shown
    assert shown.endswith("\x1b[2K")
