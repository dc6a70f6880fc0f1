"""`qdgrasp-monitor` with real processes, and that everything counts the same at the end."""

import fcntl
import json
import os
import pty
import re
import resource
import select
import signal
import struct
import subprocess
import sys
import termios
import threading
import time
import urllib.request
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from datetime import UTC, datetime
from queue import SimpleQueue
from typing import Any

import numpy as np
import pytest
from prometheus_client.parser import text_string_to_metric_families
from tests import browser
from tests.browser import figure, number
from tests.common import PATIENCE, own_endpoint, wait_for
from tests.system.commands import (
    MONITOR,
    SMALL,
    Commands,
    Watched,
    end_of,
    has_rows,
    held,
    kill,
    pids,
    rows_recorded,
)

from qdgrasp_coordinator.metrics.job_status import JobStatus, RunStatus, WorkersPage, from_json
from qdgrasp_coordinator.scheduler.status_publisher import STATUS_INTERVAL
from qdgrasp_coordinator.storage.job_folder import JobFolder
from qdgrasp_coordinator.storage.outputs import JOURNAL
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.bus import Sample
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.rows import Outcome
from qdgrasp_protocol.zenoh_bus import ZenohBus
from qdgrasp_tools.monitor.feed import Feed
from qdgrasp_tools.monitor.job_model import JobView
from qdgrasp_tools.monitor.terminal.screen import ScreenState, report_lines
from qdgrasp_tools.monitor.terminal.text_tables import ASCII

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
    budget = (*SMALL, "--evaluations", evaluations)
    command = ("run", *budget, "--workers", 2, "--out", "run", "--job", "mugs")
    process = qdgrasp.start(*command, "--listen", endpoint)
    with ZenohBus.connect(endpoint, PATIENCE) as bus:
        bus.watch(Keys("mugs").worker_token(), lambda key, _alive: there.put(key))
        assert len({there.get(timeout=PATIENCE) for _ in range(2)}) == 2
    has_rows(process, qdgrasp.home / "run", 20)
    yield endpoint, process


def test_a_running_job_is_seen_and_at_its_end_all_say_the_same(qdgrasp: Commands) -> None:
    with ExitStack() as stack:
        endpoint, process = stack.enter_context(running(qdgrasp, 300))
        feed = stack.enter_context(Feed(stack.enter_context(ZenohBus.connect(endpoint, PATIENCE))))
        wait_for(lambda: [len(view.workers) for view in feed.views()] == [2], "both workers")
        with held(*pids(process, "worker")):  # so that it goes on for as long as it is looked at
            code, out, err = watch(qdgrasp, "--once", "--json", "--connect", endpoint)
            assert (code, err) == (0, "")
            (job,) = parsed(out)["jobs"]
            told = (job["job"], job["state"], len(job["workers"]), len(job["runs"]))
            assert told == ("mugs", "running", 2, 1)
            assert {*JobView.__struct_fields__} == {*job}
            assert {*RunStatus.__struct_fields__} == {*job["runs"][0]}
            assert {*JobStatus.__struct_fields__} == {*job["figures"]}
            assert job["curves"][job["runs"][0]["run"]]["points"]
            assert any(event["kind"] == "worker" for event in job["events"])
            assert job["meta"]["identity"] == JobFolder.open(qdgrasp.home / "run").identity != ""
            code, out, _ = watch(qdgrasp, "--once", "--connect", endpoint)
            assert (code, "mugs: running" in out, max(map(len, out.splitlines())) <= 80) == (0, True, True)
        end_of(process)
        wait_for(lambda: [view.state for view in feed.views()] == ["ended"], "the end")
        (view,) = feed.views()
    (run,), info = view.runs, qdgrasp.info("run")
    assert {name: getattr(view.figures, name) for name in COUNTS} == {name: info[name] for name in COUNTS}
    for name in (*COUNTS, "robust", "grasps", "errors", "rows"):
        assert getattr(run, name) == info[name], name
    assert sum(run.outcomes.values()) == info["rows"]
    assert run.durable == rows_recorded(qdgrasp.home / "run")
    told = "\n".join(
        line.plain for line in report_lines(ScreenState([view], endpoint, datetime.now(UTC)), 80, ASCII)
    )
    assert f"{info['evaluations']} of {info['budget']} evaluations" in told
    assert f"{info['successes']} successes" in told
    assert f"{info['cells']} cells" in told


