"""Limits that a simulator's process imposes on itself."""

import os
import subprocess
import sys

from qdgrasp_worker.runtime.process_limits import CPU_LIMIT_SIGNAL

STAND_BACK = """
import os, time
from qdgrasp_worker.runtime.process_limits import AUTOGROUP, lower_priority
lower_priority(7)
while AUTOGROUP.exists() and not AUTOGROUP.read_text().endswith("nice 7\\n"):
    time.sleep(0.01)
print(os.nice(0))
"""
LIMIT = """
from qdgrasp_worker.runtime.process_limits import limit_memory
limit_memory(400_000_000)
try:
    bytearray(500_000_000)
except MemoryError:
    print("refused")
"""
HEED = """
import os, signal
from qdgrasp_worker.runtime.process_limits import end_with_parent_only
end_with_parent_only()
for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
    os.kill(os.getpid(), number)
print("here")
"""
TAKE_TIME = """
from qdgrasp_worker.runtime.process_limits import time_limit
with time_limit(0.2):
    sum(range(10**12))
"""


def said(script: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, start_new_session=True
    )
    return done.stdout.strip()


def test_it_stands_back_in_its_session_and_as_a_session():
    assert said(STAND_BACK) == str(os.nice(0) + 7)


def test_it_may_not_ask_for_more_memory_than_was_granted():
    assert said(LIMIT) == "refused"


def test_what_is_meant_for_a_group_does_not_end_it():
    assert said(HEED) == "here"


def test_what_takes_too_long_ends_it_also_inside_of_a_call():
    done = subprocess.run([sys.executable, "-c", TAKE_TIME], check=False)
    assert -done.returncode == CPU_LIMIT_SIGNAL
