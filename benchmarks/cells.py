"""Cost of a monitor's first reading of a run with many cells, its recorder above all.

`python -m benchmarks.cells` writes a journal by hand, has a real recorder answer for it at a router of
its own, reads it as `qdgrasp-monitor --web` does, twice, and prints a line of JSON. The coordinator has no
part in it. Seconds on the wall say little where something else runs; those of the processors hold.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
from benchmarks.scale.rig import router
from benchmarks.view import archive
from tests.coordinator.recorded_runs import SHAPE, record
from tests.coordinator.scenes import made_scene

from qdgrasp_coordinator.storage.journal_slice import JournalSlice
from qdgrasp_coordinator.storage.journal_writer import JournalWriter
from qdgrasp_protocol.errors import NoReply
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.rows import Outcome, Rows
from qdgrasp_protocol.zenoh_bus import ZenohBus
from qdgrasp_tools.monitor.records import BusRecords
from qdgrasp_tools.monitor.web.run_cache import RunCaches
from qdgrasp_tools.monitor.web.scene_data import HEADER

ROWS = 4
"""Rows of the journal for each success."""
POPULATION = 100
COMMIT = 2000
"""Rows in a transaction."""
TICKS = os.sysconf("SC_CLK_TCK")
READS = 2
WAIT = 30.0  # seconds until a recorder is there


def journal(cells: int) -> Rows:
    """Rows with one find in each of so many cells, and three misses before it."""
    found, rows = archive(cells), SHAPE.empty(ROWS * cells)
    rows["generation"], rows["index"] = np.divmod(np.arange(len(rows)), POPULATION)
    rows["outcome"], rows["base_to_object"][:, 6] = Outcome.MISSED, 1
    for column in ("outcome", "fitness", "base_to_object"):
        rows[column][ROWS - 1 :: ROWS] = found[column]
    rows["descriptor"][ROWS - 1 :: ROWS] = found["descriptor"]
    return rows


def recorded(path: Path, rows: Rows) -> Path:
    """The folder of a run with these rows, which were committed as they are while a run goes on."""
    folder = record(path, made_scene(), rows[:0], evaluations=10**7, population=POPULATION)
    with JournalWriter.open(path) as writer:
        for first in range(0, len(rows), COMMIT):
            writer.append(JournalSlice(first, rows[first : first + COMMIT]), 1, 1.0)
    return folder.path


@contextmanager
def recording(folder: Path, endpoint: str) -> Iterator[int]:
    """A recorder of a folder; gives its process id once it is there."""
    command = [sys.executable, "-m", "qdgrasp_tools.cli.recorder_process", "--connect", endpoint]
    with subprocess.Popen([*command, "--job", folder.name, "--out", str(folder)]) as process:
        try:
            with ZenohBus.connect(endpoint, WAIT) as bus:
                seen: list[bool] = []
                bus.watch(Keys(folder.name).recorder_token(), lambda _key, alive: seen.append(alive))
                until = time.monotonic() + WAIT
                while not seen and time.monotonic() < until:
                    time.sleep(0.05)
            yield process.pid
        finally:
            process.terminate()


def cpu(pid: int) -> float:
    """Seconds that a process has had of the processors."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS


def memory(pid: int) -> float:
    """The most memory that a process has had [MiB]."""
    (line,) = [
        line for line in Path(f"/proc/{pid}/status").read_text().splitlines() if line.startswith("VmHWM")
    ]
    return int(line.split()[1]) / 1024


def read_cells(bus: ZenohBus, job: str, recorder: int) -> dict[str, float]:
    """Read all cells of the run, as the page's server does for all of its browsers."""
    caches, since, whole, sent, pages = RunCaches(BusRecords(bus)), 0, 0, 0, 0
    began, ours, theirs = time.perf_counter(), time.process_time(), cpu(recorder)
    is_more = True
    while is_more:
        page = caches.run(job, "run").cells(since)
        _, _, since, is_more, whole, _ = HEADER.unpack_from(page)
        sent, pages = sent + len(page), pages + 1
    return {
        "cells": whole,
        "wall_seconds": round(time.perf_counter() - began, 2),
        "recorder_cpu_seconds": round(cpu(recorder) - theirs, 2),
        "monitor_cpu_seconds": round(time.process_time() - ours, 2),
        "pages": pages,
        "megabytes_for_a_browser": round(sent / 1e6, 2),
    }


def list_runs(bus: ZenohBus, job: str, recorder: int) -> dict[str, float]:
    """Ask which runs there are until all are counted, and once more."""
    records, found = BusRecords(bus), {}
    for name in ("first", "again"):
        before = cpu(recorder)
        is_counted = False
        while not is_counted:
            with suppress(NoReply):  # the recorder takes longer than the timeout
                is_counted = not records.entries(job).uncounted
        found[name] = round(cpu(recorder) - before, 2)
    return found


def main() -> None:
    """Measure, and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cells", type=int, default=100_000)
    cells = parser.parse_args().cells
    with tempfile.TemporaryDirectory() as place, router() as (endpoint, _):
        folder = recorded(Path(place) / "mug", journal(cells))
        with recording(folder, endpoint) as recorder, ZenohBus.connect(endpoint, WAIT) as bus:
            found = {
                "rows": ROWS * cells,
                "looks": [read_cells(bus, folder.name, recorder) for _ in range(READS)],
                "list_recorder_cpu_seconds": list_runs(bus, folder.name, recorder),
                "recorder_megabytes": round(memory(recorder)),
            }
    print(json.dumps({"cells": cells, **found, "cpus": os.cpu_count(), "load": os.getloadavg()[0]}))


if __name__ == "__main__":
    main()
