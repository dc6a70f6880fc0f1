"""`qdgrasp-monitor`: what it shows of a job with real processes, and how it ends."""

import fcntl
import json
import os
import pty
import select
import signal
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from datetime import UTC, datetime
from queue import SimpleQueue

import pytest
from tests.endpoints import own_endpoint
from tests.system.commands import PATIENCE, SMALL, Commands, held, kill, pids, rows_recorded, wait_for

from qdgrasp_coordinator.counts.figures import Figures, JobFigures, from_json
from qdgrasp_coordinator.counts.team import TeamFigures
from qdgrasp_coordinator.folders.job_folder import JobFolder
from qdgrasp_coordinator.monitor.feed import Feed
from qdgrasp_coordinator.monitor.jobs import JobView
from qdgrasp_coordinator.monitor.terminal.frame import Shown, sheet
from qdgrasp_coordinator.monitor.terminal.glyphs import ASCII
from qdgrasp_coordinator.serving.board import INTERVAL
from qdgrasp_protocol.bus import Sample
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.zenoh_bus import ZenohBus

MONITOR = "qdgrasp_coordinator.cli.monitor"
ENDLESS = 98_765
"""Evaluations of a run that goes on until it is ended."""
COUNTS = ("evaluations", "budget", "simulated", "proposals", "overlaps", "dead_ends", "successes", "cells")


def watch(qdgrasp: Commands, *arguments: object) -> tuple[int, str, str]:
    done = qdgrasp(*arguments, entry="monitor")
    return done.code, done.out, done.err


@contextmanager
def running(qdgrasp: Commands, evaluations: int) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """A run whose two workers are there and of which some rows are on disk, at an endpoint."""
    endpoint, there = own_endpoint(), SimpleQueue[str]()
    budget = (*SMALL, "--evaluations", evaluations, "--batch-size", 10)
    command = ("run", *budget, "--workers", 2, "--out", "run", "--job", "mugs")
    process = qdgrasp.start(*command, "--listen", endpoint)
    with ZenohBus.connect(endpoint, PATIENCE) as bus:
        bus.watch(Keys("mugs").worker_token(), lambda key, _alive: there.put(key))
        assert len({there.get(timeout=PATIENCE) for _ in range(2)}) == 2
    wait_for(lambda: rows_recorded(qdgrasp.home / "run") >= 20 or process.poll() is not None, "rows")
    assert process.poll() is None, process.communicate()
    yield endpoint, process


def test_a_running_job_is_seen_and_at_its_end_all_say_the_same(qdgrasp: Commands) -> None:
    with ExitStack() as stack:
        endpoint, process = stack.enter_context(running(qdgrasp, 300))
        with held(*pids(process, "worker")):  # so that it goes on for as long as it is looked at
            feed = stack.enter_context(Feed(stack.enter_context(ZenohBus.connect(endpoint, PATIENCE))))
            wait_for(lambda: [len(view.workers) for view in feed.views()] == [2], "both workers")
            code, out, err = watch(qdgrasp, "--once", "--json", "--connect", endpoint)
            assert (code, err) == (0, "")
            (job,) = parsed(out)["jobs"]
            told = (job["job"], job["state"], len(job["workers"]), len(job["runs"]))
            assert told == ("mugs", "running", 2, 1)
            assert {*JobView.__struct_fields__} == {*job}
            assert {*Figures.__struct_fields__} == {*job["runs"][0]}
            assert {*JobFigures.__struct_fields__} == {*job["figures"]}
            assert job["curves"][job["runs"][0]["run"]]["points"]
            assert any(event["kind"] == "worker" for event in job["events"])
            assert job["meta"]["identity"] == JobFolder.open(qdgrasp.home / "run").identity != ""
            code, out, _ = watch(qdgrasp, "--once", "--connect", endpoint)
            assert (code, "mugs: running" in out, max(map(len, out.splitlines())) <= 80) == (0, True, True)
        _, err = process.communicate(timeout=PATIENCE)
        assert process.returncode == 0, err
        wait_for(lambda: [view.state for view in feed.views()] == ["ended"], "the end")
        (view,) = feed.views()
    (run,), info = view.runs, qdgrasp.info("run")
    assert {name: getattr(view.figures, name) for name in COUNTS} == {name: info[name] for name in COUNTS}
    for name in (*COUNTS, "robust", "grasps", "errors", "rows"):
        assert getattr(run, name) == info[name], name
    assert sum(run.outcomes.values()) == info["rows"]
    assert run.durable == rows_recorded(qdgrasp.home / "run")
    told = "\n".join(line.plain for line in sheet(Shown([view], endpoint, datetime.now(UTC)), 80, ASCII))
    assert f"{info['evaluations']} of {info['budget']} evaluations" in told
    assert f"{info['successes']} successes" in told
    assert f"{info['cells']} cells" in told


def test_a_killed_worker_is_shown_as_gone_within_two_seconds(qdgrasp: Commands) -> None:
    """By the coordinator's own beat: it shows the job twice a second, and so less often where it is slow."""
    keys, news = Keys("mugs"), SimpleQueue[str]()

    def seen(sample: Sample) -> None:
        page = from_json(sample.payload, TeamFigures)
        news.put("gone" if any(one.state == "gone" for one in page.workers) else "team")

    with running(qdgrasp, ENDLESS) as (endpoint, process), ZenohBus.connect(endpoint, PATIENCE) as bus:
        bus.watch(keys.worker_token(), lambda _, alive: news.put("there" if alive else "lost"))
        bus.subscribe(keys.stat("job"), lambda _: news.put("job"))
        bus.subscribe(keys.stat("team/*"), seen)
        kill(pids(process, "worker")[0])
        heard = list(iter(lambda: news.get(timeout=PATIENCE), "gone"))
        process.terminate()
        process.communicate(timeout=PATIENCE)
    assert "lost" in heard
    assert heard[heard.index("lost") :].count("job") <= 2.0 / INTERVAL


