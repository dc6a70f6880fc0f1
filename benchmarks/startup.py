"""Times of a worker from the start of its process to its first result, by stage.

`python -m benchmarks.startup [--rounds N] [--scene GRIPPER OBJECT PRIOR]`. Each round is a fresh
process with an empty cache: it joins, fetches the scene and evaluates the four rows of a first batch. This
process is the other end of the bus.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from queue import SimpleQueue
from statistics import median

import numpy as np
from benchmarks.measure import Figure

from qdgrasp_assets.catalog import build_scene
from qdgrasp_assets.genes import layout
from qdgrasp_assets.scene import Bundle, Scene, pack_scene
from qdgrasp_protocol import bundle_transfer, messages
from qdgrasp_protocol.bus import Query, Sample
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.messages import Join, Joined, Result, Work
from qdgrasp_protocol.process import SUPERVISED
from qdgrasp_protocol.rows import RowShape, pack
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_protocol.zenoh_bus import ZenohBus
from qdgrasp_worker.runtime.simulator_main import WORK_COLUMNS

STAGES = ("joins", "asks for the scene", "answers")
"""First actions of the worker, in this order."""
SCENES = (("panda", "rubiks_cube", "contact"), ("panda", "mug", "valued"), ("shadow", "mug", "valued"))
ROWS = 4
"""Rows of a first batch, whose cost is not known yet."""
JOB, EPOCH = "startup", 1
PATIENCE = 60.0  # s
TICKS = os.sysconf("SC_CLK_TCK")
ROUNDS = 3
COMMANDS = {
    "qdgrasp --help": ["--help"],
    "a run of four evaluations": ["run", "--object=mug", "--gripper=panda", "--evaluations=4", "--workers=1"],
}


@dataclass(frozen=True)
class StageTime:
    """When a stage was reached, since the start of the process."""

    wall: float
    """[s]."""
    cpu: float
    """CPU seconds of the worker and its simulator, of all their threads; to 10 ms."""


StageTimes = dict[str, StageTime]
"""The time of each stage."""


@dataclass
class StandInCoordinator:
    """The other end of the bus: answers one worker as a coordinator does."""

    scene: Scene
    bundle: Bundle
    prior: str
    seen: SimpleQueue[str] = field(default_factory=SimpleQueue)
    """The stages reached, in order."""
    joined: SimpleQueue[Join] = field(default_factory=SimpleQueue)

    def join(self, query: Query) -> bytes:
        """Let the worker in."""
        self.seen.put(STAGES[0])
        self.joined.put(messages.decode(query.payload, Join))
        return messages.encode(Joined(epoch=EPOCH, drop=[]))

    def asset(self, query: Query) -> bytes:
        """Hand out the scene."""
        if query.parameters == "i=0":
            self.seen.put(STAGES[1])
        return bundle_transfer.answer_chunk(query, self.bundle.payload, self.bundle.digest)

    def result(self, sample: Sample) -> None:
        """Take the first result."""
        found = messages.decode(sample.payload, Result)
        assert (found.n, found.failures) == (ROWS, [])
        self.seen.put(STAGES[2])

    def work(self, join: Join) -> Work:
        """A first batch, of random genomes."""
        genes = len(layout(self.scene, self.prior))
        rows = RowShape(genes, joints=0).empty(ROWS)
        rows["genome"] = np.random.default_rng(0).uniform(-1.0, 1.0, (ROWS, genes))
        return Work(
            epoch=EPOCH,
            run="run",
            scene=self.bundle.digest,
            prior=self.prior,
            generation=0,
            batch=bytes(16),
            attempt=0,
            join=join.number,
            n=ROWS,
            genes=genes,
            columns=pack(rows, WORK_COLUMNS),
        )


def first_result(gripper: str, thing: str, prior: str) -> StageTimes:
    """Start a worker and follow it to its first result."""
    scene = build_scene(RunSpec(gripper=gripper, object=thing))
    coordinator = StandInCoordinator(scene, pack_scene(scene), prior)
    keys, (bus, endpoint) = Keys(JOB), ZenohBus.embedded(None)
    with ExitStack() as stack:
        stack.enter_context(bus)
        stack.enter_context(bus.answer(keys.join, coordinator.join))
        stack.enter_context(bus.answer(keys.asset(), coordinator.asset))
        stack.enter_context(bus.subscribe(keys.result(), coordinator.result))
        stack.enter_context(bus.token(keys.coordinator_token(EPOCH)))
        cache = stack.enter_context(tempfile.TemporaryDirectory())
        began = time.perf_counter()
        process = stack.enter_context(started(endpoint, cache))
        times: StageTimes = {}
        while len(times) < len(STAGES):
            stage = coordinator.seen.get(timeout=PATIENCE)
            times[stage] = StageTime(time.perf_counter() - began, cpu_seconds(process.pid))
            if stage == STAGES[0]:
                join = coordinator.joined.get()
                bus.put(
                    keys.work(join.wid),
                    messages.encode(coordinator.work(join)),
                    encoding=messages.encoding(Work),
                )
        return times


@contextmanager
def started(endpoint: str, cache: str) -> Iterator[subprocess.Popen[bytes]]:
    """A worker that ends with this process."""
    command = [sys.executable, "-m", "qdgrasp_worker.cli", "--connect", endpoint, "--cache", cache]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stderr=subprocess.DEVNULL, env={**os.environ, SUPERVISED: "1"}
    ) as process:
        try:
            yield process
        finally:
            process.terminate()


def cpu_seconds(pid: int) -> float:
    """CPU seconds of a process and of those it started."""
    user, system = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[11:13]
    started = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    return (int(user) + int(system)) / TICKS + sum(cpu_seconds(int(child)) for child in started)


def median_times(rounds: list[StageTimes]) -> StageTimes:
    """The medians of each stage."""
    return {
        stage: StageTime(
            median(times[stage].wall for times in rounds), median(times[stage].cpu for times in rounds)
        )
        for stage in STAGES
    }


def command(arguments: list[str]) -> StageTime:
    """Time of `qdgrasp` with these arguments, from start to end, with all its processes."""
    with tempfile.TemporaryDirectory() as folder:
        before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        subprocess.run(
            [sys.executable, "-m", "qdgrasp", *arguments], cwd=folder, check=True, capture_output=True
        )
        after, passed = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter() - began
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return StageTime(passed, cpu)


def measure(seconds: float) -> list[Figure]:
    """The lines of `make bench`; `seconds` plays no role: it takes what it takes, three times."""
    lines = [_worker(*scene) for scene in SCENES]
    return [figure for line in lines for figure in line] + [_command(name) for name in COMMANDS]


def _worker(gripper: str, thing: str, prior: str) -> Iterator[Figure]:
    times = median_times([first_result(gripper, thing, prior) for _ in range(ROUNDS)])
    for clock in ("wall", "cpu"):
        *on_the_way, end = (getattr(times[stage], clock) for stage in STAGES)
        remark = f"{clock}; " + ", ".join(
            f"{stage} after {at:.2f} s" for stage, at in zip(STAGES, on_the_way, strict=False)
        )
        name = f"start-up of a worker to its first result, {gripper} {thing} {prior}"
        yield Figure(name, 1, end, clock, remark)


def _command(name: str) -> Figure:
    taken = [command(COMMANDS[name]) for _ in range(ROUNDS)]
    wall, cpu = median(each.wall for each in taken), median(each.cpu for each in taken)
    return Figure(name, 1, cpu, "cpu", f"{wall:.2f} s of wall time")


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.startup", description=__doc__)
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument("--scene", nargs=3, metavar=("GRIPPER", "OBJECT", "PRIOR"), default=SCENES[0])
    asked = parser.parse_args()
    times = median_times([first_result(*asked.scene) for _ in range(asked.rounds)])
    values = {
        stage: {"wall": time_of_stage.wall, "cpu": time_of_stage.cpu}
        for stage, time_of_stage in times.items()
    }
    sys.stdout.write(json.dumps(values, indent=1) + "\n")


if __name__ == "__main__":
    main()
