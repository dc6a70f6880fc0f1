"""Published status, as it travels."""

import pytest
from msgspec.structs import replace
from tests.tools.monitor.sample_jobs import event, figures, run, team, worker

from qdgrasp_coordinator.metrics import job_status
from qdgrasp_protocol.errors import MessageError


@pytest.mark.parametrize(
    "shown",
    [
        figures(evaluations=job_status.GREATEST_COUNT),
        run("a", seed=job_status.GREATEST_COUNT - 1),
        event(1),
        *team(worker(1), worker(2)),
    ],
)
def test_what_is_shown_arrives_as_it_was(shown) -> None:
    assert job_status.from_json(job_status.to_json(shown), type(shown)) == shown


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


@pytest.mark.parametrize(
    ("seconds", "words"),
    [
        (1.0, "about 5 s"), (42.0, "about 40 s"), (89.0, "about 90 s"), (100.0, "about 2 min"),
        (3500.0, "about 1 h"), (4200.0, "about 1 h 10 min"), (6600.0, "about 1 h 50 min"),
        (36_000.0, "about 10 h"), (250_000.0, "about 69 h"), (5e5, "about 6 days"),
    ],
)  # fmt: skip
def test_a_time_left_is_told_no_finer_than_it_is_known(seconds: float, words: str) -> None:
    assert figures(seconds_left=seconds).left == f"{words} left"


def test_a_job_without_rows_says_what_it_does_and_no_speed() -> None:
    early = figures(evaluations=0, budget=3, remaining=3, runs=1, rate=0.0, doing="waiting for workers")
    assert early.words == "0 of 3 evaluations, waiting for workers"
    assert (
        "3 of 3 evaluations, building the shape of a, 100/s, "
        in replace(early, evaluations=3, rate=100.0, doing="building the shape of a").words
    )


def test_a_job_tells_of_its_shapes_before_its_runs() -> None:
    building = figures(
        evaluations=16_000, budget=40_000, runs=2000, runs_done=80, scenes=1000, scenes_done=120
    )
    assert building.words.startswith("120 of 1000 shapes, 80 of 2000 runs, 16000 of 40000 evaluations, ")
    failed = figures(scenes=10, scenes_done=4, scenes_failed=2)
    assert failed.words.startswith("4 of 10 shapes and 2 failed, ")


def test_what_is_no_json_is_refused() -> None:
    for payload in (b"", b"\xff", b"[" * 100_000, b'{"job": 1}', b'{"rate": NaN}'):
        with pytest.raises(MessageError, match="not figures"):
            job_status.from_json(payload, job_status.JobStatus)
