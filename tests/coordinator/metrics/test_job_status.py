"""Published status, as it travels."""

import pytest
from tests.tools.monitor.sample_jobs import figures, run, team, worker

from qdgrasp_coordinator.metrics import job_status
from qdgrasp_protocol.errors import MessageError


@pytest.mark.parametrize(
    "shown",
    [
        figures(evaluations=-1),
        figures(seconds=1e20),
        figures(rate=-0.5),
        run("a", outcomes={"held": -1}),
        *team(worker(1), worker(2, seen=-1.0)),
    ],
)
def test_numbers_that_are_no_counts_are_refused(shown) -> None:
    with pytest.raises(MessageError, match="negative, or beyond"):
        job_status.from_json(job_status.to_json(shown), type(shown))


def test_what_is_no_json_is_refused() -> None:
    for payload in (b"", b"\xff", b"[" * 100_000, b'{"job": 1}', b'{"rate": NaN}'):
        with pytest.raises(MessageError, match="not figures"):
            job_status.from_json(payload, job_status.JobStatus)
