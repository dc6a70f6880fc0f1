"""The page of a campaign some of whose runs were over before anybody watched."""

import time
from itertools import count
from typing import Any

from msgspec.structs import replace
from tests import browser
from tests.browser import PATIENCE
from tests.coordinator.monitor.shown import curve, run, values
from tests.coordinator.monitor.web.conftest import free_port, serving
from tests.coordinator.monitor.web.fakes import FakeFeed, FakeLibrary
from tests.coordinator.serving.served import until

from qdgrasp_coordinator.counts.entry import RunEntries, RunEntry
from qdgrasp_coordinator.counts.figures import to_json

pytestmark = browser.needed
OVER = run("over", evaluations=1000, cells=100, finished="its budget is spent")


class Recorded(FakeLibrary):
    """A library that knows how the run `over` of `mugs` grew: all its cells came at once."""

    def runs(self, job: str) -> bytes:
        known = {name: getattr(OVER, name) for name in RunEntry.__struct_fields__}
        return to_json(RunEntries(runs=[RunEntry(**known)]))

    def scene(self, job: str, run: str) -> bytes:
        return super().scene(job, "mug")

    def curve(self, job: str, run: str) -> bytes:
        grown = curve(run, *range(100, 1001, 100))
        points = [replace(point, cells=100) for point in grown.points]
        return to_json(replace(grown, points=points))


def test_the_curve_of_a_run_that_nobody_watched_is_the_recorded_one() -> None:
    feed = FakeFeed()
    feed.jobs.answered(values(), time.time())
    with serving(feed, free_port(), library=Recorded()) as place, browser.launched() as chromium:
        visit = browser.Visit(chromium, f"{place}/#job=mugs&run=over")
        over, legend = visit.page.locator("#cells .u-over"), visit.page.locator("#cells-legend dd")
        over.wait_for(timeout=PATIENCE)
        box, nudges = over.bounding_box(), count()
        assert box is not None
        until(lambda: under(visit.page, legend, box["x"] + 0.4 * box["width"] + next(nudges) % 3) == "100")
        assert visit.complaints == []


def under(page: Any, legend: Any, x: float) -> str:
    """What the legend says of the cells where the cursor is."""
    page.mouse.move(x, page.locator("#cells .u-over").bounding_box()["y"] + 9)
    return str(legend.inner_text())
