"""`qdgrasp jobs` and the orders to a job: what they print of what a coordinator says."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import pytest
from tests.coordinator.monitor.shown import values, views

from qdgrasp_coordinator.cli import administer, jobs
from qdgrasp_protocol import codec
from qdgrasp_protocol.messages import Done, Order

EVIL = "\x1b[2J"


@contextmanager
def session(*_: object) -> Iterator[SimpleNamespace]:
    """A session at a coordinator whose words are no good ones."""
    yield SimpleNamespace(ask=lambda *_: codec.encode(Done(words=f"Done. {EVIL}")))


def test_what_a_coordinator_says_of_its_job_is_escaped(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(jobs, "session", session)
    monkeypatch.setattr(jobs, "overview", lambda _: views(values(trouble=EVIL)))
    jobs.jobs("tcp/127.0.0.1:1", None)
    said = capsys.readouterr().out
    assert r"paused: \x1b[2J" in said
    assert EVIL not in said


def test_what_it_answers_to_an_order_is_escaped(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setattr(administer, "session", session)
    administer.order("mugs", "tcp/127.0.0.1:1", tmp_path, Order(act="pause"))
    assert capsys.readouterr().out == "Done. \\x1b[2J\n"
