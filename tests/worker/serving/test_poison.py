"""Rows that end every simulator, from the coordinator to the journal."""

from tests.coordinator.runs.plans import Plan, reference
from tests.coordinator.serving.served import Job
from tests.worker.serving.hired import Hired
from tests.worker.serving.poisoned import COMMAND

from qdgrasp_protocol.outcome import Outcome

PLAN = Plan(seed=9, population=8, evaluations=32)


def test_poison_is_settled_as_an_error_and_the_journal_is_the_one_without_a_bus():
    job = Job({"run": PLAN})
    workers = [Hired(job.network.session(), command=COMMAND) for _ in range(2)]
    job.service.run()
    for worker in workers:
        worker.leave()
        assert worker.ended()
    rows = job.records["run"].rows
    assert rows.tobytes() == reference(PLAN)
    errors = int((rows["outcome"] == Outcome.ERROR).sum())
    assert errors == 3
    assert sum(len(worker.simulators) for worker in workers) >= 3 * errors
