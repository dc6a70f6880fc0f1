"""Supervision of child processes: restarts by a simulated clock, and the end of real processes."""

import subprocess

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.common import PATIENCE

from qdgrasp_protocol.process import (
    MOST_DEATHS,
    MOST_OUTSIDE_DEATHS,
    ProcessExit,
    ProcessSupervisor,
    RestartPolicy,
)
from qdgrasp_protocol.session import SECURITY_VARIABLE

SLEEP = "import time; time.sleep(600)"


@given(st.lists(st.tuples(st.floats(0, 100), st.booleans(), st.booleans()), max_size=60))
def test_a_process_is_given_up_only_after_a_row_of_short_lives_without_progress(lives) -> None:
    policy, now, row = RestartPolicy(steady=60.0), 0.0, 0
    for seconds, has_progress, is_from_outside in lives:
        policy.on_start(now)
        if has_progress:
            policy.on_progress()
        row = 1 if has_progress or now + seconds - now >= 60.0 else row + 1
        now += seconds
        pause = policy.on_death(now, is_from_outside=is_from_outside)
        assert policy.deaths == row
        assert (pause is None) == (row > (MOST_OUTSIDE_DEATHS if is_from_outside else MOST_DEATHS))
        if pause is None:
            return
        now += pause


@pytest.fixture
def processes(tmp_path):
    with ProcessSupervisor(tmp_path / "logs") as processes:
        yield processes


def start(processes: ProcessSupervisor, code: str, name: str = "started") -> subprocess.Popen[bytes]:
    """Start a process that executes some code."""
    processes.start(name, "timeit", lambda: ["-n1", "-r1", code])
    return processes.process(name)


def test_a_death_is_reported_once_with_its_exit_code(processes):
    start(processes, "import os; os._exit(3)", "sleeper").wait(PATIENCE)
    assert not processes.is_dead("sleeper")
    assert processes.exits() == [ProcessExit("sleeper", 3)]
    assert processes.exits() == []
    assert processes.is_dead("sleeper")


def test_a_killed_process_is_started_again_after_its_pause_with_new_arguments(processes):
    codes = iter([SLEEP, "import os; os._exit(4)"])
    processes.start("sleeper", "timeit", lambda: ["-n1", "-r1", next(codes)])
    processes.process("sleeper").kill()
    processes.process("sleeper").wait(PATIENCE)
    (death,) = processes.exits()
    assert death.description == "was killed by SIGKILL"
    pause = processes.restart_later(death, now=100.0)
    processes.restart_due(100.0 + pause - 0.01)
    assert processes.pids() == {}
    processes.restart_due(100.0 + pause)
    assert processes.process("sleeper").wait(PATIENCE) == 4


def test_a_process_takes_no_certificates_but_those_that_it_is_given(processes, monkeypatch):
    monkeypatch.setenv(SECURITY_VARIABLE, "security")
    asked = start(processes, f"import os; os._exit(5 if {SECURITY_VARIABLE!r} in os.environ else 4)")
    assert asked.wait(PATIENCE) == 4


def test_leaving_ends_everybody_by_force_if_need_be(tmp_path):
    stubborn = "import signal, time; signal.signal(15, signal.SIG_IGN); print(1, flush=True); time.sleep(600)"
    with ProcessSupervisor(tmp_path) as processes:
        process = start(processes, stubborn)
    assert process.poll() is not None


def test_the_words_of_a_death_are_the_sentence_that_this_process_ended_with(processes, tmp_path):
    mark = str(tmp_path / "mark")
    said = r"os.write(1, b'qdgrasp-x: a: b\nqdgrasp-x: at: last\n12:00 [x]\n')"
    talk = f"import os; os.path.exists({mark!r}) or {said}; open({mark!r}, 'w'); os._exit(2)"
    start(processes, talk, "talker").wait(PATIENCE)
    (death,) = processes.exits()
    assert death.words == "at: last"
    processes.restart_due(processes.restart_later(death, now=0.0))
    processes.process("talker").wait(PATIENCE)
    assert processes.exits() == [ProcessExit("talker", 2, "")]