def test_a_killed_worker_is_shown_as_gone_within_two_seconds(qdgrasp: Commands) -> None:
    """By the coordinator's own beat: it shows the job twice a second, and so less often where it is slow."""
    keys, news = Keys("mugs"), SimpleQueue[str]()

    def seen(sample: Sample) -> None:
        page = from_json(sample.payload, WorkersPage)
        news.put("gone" if any(one.state == "gone" for one in page.workers) else f"{len(page.workers)} there")

    with running(qdgrasp, ENDLESS) as (endpoint, process), ZenohBus.connect(endpoint, PATIENCE) as bus:
        bus.watch(keys.worker_token(), lambda _, alive: news.put("there" if alive else "lost"))
        bus.subscribe(keys.stat("job"), lambda _: news.put("job"))
        bus.subscribe(keys.stat("team/*"), seen)
        assert "2 there" in iter(lambda: news.get(timeout=PATIENCE), "")  # else it is killed before it joins
        kill(pids(process, "worker")[0])
        heard = list(iter(lambda: news.get(timeout=PATIENCE), "gone"))
        process.terminate()
        process.communicate(timeout=PATIENCE)
    assert "lost" in heard
    assert heard[heard.index("lost") :].count("job") <= 2.0 / STATUS_INTERVAL


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


EVALUATIONS = 120
ALL_COUNTS = ["evaluations", "budget", "rows", "trials", "simulated", "proposals", "overlaps", "dead_ends"]
ALL_COUNTS += ["successes", "grasps", "robust", "errors", "cells"]
Counts = dict[str, Any]


class CountedRun(Watched):
    """A run whose counts are read in every way."""

    def __init__(self, qdgrasp: Commands) -> None:
        spec = (*SMALL, "--evaluations", EVALUATIONS)
        super().__init__(qdgrasp, "balls", *spec)

    def is_watched(self) -> None:
        """Start the page, and a stream of JSON."""
        self._lines: deque[str] = deque(maxlen=1)
        self.stream = self.qdgrasp.start("--json", *self.place, module=MONITOR)
        threading.Thread(target=lambda: self._lines.extend(self.stream.stdout), daemon=True).start()
        super().is_watched()

    def fetch(self, path: str) -> str:
        with urllib.request.urlopen(f"{self.address}{path[1:]}", timeout=PATIENCE) as answer:  # noqa: S310 - our own
            return answer.read().decode()

    def look(self) -> Counts:
        """The run as `qdgrasp-monitor --once --json` shows it."""
        return _run_in(self.once("--json"))

    def once(self, *flags: str) -> str:
        """The output of `qdgrasp-monitor --once`."""
        return self.qdgrasp("--once", *flags, *self.place, entry="monitor").out

    def streamed(self) -> Counts:
        """The run in the last line of `qdgrasp-monitor --json`."""
        return _run_in("".join(self._lines))

    def told(self) -> Counts:
        """The run as the page's browsers are told of it."""
        return _run_in(self.fetch("/api/state"))

    def state(self) -> str:
        jobs = json.loads(self.fetch("/api/state"))["jobs"]
        return jobs[0]["state"] if jobs else ""

    @contextmanager
    def without_room(self):
        """The recorder has no room meanwhile: all that is found waits for it, and the job does not end."""
        (recorder,) = pids(self.run, "recorder")
        _, most = resource.prlimit(recorder, resource.RLIMIT_FSIZE)
        written = (self.folder / f"{JOURNAL}-wal").stat().st_size
        resource.prlimit(recorder, resource.RLIMIT_FSIZE, (written, most))
        yield
        resource.prlimit(recorder, resource.RLIMIT_FSIZE, (most, most))


def _run_in(text: str) -> Counts:
    jobs = json.loads(text)["jobs"] if text else []
    runs = [run for job in jobs for run in job["runs"]]
    return _counts(runs[0]) if runs else {}


def _counts(told: Counts) -> Counts:
    """The figures that are compared, where a source has more."""
    return {name: told[name] for name in ALL_COUNTS} | told.get("outcomes", {})


def _in_metrics(text: str, subject: str) -> Counts:
    """The counts of the only job or run in metrics."""
    samples = [sample for one in text_string_to_metric_families(text) for sample in one.samples]
    told = {sample.name: sample.value for sample in samples}
    units = {"budget": "budget_evaluations", "cells": "cells"}
    names = {one: f"qdgrasp_{subject}_{units.get(one, f'{one}_total')}" for one in ALL_COUNTS}
    found = {one: told[name] for one, name in names.items() if name in told}
    ends = [sample for sample in samples if sample.name == "qdgrasp_run_outcomes_total"]
    return found | {sample.labels["outcome"]: sample.value for sample in ends}


