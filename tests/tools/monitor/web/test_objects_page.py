"""The table of objects: the server's answers, and the page in a browser."""

from collections.abc import Callable, Iterator
from typing import Any

import msgspec
import pytest
from tests import browser
from tests.browser import expect
from tests.coordinator.recorded_campaigns import SKIPPED, ObjectRun, listed
from tests.coordinator.scenes import made_scene
from tests.tools.monitor.sample_jobs import event, run, values
from tests.tools.monitor.web.conftest import FakeFeed, HandMadeRecords, client, serving

from qdgrasp_coordinator.metrics.job_status import JobEvents, ObjectListings, RunListing, RunListings, to_json
from qdgrasp_coordinator.metrics.run_stats import NO_TOTALS
from qdgrasp_protocol.errors import NoReply
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.spec import ObjectRecord, RunSpec
from qdgrasp_tools.monitor.web.run_cache import JobCaches

Page = Any
Look = Callable[..., Page]
OBJECTS, HANDS, BUDGET = 300, ("panda", "allegro"), 400
PARTS = "/api/jobs/parts/objects"
GOOD = msgspec.structs.replace(
    NO_TOTALS, evaluations=BUDGET, simulated=BUDGET, successes=200, grasps=100, robust=50, cells=40
)
OVERLAPPING = msgspec.structs.replace(NO_TOTALS, evaluations=BUDGET, overlaps=BUDGET)


def library() -> list[ObjectRun]:
    """Two runs for each object: of every seventh all poses overlap, and the last third has not begun."""
    runs = []
    for number in range(OBJECTS):
        about = ObjectRecord(id=f"part_{number:03d}", category="mug" if number % 3 else "box")
        found = OVERLAPPING if number % 7 == 6 else msgspec.structs.replace(GOOD, cells=40 + number)
        for hand in HANDS:
            file = f"/library/part_{number:03d}.stl"
            spec = RunSpec(gripper=hand, object=file, mass=0.1, evaluations=BUDGET, about=about)
            has_begun = number < 2 * OBJECTS // 3
            runs.append(
                ObjectRun(f"{hand}-part_{number:03d}-s0", spec, found if has_begun else None, has_begun)
            )
    return runs


class ObjectLibrary(JobCaches):
    """A library of the job `parts`."""

    def __init__(self) -> None:
        super().__init__(HandMadeRecords(made_scene()))
        self.listings = listed(library(), SKIPPED)

    def objects(self, job: str) -> ObjectListings:
        if job != "parts":
            raise NoReply("nobody answers")
        return ObjectListings(objects=self.listings)

    def object_runs(self, job: str, file: str) -> bytes:
        names = next(each.names for each in self.listings if each.file == file)
        listings = [
            msgspec.convert(
                msgspec.to_builtins(run(name, object=file, finished="its budget is spent")), RunListing
            )
            for name in names
        ]
        return to_json(RunListings(runs=listings))


@pytest.fixture
def parts() -> FakeFeed:
    """A job of a campaign over 300 objects, among others."""
    feed = FakeFeed().step()
    told = values("parts", 2 * OBJECTS, runs_done=400, scenes=OBJECTS, scenes_done=200, scenes_failed=1,
                  building=["/library/part_250.stl"])  # fmt: skip
    events = [
        event(1, "Its parts are coarse.", kind="warning", object="/library/part_001.stl"),
        event(2, "It has no parts.", kind="error", run="panda-part_299-s0", object="/library/part_299.stl"),
        event(3, "It has no parts.", kind="error", run="allegro-part_299-s0", object="/library/part_299.stl"),
    ]
    told[Keys("parts").recent] = to_json(JobEvents(events=events))
    feed.jobs.receive_answers(told, feed.now)
    return feed


@pytest.fixture(scope="module")
def objects() -> ObjectLibrary:
    return ObjectLibrary()


def ask(feed: FakeFeed, objects: ObjectLibrary, headers: dict[str, str] | None = None, **asked: Any) -> Any:
    return client(feed, library=objects).get(PARTS, params=asked, headers=headers)


