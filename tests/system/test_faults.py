"""A run ends with the same journal after the death of any process."""

import os
import signal
import subprocess
from pathlib import Path

import pytest
from tests.common import HOST, own_endpoint, wait_for
from tests.fakes.slow_link import slow_link
from tests.system.commands import (
    BUDGET,
    COORDINATOR,
    LONG,
    RECORDER,
    WORKER,
    Commands,
    end_of,
    has_rows,
    held,
    kill,
    pids,
    rows_recorded,
    stop,
)

from qdgrasp_coordinator.storage.job_folder import JobFolder
from qdgrasp_protocol.session import Endpoint
from qdgrasp_protocol.zenoh_bus import ZenohBus


def start(qdgrasp: Commands, rows: int) -> tuple[subprocess.Popen[str], Path]:
    """A run of which some rows are on disk already."""
    process = qdgrasp.start("run", *LONG, "--workers", 1, "--out", "run")
    folder = qdgrasp.home / "run"
    has_rows(process, folder, rows)
    return process, folder


def test_who_is_killed_is_started_again_and_goes_on_from_the_journal(qdgrasp, long_digest):
    process, _ = start(qdgrasp, 20)
    for role in ("coordinator", "recorder", "worker"):
        kill(pids(process, role)[0])
    _, err = end_of(process)
    assert "coordinator was killed by SIGKILL; it is started again" in err
    assert qdgrasp.digest("run") == long_digest


@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_a_stopped_run_ends_cleanly_and_can_be_resumed(qdgrasp, long_digest, number):
    process, _ = start(qdgrasp, 20)
    assert "qdgrasp resume" in stop(process, number)[1]
    qdgrasp.succeed("resume", "run", "--workers", 1)
    assert qdgrasp.digest("run") == long_digest


SPEC = f"""
gripper = "panda"
object = "tennis_ball"
population = 60
evaluations = {BUDGET}
"""


@pytest.mark.slow
def test_of_two_coordinators_and_two_recorders_of_a_job_one_of_each_goes_on(qdgrasp, long_digest):
    endpoint = own_endpoint()
    place = ("--connect", endpoint, "--job", "mugs")
    (qdgrasp.home / "mugs.toml").write_text(SPEC)
    with ZenohBus.router(endpoint):
        qdgrasp.start(*place, "--out", "run", module=RECORDER)
        old = qdgrasp.start("mugs.toml", *place, module=COORDINATOR)
        worker = qdgrasp.start(*place, module=WORKER)
        wait_for(lambda: rows_recorded(qdgrasp.home / "run") >= 20, "rows")
        with held(worker.pid):
            other = qdgrasp.start(*place, "--out", "run", module=RECORDER)
            assert "is in use by process" in end_of(other, 2)[1]
            os.kill(old.pid, signal.SIGSTOP)
        new = qdgrasp.start("mugs.toml", *place, module=COORDINATOR)
        wait_for(lambda: JobFolder(qdgrasp.home / "run").epoch == 2, "another turn")
        os.kill(old.pid, signal.SIGCONT)
        assert "Another coordinator of job 'mugs' took over (epoch 2)" in end_of(old, 3)[1]
        end_of(new)
        qdgrasp.end_all()
    assert qdgrasp.digest("run") == long_digest


@pytest.mark.slow
def test_a_worker_behind_a_long_link_that_is_cut_finishes_the_run(qdgrasp, long_digest):
    endpoint = own_endpoint()
    with slow_link(Endpoint.parse(endpoint).port, round_trip=0.6, loss=0.05) as link:
        process = qdgrasp.start("run", *LONG, "--workers", 0, "--listen", endpoint, "--out", "run")
        qdgrasp.start("--connect", f"tcp/{HOST}:{link.port}", module=WORKER)
        has_rows(process, qdgrasp.home / "run", 1)
        link.cut()
        end_of(process)
    assert link.connections > 1
    assert qdgrasp.digest("run") == long_digest


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("run/run.sqlite", "run/run.sqlite was deleted or replaced while its run was being recorded"),
        pytest.param("run", "run was deleted or moved while its job ran", marks=pytest.mark.slow),
    ],
)
def test_a_journal_or_folder_that_is_deleted_meanwhile_ends_the_run_with_a_sentence(qdgrasp, name, words):
    process, folder = start(qdgrasp, 20)
    path = qdgrasp.home / name
    path.rename(qdgrasp.home / "elsewhere")  # so that nothing is made in it while it is being deleted
    _, err = end_of(process, 2)
    assert err.splitlines()[-1].startswith(f"qdgrasp: {words}")
    assert "Traceback" not in err
    assert folder.exists() == (path != folder)


def test_a_simulator_that_cannot_be_imported_ends_the_run_with_its_error_at_once(qdgrasp):
    (qdgrasp.home / "mujoco.py").write_text("raise ImportError('libGL.so.1 is not there')")
    asked = ("run", "--gripper", "panda", "--object", "tennis_ball", "--workers", 1)
    done = qdgrasp(*asked, "--engine", "mujoco", "--out", "one", PYTHONPATH=str(qdgrasp.home))
    assert done.code == 2
    assert "The simulator does not start: ImportError: libGL.so.1 is not there" in done.err
    assert "started again" not in done.err
