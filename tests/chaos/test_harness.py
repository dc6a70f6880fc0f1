"""The plan of disturbances, the processes, and the undisturbed run."""

import os
import signal
import subprocess
import sys
from itertools import islice
from pathlib import Path

import pytest
from tests.chaos import play, processes
from tests.chaos.plan import (
    HEAD,
    INTERVALS,
    RESTART_SECONDS,
    RUN_KINDS,
    STOP_SECONDS,
    FaultKind,
    RunKind,
    bad_workers,
    faults,
    first_round,
    run_kind,
)
from tests.chaos.play import disturb, undisturbed_digest
from tests.chaos.processes import ROOT, Process
from tests.chaos.simulator import BAD
from tests.common import PATIENCE, wait_for
from tests.system.commands import is_alive, kill

from qdgrasp_coordinator.scheduler.worker_registry import TOKEN_GRACE
from qdgrasp_protocol.session import BASE_SETTINGS
from qdgrasp_protocol.spec import RunSpec

WORKERS = 4
ALL = {*HEAD, *(f"worker-{number}" for number in range(WORKERS))}


def first(seed: int, number: int) -> list:
    return list(islice(faults(seed, WORKERS), number))


def test_a_plan_is_a_function_of_its_seed() -> None:
    assert first(7, 200) == first(7, 200)
    assert first(7, 200) != first(8, 200)


@pytest.mark.parametrize("seed", range(20))
def test_the_first_faults_kill_each_kind_and_stop_one(seed: int) -> None:
    begun = first(seed, first_round(WORKERS))
    killed = {fault.process.partition("-")[0] for fault in begun if fault.kind is FaultKind.KILL}
    assert killed == {"worker", *HEAD}
    assert [fault.kind for fault in begun].count(FaultKind.STOP) == 1


def test_then_every_round_kills_and_stops_all() -> None:
    after = first(3, first_round(WORKERS) + 2 * len(ALL))[first_round(WORKERS) :]
    assert {(one.process, one.kind) for one in after} == {(who, kind) for who in ALL for kind in FaultKind}


def test_faults_come_at_their_intervals_and_stop_for_longer_than_a_lease() -> None:
    for fault in first(1, 500):
        assert INTERVALS[0] <= fault.after <= INTERVALS[1]
        low, high = RESTART_SECONDS if fault.kind is FaultKind.KILL else STOP_SECONDS
        assert low <= fault.seconds <= high
    assert STOP_SECONDS[0] > BASE_SETTINGS["transport/link/tx/lease"] / 1000 + TOKEN_GRACE


def test_ten_seeds_disturb_every_kind_of_run() -> None:
    assert {run_kind(seed) for seed in range(10)} == set(RUN_KINDS)
    assert run_kind(4).spec(4, 50).protocol == "robust"


SERVER = ("http.server", ["0", "--bind", "127.0.0.1"])
"""Lives until it is ended."""
STARTER = f"""
import sys
from pathlib import Path
from tests.chaos.processes import Process
process = Process("server", *{SERVER!r}, Path(sys.argv[1]))
process.start()
print(process.pid, flush=True)
sys.stdin.read()
"""


def test_ten_seeds_have_bad_workers_of_every_kind() -> None:
    kinds = [bad_workers(seed, 2) for seed in range(10)]
    assert {kind for found in kinds for kind in found} == set(BAD)
    assert kinds == [bad_workers(seed, 2) for seed in range(10)]


@pytest.mark.parametrize("is_stopped", [False, True])
def test_a_process_ends_with_its_starter_however_that_ends(tmp_path: Path, is_stopped: bool) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", STARTER, tmp_path / "log"],
        cwd=ROOT,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as starter:
        assert starter.stdout is not None
        pid = int(starter.stdout.readline())
        if is_stopped:
            os.kill(pid, signal.SIGSTOP)
        assert is_alive(pid)
        kill(starter.pid)
    wait_for(lambda: not is_alive(pid), "the end of the orphan")


def test_a_process_is_started_again_under_the_same_name_and_heard_in_one_log(tmp_path: Path) -> None:
    process = Process("server", "platform", [], tmp_path / "log")
    for _ in range(2):
        process.start()
        assert process.wait(PATIENCE) == 0
    first, second = process.words.splitlines()
    assert first == second == process.last_words


def test_a_killed_process_is_gone_and_a_stopped_one_is_known_to_be(tmp_path: Path) -> None:
    process = Process("server", *SERVER, tmp_path / "log")
    process.start()
    process.send(signal.SIGSTOP)
    assert (process.is_there, process.is_stopped) == (True, True)
    process.send(signal.SIGKILL)
    assert (process.is_there, process.exit_code) == (False, -signal.SIGKILL)


SPEC = RunSpec(gripper="panda", object="mug")
FILES = ("worker/a/episode.py", "assets/a/grippers/panda.toml", "assets/a/mug.obj", "assets/a/hand.urdf")


@pytest.fixture
def key(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setattr(play, "ROOT", tmp_path)
    for name in FILES:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(name)
    return play._key(SPEC)


@pytest.mark.parametrize("name", FILES)
def test_it_depends_on_every_file_of_the_packages(tmp_path: Path, key: str, name: str) -> None:
    (tmp_path / name).write_text("something else")
    assert play._key(SPEC) != key


def test_it_depends_on_where_a_file_is_and_not_on_what_python_writes(tmp_path: Path, key: str) -> None:
    (tmp_path / "worker" / "__pycache__").mkdir()
    (tmp_path / "worker" / "__pycache__" / "episode.pyc").touch()
    assert play._key(SPEC) == key
    (tmp_path / FILES[0]).rename(tmp_path / "worker" / "episode.py")
    assert play._key(SPEC) != key


def test_the_built_in_hands_and_objects_are_among_these_files() -> None:
    kinds = {file.suffix for file in play.package_files(processes.ROOT)}
    assert {".py", ".toml", ".urdf"} <= kinds


SEED = 4
EVALUATIONS = 300
CHAOS_WORKERS = 4
SHORT_INTERVALS = (0.8, 1.6)
ROW_SECONDS = CHAOS_WORKERS * first_round(CHAOS_WORKERS) * SHORT_INTERVALS[1] / EVALUATIONS
"""So slow that the run is not over before the first round of faults is."""
RUN_KIND = RunKind("contact_rand", "paper", 60, ROW_SECONDS)


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_disturbed_run_gives_what_an_undisturbed_one_gives(tmp_path: Path, undisturbed: Path) -> None:
    spec = RUN_KIND.spec(SEED, EVALUATIONS)
    expected = undisturbed_digest(spec, undisturbed)
    plan = islice(faults(SEED, CHAOS_WORKERS, SHORT_INTERVALS), first_round(CHAOS_WORKERS))
    report = disturb(
        tmp_path / "run", spec, plan, workers=CHAOS_WORKERS, row_seconds=ROW_SECONDS, limit=300, say=print
    )
    assert report.troubles == []
    assert {(kind, FaultKind.KILL) for kind in ("worker", *HEAD)} <= set(report.injected)
    assert any(kind is FaultKind.STOP for _, kind in report.injected)
    assert report.digest == expected
