"""At the end of a run everybody says the same of it: page, terminal, metrics, its folder and its journal."""

import json
import re
import resource
import subprocess
import threading
import urllib.request
from collections import deque
from contextlib import contextmanager
from typing import Any

import numpy as np
from prometheus_client.parser import text_string_to_metric_families
from tests.endpoints import own_endpoint
from tests.patience import PATIENCE
from tests.system.commands import SMALL, Commands, pids, rows_recorded, wait_for

from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_coordinator.folders.journal_format import FILE
from qdgrasp_protocol.outcome import Outcome

MONITOR = "qdgrasp_coordinator.cli.monitor"
EVALUATIONS = 120
COUNTS = ["evaluations", "budget", "rows", "trials", "simulated", "proposals", "overlaps", "dead_ends"]
COUNTS += ["successes", "grasps", "robust", "errors", "cells"]
Counts = dict[str, Any]


class Watched:
    """A run with two workers on an endpoint of its own, and those who watch it from some time on."""

    def __init__(self, qdgrasp: Commands) -> None:
        self.qdgrasp, self.folder = qdgrasp, qdgrasp.home / "run"
        self._place = ("--connect", own_endpoint(), "--wait", 60)
        spec = (*SMALL, "--evaluations", EVALUATIONS, "--workers", 2, "--batch-size", 10)
        place = ("--out", "run", "--job", "balls", "--listen", self._place[1], "--disk-wait", PATIENCE)
        self.run = qdgrasp.start("run", *spec, *place)

    def is_watched(self) -> None:
        """Start those who watch."""
        self.page = self.qdgrasp.start("--web", "127.0.0.1:0", *self._place, module=MONITOR)
        self._lines: deque[str] = deque(maxlen=1)
        self.stream = self.qdgrasp.start("--json", *self._place, module=MONITOR)
        threading.Thread(target=lambda: self._lines.extend(self.stream.stdout), daemon=True).start()
        self._address = _address(self.page)

    def fetch(self, path: str) -> str:
        with urllib.request.urlopen(f"{self._address}{path}", timeout=PATIENCE) as answer:  # noqa: S310 - our own
            return answer.read().decode()

    def look(self) -> Counts:
        """The run as `qdgrasp-monitor --once --json` shows it."""
        return _run_in(self.once("--json"))

    def once(self, *flags: str) -> str:
        """What `qdgrasp-monitor --once` prints."""
        return self.qdgrasp("--once", *flags, *self._place, entry="monitor").out

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
        written = (self.folder / f"{FILE}-wal").stat().st_size
        resource.prlimit(recorder, resource.RLIMIT_FSIZE, (written, most))
        yield
        resource.prlimit(recorder, resource.RLIMIT_FSIZE, (most, most))


def _address(page: subprocess.Popen[str]) -> str:
    for line in page.stderr:
        if found := re.search(r"http://127\.0\.0\.1:\d+", line):
            return found[0]
    raise AssertionError("the monitor says no address")


def _run_in(text: str) -> Counts:
    jobs = json.loads(text)["jobs"] if text else []
    runs = [run for job in jobs for run in job["runs"]]
    return _counts(runs[0]) if runs else {}


def _counts(told: Counts) -> Counts:
    """What is compared, of whoever tells more."""
    found = {name: told[name] for name in COUNTS}
    return found | told.get("outcomes", {})


def _in_metrics(text: str, subject: str) -> Counts:
    """The counts of the only job or run in metrics."""
    samples = [sample for one in text_string_to_metric_families(text) for sample in one.samples]
    told = {sample.name: sample.value for sample in samples}
    units = {"budget": "budget_evaluations", "cells": "cells"}
    names = {one: f"qdgrasp_{subject}_{units.get(one, f'{one}_total')}" for one in COUNTS}
    found = {one: told[name] for one, name in names.items() if name in told}
    ends = [sample for sample in samples if sample.name == "qdgrasp_run_outcomes_total"]
    return found | {sample.labels["outcome"]: sample.value for sample in ends}


def _in_journal(folder) -> Counts:
    """What the rows themselves add up to, of a run without trials."""
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


def test_at_the_end_everybody_says_the_same(qdgrasp):
    watched = Watched(qdgrasp)
    wait_for(lambda: rows_recorded(watched.folder) > 0, "rows")
    with watched.without_room():
        watched.is_watched()
        wait_for(lambda: watched.told().get("evaluations") == EVALUATIONS, "the last evaluation")
        looked, text = watched.look(), watched.once()
    out, err = watched.run.communicate(timeout=PATIENCE)
    assert watched.run.returncode == 0, err
    wait_for(lambda: watched.state() == "ended", "the end")
    wait_for(lambda: watched.streamed() == watched.told(), "the last line")
    info = _counts(qdgrasp.info("run"))
    assert looked == watched.told() == watched.streamed()
    assert looked == looked | info
    assert sum(looked[one.name.lower()] for one in Outcome) == looked["rows"]
    journal = _in_journal(watched.folder)
    assert looked == looked | journal
    metrics = watched.fetch("/metrics")
    assert _in_metrics(metrics, "run") == looked
    assert looked == looked | _in_metrics(metrics, "job")
    assert f"{info['successes']} successes in {info['cells']} cells" in out
    assert all(f"{looked[what]} {what}" in text for what in ("successes", "cells", "robust", "errors"))
    assert f"{looked['evaluations']} of {looked['budget']} evaluations" in text
