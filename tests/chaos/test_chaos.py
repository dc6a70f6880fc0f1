"""A run whose processes are killed and stopped gives what an undisturbed one gives."""

from itertools import islice
from pathlib import Path

import pytest
from tests.chaos.plan import HEAD, Course, Deed, blows, opening
from tests.chaos.play import disturb
from tests.chaos.undisturbed import undisturbed_digest

SEED = 4
EVALUATIONS = 300
WORKERS = 4
GAPS = (0.8, 1.6)
PACE = WORKERS * opening(WORKERS) * GAPS[1] / EVALUATIONS
"""So slow that the run is not over before the first round of blows is."""
COURSE = Course("contact_rand", "paper", 60, PACE)


@pytest.mark.timeout(600)
def test_a_disturbed_run_gives_what_an_undisturbed_one_gives(tmp_path: Path, undisturbed: Path) -> None:
    spec = COURSE.spec(SEED, EVALUATIONS)
    expected = undisturbed_digest(spec, undisturbed)
    plan = islice(blows(SEED, WORKERS, GAPS), opening(WORKERS))
    story = disturb(tmp_path / "run", spec, plan, workers=WORKERS, pace=PACE, limit=300, say=print)
    assert story.troubles == []
    assert {(kind, Deed.KILL) for kind in ("worker", *HEAD)} <= set(story.struck)
    assert any(deed is Deed.STOP for _, deed in story.struck)
    assert story.digest == expected
