"""A simulator's process: the rows that it evaluates, and its limits on itself."""

import os
import subprocess
import sys

from tests.coordinator.scheduler.search_plans import Plan, reference
from tests.fakes.job import Job
from tests.fakes.worker import RunningWorker
from tests.worker.runtime.crashing_simulator import COMMAND

from qdgrasp_protocol.rows import Outcome

PLAN = Plan(seed=9, population=8, evaluations=32)


def test_poison_is_settled_as_an_error_and_the_journal_is_the_one_without_a_bus():
    job = Job({"run": PLAN})
    workers = [RunningWorker(job.network.session(), command=COMMAND) for _ in range(2)]
    job.service.run()
    for worker in workers:
        worker.leave()
        worker.ends()
    rows = job.records["run"].rows
    assert rows.tobytes() == reference(PLAN)
    errors = int((rows["outcome"] == Outcome.ERROR).sum())
    assert errors == 3
    assert sum(len(worker.simulators) for worker in workers) >= 3 * errors


STAND_BACK = """
import os, time
from qdgrasp_assets.process_limits import AUTOGROUP, lower_priority
lower_priority(7)
while AUTOGROUP.exists() and not AUTOGROUP.read_text().endswith("nice 7\\n"):
    time.sleep(0.01)
print(os.nice(0))
"""


LIMIT = """
from qdgrasp_assets.process_limits import limit_memory
limit_memory(400_000_000)
try:
    bytearray(500_000_000)
except MemoryError:
    print("refused")
"""


def printed(script: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, start_new_session=True
    )
    return done.stdout.strip()


def test_it_stands_back_in_its_session_and_as_a_session():
    assert printed(STAND_BACK) == str(os.nice(0) + 7)


def test_it_may_not_ask_for_more_memory_than_was_granted():
    assert printed(LIMIT) == "refused"
