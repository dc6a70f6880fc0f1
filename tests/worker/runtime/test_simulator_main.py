"""The rows that a simulator's process evaluates."""

from tests.coordinator.scheduler.fakes import Job
from tests.coordinator.scheduler.search_plans import Plan, reference
from tests.worker.runtime.crashing_simulator import COMMAND
from tests.worker.runtime.running_worker import RunningWorker

from qdgrasp_protocol.rows import Outcome
from qdgrasp_worker.evaluator import ROWS_AT_ONCE
from qdgrasp_worker.runtime.simulator_main import slices


def test_slices_cover_every_row_once():
    for n in (1, ROWS_AT_ONCE, ROWS_AT_ONCE + 1, 5 * ROWS_AT_ONCE - 1):
        assert [row for place in slices(n, ROWS_AT_ONCE) for row in range(place.start, place.stop)] == list(
            range(n)
        )


PLAN = Plan(seed=9, population=8, evaluations=32)


def test_poison_is_settled_as_an_error_and_the_journal_is_the_one_without_a_bus():
    job = Job({"run": PLAN})
    workers = [RunningWorker(job.network.session(), command=COMMAND) for _ in range(2)]
    job.service.run()
    for worker in workers:
        worker.leave()
        assert worker.ended()
    rows = job.records["run"].rows
    assert rows.tobytes() == reference(PLAN)
    errors = int((rows["outcome"] == Outcome.ERROR).sum())
    assert errors == 3
    assert sum(len(worker.simulators) for worker in workers) >= 3 * errors
