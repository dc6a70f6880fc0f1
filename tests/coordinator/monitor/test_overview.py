"""The overview of the jobs on a bus."""

import pytest
from tests.coordinator.monitor.shown import NOW, values, views

from qdgrasp_coordinator.monitor.overview import lines
from qdgrasp_protocol.keys import Keys


def text(shown: dict[str, bytes]) -> str:
    return "\n".join(line for view in views(shown) for line in lines(view, NOW))


def test_a_job_is_told_in_a_few_lines() -> None:
    assert text(values(recorders=1)) == (
        "mugs: running on head (process 7, epoch 2) for 1 d 1:02:03\n"
        "  0 of 3 runs, 1000 of 3000 evaluations, 100/s, 0 successes in 5 cells, "
        "0 simulated of 0 proposals, 0 overlaps, 0 dead ends, 9 workers, 00:20 left\n"
        "  2 runs in progress: a 10/1000, b 10/1000\n"
        "  workers: n0 2, n1 2, n2 1, n3 1, n4 1, n5 1 and 1 more (4 idle, 5 working)"
    )


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"recorders": 0}, "no recorder is there"),
        ({"workers": 0}, "workers: none has joined"),
        ({"state": "paused"}, "paused until `qdgrasp continue mugs`"),
        ({"trouble": "the disk is full"}, "paused: the disk is full"),
    ],
)
def test_what_keeps_a_job_from_going_on_is_told(more: dict[str, object], words: str) -> None:
    assert words in text(values(**more))


def test_jobs_are_told_by_name_and_values_of_others_are_left_out() -> None:
    shown = values("mugs") | values("cubes") | {"qdgrasp/v1/odd/meta": b"[]", "else/where": b"{}"}
    shown[Keys("mugs").stat("run/a")] = b"not JSON"
    assert [(view.meta.job, len(view.runs)) for view in views(shown)] == [("cubes", 2), ("mugs", 1)]


@pytest.mark.parametrize("since", [b"yesterday", b"2026-11-21T12:00:00", b"9999-99-99T00:00:00Z"])
def test_a_job_that_began_at_no_time_is_left_out(since: bytes) -> None:
    shown, key = values("mugs"), Keys("mugs").meta
    shown[key] = shown[key].replace(b"2026-11-21T12:00:00Z", since)
    assert since in shown[key]
    assert views(shown) == []