def names(answer: Any) -> list[str]:
    return [each["object"] for each in answer.json()["objects"]]


def test_objects_come_page_by_page_in_the_order_of_their_runs(parts, objects) -> None:
    first, second, last, far = (ask(parts, objects, **{"from": n}) for n in (0, 50, 300, 99_999))
    assert names(first) == [f"part_{n:03d}" for n in range(50)]
    assert names(second)[0] == "part_050"
    assert names(last) == names(far) == ["torn", "split", "cracked"]
    counts = {key: first.json()[key] for key in ("first", "found", "total", "little", "uncounted")}
    assert counts == {"first": 0, "found": 303, "total": 303, "little": 28, "uncounted": 0}


def test_the_server_sorts_and_searches(parts, objects) -> None:
    assert names(ask(parts, objects, sort="cells", down=1))[:2] == ["part_199", "part_198"]
    assert names(ask(parts, objects, sort="note"))[:2] == ["part_006", "part_013"]
    found = ask(parts, objects, search="box overlaps")
    assert found.json()["found"] == 10
    assert all(each["category"] == "box" for each in found.json()["objects"])
    assert ask(parts, objects, search="no such object").json()["objects"] == []


def test_what_the_coordinator_says_stands_at_the_objects(parts, objects) -> None:
    (coarse,), (failed,), (building,) = (
        ask(parts, objects, search=f"part_{number}").json()["objects"] for number in ("001", "299", "250")
    )
    assert coarse["warnings"] == ["Its parts are coarse."]
    assert (failed["state"], failed["runs_failed"], failed["warnings"]) == ("failed", 2, ["It has no parts."])
    assert building["state"] == "building"
    assert ask(parts, objects).json()["states"] == {
        "failed": 1, "skipped": 3, "building": 1, "waiting": 98, "done": 200,
    }  # fmt: skip


@pytest.fixture
def place(parts: FakeFeed, objects: ObjectLibrary) -> Iterator[str]:
    with serving(parts, library=objects) as address:
        yield f"{address}/#job=parts"


def shown(page: Page) -> list[str]:
    return page.locator("#objects tbody a").all_text_contents()


@browser.needed
def test_the_page_shows_a_part_of_the_objects_and_goes_on(look: Look, place: str) -> None:
    page = look(place)
    expect(page.locator("#objects tbody tr")).to_have_count(50)
    words = page.locator("#objects-words")
    expect(words).to_have_text("303: 200 done, 1 building, 98 waiting, 1 failed, 3 skipped; 28 got little")
    expect(page.locator("#done")).to_contain_text("200 of 300 shapes, 1 failed")
    page.get_by_role("button", name="Next", exact=True).click()
    expect(page.locator("#objects-range")).to_have_text("51 to 100 of 303")
    assert shown(page)[0] == "part_050"
    page.get_by_role("button", name="Previous", exact=True).click()
    expect(page.locator("#objects-range")).to_have_text("1 to 50 of 303")
    expect(page.get_by_role("button", name="Previous", exact=True)).to_be_disabled()


@browser.needed
def test_an_object_leads_to_its_runs_and_back(look: Look, place: str) -> None:
    page = look(place)
    expect(page.locator("#runs-words")).to_contain_text("those that have ended are shown with their object")
    page.get_by_role("link", name="part_003").click()
    runs = page.locator("#runs tbody a")
    expect(runs).to_have_text(["panda-part_003-s0", "allegro-part_003-s0"])
    expect(page.locator("#runs-words")).to_have_text("2 runs of /library/part_003.stl have begun")
    expect(page.locator("#objects tr[data-state~=chosen] a")).to_have_text("part_003")
    runs.first.click()
    expect(page.locator("#name")).to_have_text("panda-part_003-s0")
    page.get_by_role("link", name="All runs").click()
    expect(page.locator("#objects tr[data-state~=chosen]")).to_have_count(0)
    expect(page.locator("#name")).to_have_text("parts")
