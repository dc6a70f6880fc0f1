"""The time left over a campaign, and a job's work while no rows come in."""

import pytest
from msgspec import structs
from tests.tools.monitor.sample_jobs import figures

from qdgrasp_coordinator.metrics.time_left import QUIET_SECONDS, TimeLeft, WorkersAtWork
from qdgrasp_protocol.messages import Heartbeat


def at_work(*signs: dict[str, object], builders: int = 0, settled: int = 0) -> WorkersAtWork:
    """Workers at work, by what their signs say."""
    common = {"wid": 32 * "0", "host": "here"}
    return WorkersAtWork(builders, [Heartbeat(**(common | sign)) for sign in signs], settled)


BEGUN = {"state": "running", "runs_open": 1, "workers": 2, "evaluations": 0, "rate": 0.0}


def test_the_time_left_is_about_right() -> None:
    """Two workers build two shapes of 60 s, then evaluate 2000 rows of 0.1 s, five times over."""
    left, round_seconds, rounds = TimeLeft(), 160, 5
    shown = 0
    for second in range(1, round_seconds * rounds):
        number, within = divmod(second, round_seconds)
        rows, built = 2000 * number + 20 * max(0, within - 60), 2 * (number + (within >= 60))
        job = figures(
            evaluations=rows, remaining=2000 * rounds - rows, budget=2000 * rounds, rate=rows / second,
            seconds=float(second), workers=2, scenes_done=built, scenes_seconds=60.0 * built,
        )  # fmt: skip
        signs = [] if within < 60 else [{"rows": 50}] * 2
        work = at_work(*signs, builders=2 - len(signs), settled=rows)
        seconds = left.note(job, work, 2.0 * rounds - built, float(second)).seconds_left
        if seconds is not None and second > 120:
            assert seconds == pytest.approx(round_seconds * rounds - second, rel=0.15, abs=60.0)
            shown += 1
    assert shown > 600


def test_trials_that_are_to_come_are_left_where_all_evaluations_are_done() -> None:
    """Two workers evaluate 20 trials a second of 9000."""
    left, common = TimeLeft(), BEGUN | {"evaluations": 100, "remaining": 0, "budget": 100}
    for second in range(1, 60):
        done = 20 * second
        job = figures(**common, trials=done, trials_left=9000 - done, seconds=float(second))
        job = left.note(job, at_work({"rows": 50}, {"rows": 50}, settled=100 + done), 0.0, float(second))
    assert job.seconds_left == pytest.approx((9000 - done) / 20, rel=0.1)
    assert job.done == pytest.approx((100 + done) / 9100)
    assert job.left == "about 7 min left"
    assert structs.replace(job, trials_left=0).left == "nothing left"


def test_it_is_said_at_once_at_the_beginning_and_after_a_while_without_rows_later() -> None:
    left = TimeLeft()

    def doing(evaluations: int, now: float) -> str:
        job = figures(**(BEGUN | {"evaluations": evaluations, "seconds": now, "rate": evaluations / now}))
        return left.note(job, at_work({"rows": 50, "done": 20}, settled=evaluations), 0.0, now).doing

    assert doing(0, 1.0) == "first poses: 20 of 50 poses evaluated"
    assert doing(50, 2.0) == doing(50, 2.0 + QUIET_SECONDS) == ""
    assert doing(50, 3.0 + QUIET_SECONDS) == "20 of 50 poses evaluated"
    assert doing(60, 4.0 + QUIET_SECONDS) == ""
