"""Measures a campaign of many runs: `python -m benchmarks.scale.campaign --runs 2000`.

`qdgrasp campaign` is the real one, with its coordinator and its recorder; the workers are stand-ins that
answer at once. Every run has its journal. One scene serves many runs, so that few are built. CPU times hold
on a busy machine, rates and seconds only on a quiet one.
"""

import argparse
import json
import logging
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from math import ceil
from pathlib import Path
from typing import Any

import tomli_w
from benchmarks.measure import machine
from benchmarks.scale.rig import (
    CallTimer,
    ScaleFigure,
    StandInGroup,
    StandInWorker,
    resident,
    start_stand_ins,
    table,
)
from rich.console import Console

from qdgrasp_assets.catalog import object_names
from qdgrasp_coordinator.metrics.job_status import JobStatus, from_json
from qdgrasp_coordinator.scheduler.run_plan import full_spec, prepare_scene, row_shape
from qdgrasp_coordinator.search.registry import prior_of
from qdgrasp_coordinator.storage.job_folder import JobFolder
from qdgrasp_protocol.bus import Sample
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.process import Stop, configure_logging
from qdgrasp_protocol.spec import DEFAULT_METHOD
from qdgrasp_protocol.zenoh_bus import ZenohBus

JOB = "campaign"
GRIPPER = "panda"
OBJECTS = tuple(name for name in object_names() if not name.startswith("ycb_"))
MEMORY_SHARES = (0.1, 0.5, 1.0)
"""Shares of the runs at whose end memory is read."""
UNFINISHED = 8
"""Runs that a restart finds unfinished."""
INTERVAL = 0.05
"""Seconds between two readings of the processes."""
UNCHECKED = ("--checked", "0")
"""Options of a job whose workers are stand-ins, whose results never agree."""
NAMES = ("coordinator", "recorder")
"""Names of processes, as in their command lines and titles."""