def _in_journal(folder) -> Counts:
    """The sums of the rows of a run without trials."""
    with RunFolder.open(folder).journal() as journal:
        rows = np.concatenate(list(journal.blocks()))
    how = rows["outcome"]
    ends = {one.name.lower(): int(np.count_nonzero(how == one)) for one in Outcome}
    found = rows["descriptor"][how >= Outcome.DROPPED, :3]
    return ends | {
        "rows": len(rows),
        "successes": len(found),
        "grasps": int(np.count_nonzero(how >= Outcome.SHAKEN)),
        "robust": int(np.count_nonzero(how >= Outcome.HELD)),
        "overlaps": ends["overlap"],
        "dead_ends": ends["dead_end"],
        "simulated": int(np.count_nonzero(how >= Outcome.MISSED)),
        "proposals": int(rows["proposals"].sum()),
        "cells": len(np.unique(np.rint(100 * found.astype(float)), axis=0)),
    }


@pytest.mark.slow
def test_at_the_end_everybody_says_the_same(qdgrasp):
    watched = CountedRun(qdgrasp)
    wait_for(lambda: rows_recorded(watched.folder) > 0, "rows")
    with watched.without_room():
        watched.is_watched()
        wait_for(lambda: watched.told().get("evaluations") == EVALUATIONS, "the last evaluation")
        looked, text = watched.look(), watched.once()
    out, _ = end_of(watched.run)
    wait_for(lambda: watched.state() == "ended", "the end")
    wait_for(lambda: watched.streamed() == watched.told(), "the last line")
    info = _counts(qdgrasp.info("run"))
    assert looked == watched.told() == watched.streamed()
    assert looked == looked | info
    assert sum(looked[one.name.lower()] for one in Outcome) == looked["rows"]
    assert looked == looked | _in_journal(watched.folder)
    metrics = watched.fetch("/metrics")
    assert _in_metrics(metrics, "run") == looked
    assert looked == looked | _in_metrics(metrics, "job")
    assert f"{info['successes']} successes in {info['cells']} cells" in out
    assert all(f"{looked[what]} {what}" in text for what in ("successes", "cells", "robust", "errors"))
    assert f"{looked['evaluations']} of {looked['budget']} evaluations" in text


GROWN = "([node, before]) => Number(node.textContent.replace(/\\D/g, '')) > before"
CELLS = re.compile(r"^[1-9]\S* cells of 1 cm")


@browser.needed
def test_the_page_shows_a_job_from_its_beginning_to_its_end_whoever_dies(qdgrasp: Commands) -> None:
    from playwright.sync_api import expect

    with browser.launched() as chromium:  # first: on a busy machine it takes as long as the job
        watched = Watched(qdgrasp, "balls", *SMALL, "--method", "contact_me_scs", "--evaluations", 400)
        watched.is_watched()
        watched.pauses(100)  # so that it is there however long a busy machine takes to draw
        visit = browser.Visit(chromium, f"{watched.address}#job=balls")
        page = visit.page
        page.evaluate("() => (window.kept = true)")
        expect(page.locator("#scene-words")).to_have_text(CELLS, timeout=browser.PATIENCE)
        done = page.locator("#done")
        rows = page.locator("#workers tbody tr")
        expect(rows).to_have_count(2, timeout=browser.PATIENCE)

        watched.kill("worker")
        expect(page.locator("#workers tr[data-state=gone]")).to_have_count(1, timeout=browser.PATIENCE)

        watched.kill("coordinator")
        expect(page.locator("#origin")).to_contain_text("epoch 2", timeout=browser.PATIENCE)
        before = number(figure(page, "Successes").inner_text())
        watched.goes_on()
        page.wait_for_function(GROWN, arg=[figure(page, "Successes").element_handle(), before])

        watched.ends()
        expect(page.locator("#state")).to_have_text(re.compile("^ended: "), timeout=browser.PATIENCE)
        expect(done).to_have_text(re.compile(r"^400 of 400\b"))
        info = qdgrasp.info("run")
        for name in ("Successes", "Cells", "Grasps", "Robust"):
            expect(figure(page, name)).to_have_text(str(info[name.lower()]))
        assert page.evaluate("() => window.kept"), "the page was loaded again"
        assert visit.complaints == []
