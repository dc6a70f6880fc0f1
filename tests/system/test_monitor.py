"""`qdgrasp-monitor` with real processes, and that everything counts the same at the end."""

import fcntl
import os
import pty
import signal
import struct
import subprocess
import sys
import termios
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from queue import SimpleQueue

from tests.common import PATIENCE, own_endpoint, wait_for
from tests.system.commands import MONITOR, SMALL, Commands, end_of, has_rows, held, pids, rows_recorded

from qdgrasp_coordinator.metrics.job_status import JobStatus, RunStatus
from qdgrasp_coordinator.storage.job_folder import JobFolder
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.zenoh_bus import ZenohBus
from qdgrasp_tools.monitor.feed import Feed
from qdgrasp_tools.monitor.job_model import JobView

COUNTS = ("evaluations", "budget", "simulated", "steps", "overlaps", "dead_ends", "successes", "cells")


@contextmanager
def running(qdgrasp: Commands, evaluations: int) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """A run whose two workers are there and of which some rows are on disk, at an endpoint."""
    endpoint, there = own_endpoint(), SimpleQueue[str]()
    budget = (*SMALL, "--evaluations", evaluations)
    command = ("run", *budget, "--workers", 2, "--out", "mugs")
    process = qdgrasp.start(*command, "--listen", endpoint)
    with ZenohBus.connect(endpoint, PATIENCE) as bus:
        bus.watch(Keys("mugs").worker_token(), lambda key, _alive: there.put(key))
        assert len({there.get(timeout=PATIENCE) for _ in range(2)}) == 2
    has_rows(process, qdgrasp.home / "mugs", 20)
    yield endpoint, process


def test_a_running_job_is_seen_and_at_its_end_all_say_the_same(qdgrasp: Commands) -> None:
    with ExitStack() as stack:
        endpoint, process = stack.enter_context(running(qdgrasp, 300))
        feed = stack.enter_context(Feed(stack.enter_context(ZenohBus.connect(endpoint, PATIENCE))))
        wait_for(lambda: [len(view.workers) for view in feed.views()] == [2], "both workers")
        with held(*pids(process, "worker")):  # so that it goes on for as long as it is looked at
            done = qdgrasp("jobs", "--json", "--connect", endpoint)
            assert (done.code, done.err) == (0, "")
            (job,) = done.json["jobs"]
            told = (job["job"], job["state"], len(job["workers"]), len(job["runs"]))
            assert told == ("mugs", "running", 2, 1)
            assert {*JobView.__struct_fields__} == {*job}
            assert {*RunStatus.__struct_fields__} == {*job["runs"][0]}
            assert {*JobStatus.__struct_fields__} == {*job["figures"]}
            assert any(event["kind"] == "worker" for event in job["events"])
            assert job["meta"]["identity"] == JobFolder.open(qdgrasp.home / "mugs").identity != ""
        end_of(process)
        wait_for(lambda: [view.state for view in feed.views()] == ["ended"], "the end")
        (view,) = feed.views()
    (run,), info = view.runs, qdgrasp.info("mugs")
    assert {name: getattr(view.figures, name) for name in COUNTS} == {name: info[name] for name in COUNTS}
    for name in (*COUNTS, "robust", "grasps", "errors", "rows"):
        assert getattr(run, name) == info[name], name
    assert sum(run.outcomes.values()) == info["rows"]
    assert run.durable == rows_recorded(qdgrasp.home / "mugs")


def _of_no_size(environment: Mapping[str, str]) -> dict[str, str]:
    """An environment without the size of another terminal: what runs tests in parallel tells its own."""
    return {name: value for name, value in environment.items() if name not in ("COLUMNS", "LINES")}


def test_ctrl_c_ends_it_and_leaves_the_terminal_as_it_was(qdgrasp: Commands) -> None:
    endpoint, (near, far) = own_endpoint(), pty.openpty()
    fcntl.ioctl(near, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))
    with ZenohBus.router(endpoint):
        process = subprocess.Popen(
            [sys.executable, "-m", MONITOR, "--connect", endpoint],
            cwd=qdgrasp.home,
            env=_of_no_size(os.environ) | {"TERM": "xterm-256color", "PYTHONIOENCODING": "utf-8"},
            stdin=far,
            stdout=far,
            stderr=far,
            start_new_session=True,
        )
        os.close(far)
        seen = b""
        while b"No job is at" not in seen:
            seen += os.read(near, 1 << 16)
        process.send_signal(signal.SIGINT)
        with suppress(OSError):  # it has closed its end
            while True:
                seen += os.read(near, 1 << 16)
        assert process.wait(PATIENCE) == 130
    os.close(near)
    assert b"\x1b[?1049l" in seen  # back from the other screen
    assert b"\x1b[?25h" in seen  # with a cursor