@dataclass(frozen=True)
class CampaignSize:
    """A campaign and its workers."""

    runs: int
    evaluations: int
    method: str
    workers: int
    row_seconds: float
    """Reported cost of an evaluation [CPU s]."""

    def source(self) -> dict[str, Any]:
        """The content of the campaign's file; at least so many runs as are asked for."""
        objects = list(OBJECTS[: max(1, min(len(OBJECTS), self.runs // UNFINISHED))])
        cross = {"gripper": GRIPPER, "object": objects, "method": self.method}
        seeds = list(range(ceil(self.runs / len(objects))))
        return {"defaults": {"evaluations": self.evaluations}, "cross": [cross | {"seed": seeds}]}


@dataclass
class ProcessUsage:
    """Memory and CPU time of a process when they were read last."""

    pid: int
    cpu: float = 0.0
    """CPU time [s]."""
    memory: list[int] = field(default_factory=list)
    """Memory at the `MEMORY_SHARES` that are over [bytes]."""

    def update(self) -> None:
        with suppress(OSError):  # it has ended
            user, system = Path(f"/proc/{self.pid}/stat").read_text().rpartition(")")[2].split()[11:13]
            self.cpu = (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")


@dataclass
class CommandMeasurement:
    """Measurements of a command that carries the campaign out."""

    began: float
    processes: dict[str, ProcessUsage]
    first_lease: float = 0.0
    """Seconds from the command to the first batch at a worker."""
    first_end: float = 0.0
    last_end: float = 0.0
    """Seconds to the end of the first run that it carried out, and of the last one."""
    seconds: float = 0.0
    """Seconds to its end."""


class FirstLease(StandInWorker):
    """A stand-in that reports its first batch."""

    def __init__(self, group: StandInGroup) -> None:
        super().__init__(0, group, CallTimer().later)
        self.at: Future[float] = Future()

    def _take(self, sample: Sample) -> None:
        if not self.at.done():
            self.at.set_result(time.monotonic())
        super()._take(sample)


def carry_out(command: list[str], folder: Path, size: CampaignSize, runs: int) -> CommandMeasurement:
    """Carry out a campaign of so many runs with stand-ins, and measure its processes."""
    spec = full_spec({"gripper": GRIPPER, "object": OBJECTS[0], "method": size.method})
    shape = row_shape(prepare_scene(spec).scene, prior_of(spec))
    (folder / "endpoint").unlink(missing_ok=True)
    started = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    measured = CommandMeasurement(time.monotonic(), {"campaign": ProcessUsage(started.pid)})
    try:
        while not (folder / "endpoint").is_file():
            _update_usage(measured, started)
            time.sleep(INTERVAL)
        endpoint = (folder / "endpoint").read_text().strip()
        group = StandInGroup(
            endpoint, JOB, size.workers, row_seconds=size.row_seconds, shape=shape, variety=4
        )
        first = FirstLease(group)
        with start_stand_ins([group]) as stand_ins, _status(endpoint) as latest:
            first.join()
            stand_ins.join()
            _follow(measured, started, latest, runs)
        measured.first_lease = first.at.result(1.0) - measured.began
    finally:
        if started.poll() is None:
            started.terminate()
        words = started.communicate()[1].decode()
    measured.seconds = time.monotonic() - measured.began
    if started.returncode:
        raise SystemExit(f"the campaign ended with exit code {started.returncode}: {words[-2000:]}")
    first.close()
    return measured


def _follow(
    measured: CommandMeasurement,
    started: "subprocess.Popen[bytes]",
    latest: Callable[[], JobStatus | None],
    runs: int,
) -> None:
    """Read the usage of the processes until the command ends."""
    before = None
    shares = list(MEMORY_SHARES)
    while started.poll() is None:
        _update_usage(measured, started)
        if status := latest():
            now = time.monotonic() - measured.began
            before = status.runs_done if before is None else before
            if not measured.first_end and status.runs_done > before:
                measured.first_end = now
            if shares and status.runs_done >= shares[0] * runs:
                shares.pop(0)
                for process in measured.processes.values():
                    process.memory.append(resident(process.pid))
            if status.runs_done >= runs and not measured.last_end:
                measured.last_end = now
        time.sleep(INTERVAL)


def _update_usage(measured: CommandMeasurement, started: "subprocess.Popen[bytes]") -> None:
    if started.poll() not in (None, 0):
        return
    with suppress(OSError):
        for task in Path(f"/proc/{started.pid}/task").iterdir():
            for child in (task / "children").read_text().split():
                words = Path(f"/proc/{child}/cmdline").read_text()
                for name in NAMES:
                    if name in words.split("\0", 4)[0] or f".{name}_process" in words:
                        measured.processes.setdefault(name, ProcessUsage(int(child)))
    for process in measured.processes.values():
        process.update()


@contextmanager
def _status(endpoint: str) -> Iterator[Callable[[], JobStatus | None]]:
    """The latest status of the job."""
    seen: list[JobStatus] = []

    def take(sample: Sample) -> None:
        seen[:] = [from_json(sample.payload, JobStatus)]

    with (
        ZenohBus.connect(endpoint, 10.0, Stop()) as bus,
        bus.subscribe(Keys(JOB).stat("job"), take),
    ):
        yield lambda: seen[0] if seen else None


def measure(size: CampaignSize, home: Path) -> Iterator[ScaleFigure]:
    """Carry a campaign out in a folder below `home`, go on with it, and measure its folder."""
    file, folder = home / "campaign.toml", home / JOB
    source = size.source()
    (cross,) = source["cross"]
    runs = len(cross["object"]) * len(cross["seed"])
    file.write_text(tomli_w.dumps(source))
    command = [str(Path(sys.executable).parent / "qdgrasp"), "campaign"]
    rows = runs * size.evaluations
    stand_ins = ["--workers", "0", *UNCHECKED]
    measured = carry_out([*command, str(file), "--out", str(folder), *stand_ins], folder, size, runs)
    yield ScaleFigure("runs", runs, "", remark=f"{size.evaluations} evaluations each, {size.method}")
    yield ScaleFigure("from the command to the first batch", measured.first_lease, "s")
    busy = measured.last_end - measured.first_end
    rate = runs / busy if busy > 0 else 0.0
    yield ScaleFigure("runs a second, opened to finished", rate, "/s")
    yield ScaleFigure("from the last run's end to the command's", measured.seconds - measured.last_end, "s")
    yield from _of_processes(measured, runs, rows, size)
    yield from _of_folder(folder, runs, command[0])
    for path in sorted((folder / "runs").iterdir())[-UNFINISHED:]:
        shutil.rmtree(path)
    again = carry_out([*command, str(folder), *stand_ins], folder, size, runs)
    yield ScaleFigure(f"restart with {UNFINISHED} runs left, to the first batch", again.first_lease, "s")
    cpu = sum(process.cpu for process in again.processes.values())
    yield ScaleFigure("CPU of that restart, with those runs", cpu, "s")
    began = time.monotonic()
    shutil.rmtree(folder)
    yield ScaleFigure("delete the folder", time.monotonic() - began, "s")


def _of_processes(
    measured: CommandMeasurement, runs: int, rows: int, size: CampaignSize
) -> Iterator[ScaleFigure]:
    for name, process in measured.processes.items():
        remark = f"{1e6 * process.cpu / rows:.0f} us an evaluation, {process.cpu:.1f} s in all"
        yield ScaleFigure(f"CPU of a run, {name}", 1000 * process.cpu / runs, "ms", remark=remark)
        memory = " ".join(f"{number / 1e6:.0f}" for number in process.memory)
        shares = ", ".join(f"{share:.0%}" for share in MEMORY_SHARES)
        yield ScaleFigure(
            f"memory at the end, {name}", process.memory[-1] / 1e6, "MB", remark=f"{memory} MB at {shares}"
        )
    head = sum(process.cpu for process in measured.processes.values())
    share = 100 * head / (head + rows * size.row_seconds)
    remark = f"where an evaluation takes a worker {1000 * size.row_seconds:g} ms"
    yield ScaleFigure("CPU of the head, of all", share, "%", most=10.0, remark=remark)


def _of_folder(folder: Path, runs: int, program: str) -> Iterator[ScaleFigure]:
    stats = [path.stat() for path in folder.rglob("*") if path.is_file()]
    yield ScaleFigure("files of a run", len(stats) / runs, "", remark=f"{len(stats)} in all")
    blocks = sum(512 * stat.st_blocks for stat in stats)
    size = sum(stat.st_size for stat in stats)
    yield ScaleFigure("bytes of a run on the disk", blocks / runs / 1000, "kB", remark=f"{size / 1e6:.0f} MB")
    copy = folder.with_name("copy")
    for name, words in {
        f"qdgrasp info {folder.name}": [program, "info", str(folder)],
        "ls of the runs": ["ls", "-l", str(folder / "runs")],
        "cp -r": ["cp", "-r", str(folder), str(copy)],
        "rm -r of the copy": ["rm", "-r", str(copy)],
    }.items():
        began = time.monotonic()
        subprocess.run(words, stdout=subprocess.DEVNULL, check=True)
        yield ScaleFigure(name, time.monotonic() - began, "s")
    assert JobFolder.is_job(folder)


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.scale.campaign", description=__doc__)
    parser.add_argument("--runs", type=int, default=1000, help="least number of runs (default: 1000)")
    parser.add_argument("--evaluations", type=int, default=200, help="of each run (default: 200)")
    parser.add_argument("--method", default=DEFAULT_METHOD, help=f"default: {DEFAULT_METHOD}")
    parser.add_argument("--workers", type=int, default=16, help="stand-ins (default: 16)")
    parser.add_argument("--row-seconds", type=float, default=0.015, help="of an evaluation (default: 0.015)")
    parser.add_argument("--home", type=Path, help="where the folder is made (default: a temporary folder)")
    parser.add_argument("--out", type=Path, help="a JSON file for the figures")
    asked = parser.parse_args()
    configure_logging("scale", level=logging.WARNING)
    size = CampaignSize(asked.runs, asked.evaluations, asked.method, asked.workers, asked.row_seconds)
    with tempfile.TemporaryDirectory(dir=asked.home, prefix="scale-") as home:
        found = list(measure(size, Path(home)))
    Console(stderr=True, width=150).print(table("campaign", found))
    if asked.out:
        date = datetime.now(UTC).isoformat(timespec="seconds")
        figures = [figure.as_dict() for figure in found]
        text = json.dumps({"date": date, "machine": machine(), "figures": figures}, indent=1)
        asked.out.write_text(text + "\n")
    return int(any(figure.is_met is False for figure in found))


if __name__ == "__main__":
    sys.exit(main())
