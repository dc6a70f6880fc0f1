"""`qdgrasp-monitor`: its output, and the effect of its options."""

import json
import os
import pty
import signal
from pathlib import Path

import msgspec
import pytest
from rich.console import Console
from tests.tools.monitor.sample_jobs import values, views
from typer.testing import CliRunner

from qdgrasp_coordinator.metrics.job_status import ObjectListings
from qdgrasp_protocol.errors import InputError, UnknownName
from qdgrasp_protocol.process import Stop
from qdgrasp_tools.cli import monitor_process
from qdgrasp_tools.cli.monitor_process import app
from qdgrasp_tools.monitor.feed import ObjectFeed
from qdgrasp_tools.monitor.job_model import JobView
from qdgrasp_tools.monitor.terminal import screen
from qdgrasp_tools.monitor.terminal.screen import watch_jobs
from qdgrasp_tools.monitor.terminal.text_tables import ASCII

TOKEN = "a-token-of-some-length"  # noqa: S105 - it opens nothing
ENDPOINT = "tcp/127.0.0.1:1"
BOTH = views(values("mugs") | values("cubes"))


def test_one_job_is_chosen_by_its_name_and_all_without_one() -> None:
    assert [view.job for view in monitor_process.chosen_views(BOTH, None)] == ["cubes", "mugs"]
    assert [view.job for view in monitor_process.chosen_views(BOTH, "mugs")] == ["mugs"]


def test_a_job_that_is_not_there_is_missed_only_where_there_are_others() -> None:
    with pytest.raises(UnknownName, match="Did you mean 'mugs'"):
        monitor_process.chosen_views(BOTH, "mug")
    assert monitor_process.chosen_views([], "mug") == []


def test_json_is_one_line_from_which_all_can_be_read_again() -> None:
    line = monitor_process.to_json(BOTH, ENDPOINT)
    assert "\n" not in line
    read = json.loads(line)
    assert read["endpoint"] == ENDPOINT
    assert msgspec.convert(read["jobs"], list[JobView]) == BOTH


@pytest.mark.parametrize("ascii_only", [True, False])
def test_one_look_shows_all_jobs_and_names_those_of_another_version(capsys, monkeypatch, ascii_only) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    monitor_process.print_look(BOTH, ENDPOINT, ["old"], ascii_only=ascii_only)
    said = capsys.readouterr().out
    for words in ("mugs: running", "cubes: running", "qdgrasp-monitor: old", "1 000 of 3 000", "n0"):
        assert words in said
    assert max(map(len, said.splitlines())) <= 80
    assert said.isascii() or not ascii_only


class OneLook:
    """Jobs that are looked at once: then the monitor is asked to stop."""

    is_linked, foreign_jobs = True, ()

    def __init__(self, stop: Stop) -> None:
        self._stop = stop

    def views(self) -> list[JobView]:
        self._stop.set(15)
        return BOTH


@pytest.mark.parametrize(
    "work",
    [
        lambda feed, stop: monitor_process.stream_looks(feed, ENDPOINT, stop),
        lambda feed, stop: watch_jobs(
            feed, ObjectFeed(lambda _: ObjectListings(objects=[])), ENDPOINT, Console(), ASCII, stop
        ),
    ],
    ids=["json", "lines"],
)
def test_what_draws_nothing_leaves_the_terminal_and_its_keys_alone(work, capsys, monkeypatch) -> None:
    _, terminal = pty.openpty()
    monkeypatch.setattr(screen, "DRAW_INTERVAL", 0.0)
    monkeypatch.setattr(monitor_process, "INTERVAL", 0.0)
    monkeypatch.setattr("tty.setcbreak", lambda _: pytest.fail("the terminal was changed"))
    before = signal.getsignal(signal.SIGTSTP)
    monkeypatch.setattr("signal.signal", lambda *_: pytest.fail("Ctrl-Z was taken away"))
    with os.fdopen(terminal) as keys:
        monkeypatch.setattr("sys.stdin", keys)
        stop = Stop()
        work(OneLook(stop), stop)
    assert signal.getsignal(signal.SIGTSTP) == before
    assert "mugs" in capsys.readouterr().out


def test_one_look_at_nothing_says_what_to_do(capsys: pytest.CaptureFixture[str]) -> None:
    monitor_process.print_look([], ENDPOINT, [], ascii_only=False)
    assert capsys.readouterr().out.startswith(f"No job is at {ENDPOINT}")


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (["--once", "--web", "localhost:0"], "--once and --web do not go together"),
        (["--json", "--web", "localhost:0"], "--json and --web do not go together"),
        (["--ascii", "--web", "localhost:0"], "--ascii and --web do not go together"),
        (["--json", "--ascii"], "--json and --ascii do not go together"),
        (["--token", TOKEN], "--token does nothing without --web"),
        (["--token-file", "token"], "--token-file does nothing without --web"),
        (["--web", "localhost:0", "--token", TOKEN, "--token-file", "x"], "--token and --token-file do not"),
    ],
)
def test_flags_that_have_nothing_to_do_are_refused(flags: list[str], words: str) -> None:
    refused = CliRunner().invoke(app, flags)
    assert isinstance(refused.exception, InputError)
    assert words in str(refused.exception)


def test_a_token_in_the_environment_is_there_for_those_who_need_it() -> None:
    for given in ({"once"}, {"as_json", "once"}, {"web", "token"}, {"web", "token_file", "job"}):
        monitor_process.check_flags(given)
    other = CliRunner().invoke(app, ["--once", "--connect", "nowhere"], env={"QDGRASP_TOKEN": TOKEN})
    assert "--token" not in str(other.exception)


def test_a_token_is_read_from_the_first_line_of_a_file(tmp_path: Path) -> None:
    (tmp_path / "token").write_text(f" {TOKEN}\nanother\n", encoding="utf-8")
    assert monitor_process.read_token(tmp_path / "token") == TOKEN


@pytest.mark.parametrize("content", [None, b"", b"\n", b"\xff\xfe"])
def test_a_file_without_a_token_is_named(tmp_path: Path, content: bytes | None) -> None:
    if content is not None:
        (tmp_path / "token").write_bytes(content)
    with pytest.raises(InputError, match=r"--token-file .*token (cannot be read|has no token)"):
        monitor_process.read_token(tmp_path / "token")