def parsed(out: str) -> dict:
    """The one JSON object of an output of one line."""
    (line,) = out.splitlines()
    return json.loads(line)


def test_without_a_router_it_says_what_to_do(qdgrasp: Commands) -> None:
    for flags in (["--once"], ["--once", "--json"], []):
        code, out, err = watch(qdgrasp, *flags, "--wait", "0.2", "--connect", own_endpoint())
        assert (code, out) == (2, "")
        assert err.startswith("qdgrasp-monitor: Nothing answers at tcp/")
        assert "--connect" in err


def test_without_a_job_it_says_so(qdgrasp: Commands) -> None:
    endpoint = own_endpoint()
    with ZenohBus.router(endpoint):
        code, out, err = watch(qdgrasp, "--once", "--connect", endpoint)
        assert (code, err) == (0, "")
        assert out.startswith(f"No job is at {endpoint}")
        code, out, _ = watch(qdgrasp, "--once", "--json", "--connect", endpoint, "--job", "mugs")
        assert (code, parsed(out)) == (0, {"endpoint": endpoint, "jobs": []})


def _of_no_size(environment: Mapping[str, str]) -> dict[str, str]:
    """An environment without the size of another terminal: what runs tests in parallel tells its own."""
    return {name: value for name, value in environment.items() if name not in ("COLUMNS", "LINES")}


class Terminal:
    """The monitor on a terminal of 80 columns and 24 lines."""

    def __init__(self, qdgrasp: Commands, *arguments: str) -> None:
        self._near, far = pty.openpty()
        self.resize(24, 80)
        self.before = termios.tcgetattr(self._near)
        self.seen = b""
        self.process = subprocess.Popen(
            [sys.executable, "-m", MONITOR, *arguments],
            cwd=qdgrasp.home,
            env=_of_no_size(os.environ) | {"TERM": "xterm-256color", "PYTHONIOENCODING": "utf-8"},
            stdin=far,
            stdout=far,
            stderr=far,
            start_new_session=True,
        )
        os.close(far)

    def resize(self, lines: int, columns: int) -> None:
        fcntl.ioctl(self._near, termios.TIOCSWINSZ, struct.pack("HHHH", lines, columns, 0, 0))

    def shows(self, words: str) -> None:
        """Wait for words that are drawn from now on."""
        self.seen, deadline = b"", time.monotonic() + PATIENCE
        while words.encode() not in self.seen:
            assert time.monotonic() < deadline, f"it never shows {words!r}: {self.seen[-3000:]!r}"
            assert self.read(0.5), f"it ended and never showed {words!r}: {self.seen[-3000:]!r}"

    def read(self, seconds: float) -> bool:
        """Take what it draws; False: it has ended, and all of it was taken."""
        if select.select([self._near], [], [], seconds)[0]:
            try:
                self.seen += os.read(self._near, 1 << 16)
            except OSError:
                return False
        return True

    def press(self, keys: bytes) -> None:
        os.write(self._near, keys)

    def ends(self) -> int:
        """Read what it draws until its end; gives its exit code."""
        deadline = time.monotonic() + PATIENCE
        while self.read(0.5):
            assert time.monotonic() < deadline
        return self.process.wait(PATIENCE)

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.kill()
        os.close(self._near)


@pytest.fixture
def terminal(qdgrasp: Commands) -> Iterator[tuple[Terminal, str]]:
    """A monitor that shows that there is no job."""
    endpoint = own_endpoint()
    with ZenohBus.router(endpoint):
        shown = Terminal(qdgrasp, "--connect", endpoint)
        try:
            shown.shows("No job is at")
            yield shown, endpoint
        finally:
            shown.close()


def test_a_key_ends_it_and_leaves_the_terminal_as_it_was(terminal: tuple[Terminal, str]) -> None:
    shown, _ = terminal
    shown.press(b"q")
    assert shown.ends() == 0
    assert b"\x1b[?1049l" in shown.seen  # back from the other screen
    assert b"\x1b[?25h" in shown.seen  # with a cursor


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it(terminal: tuple[Terminal, str], number: int) -> None:
    shown, _ = terminal
    shown.process.send_signal(number)
    assert shown.ends() == 128 + number
    assert b"Traceback" not in shown.seen
    assert b"\x1b[?1049l" in shown.seen


def test_it_draws_for_another_size(terminal: tuple[Terminal, str]) -> None:
    shown, _ = terminal
    shown.resize(8, 30)
    shown.shows("40 columns, 12 lines")
    shown.resize(24, 80)
    shown.shows("No job is at")


def test_a_job_is_shown_when_it_begins_and_the_router_is_missed_when_it_goes(qdgrasp: Commands) -> None:
    endpoint = own_endpoint()
    budget = (*SMALL, "--evaluations", ENDLESS)
    command = ("run", *budget, "--workers", 1, "--out", "run", "--job", "mugs", "--listen", endpoint)
    with ExitStack() as stack:
        router = stack.enter_context(ZenohBus.router(endpoint))
        shown = Terminal(qdgrasp, "--connect", endpoint)
        stack.callback(shown.close)
        shown.shows("No job is at")
        router.close()
        shown.shows("The router is away")
        process = qdgrasp.start(*command)
        shown.shows("98 765 evaluations")
        process.terminate()
        process.communicate(timeout=PATIENCE)
        shown.shows("The router is away")
