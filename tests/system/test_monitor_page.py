"""The page of the monitor in a browser, with a real job behind it."""

import re

from tests import browser
from tests.browser import PATIENCE, figure, number
from tests.system.commands import SMALL, Commands, Watched

pytestmark = browser.needed
GROWN = "([node, before]) => Number(node.textContent.replace(/\\D/g, '')) > before"
CELLS = re.compile(r"^[1-9]\S* cells of 1 cm")


def test_the_page_shows_a_job_from_its_beginning_to_its_end_whoever_dies(qdgrasp: Commands) -> None:
    from playwright.sync_api import expect

    with browser.launched() as chromium:  # first: on a busy machine it takes as long as the job
        watched = Watched(qdgrasp, "balls", *SMALL, "--method", "contact_me_scs", "--evaluations", 400)
        watched.pauses(100)  # so that it is there however long a busy machine takes to draw
        visit = browser.Visit(chromium, f"{watched.address}#job=balls")
        page = visit.page
        page.evaluate("() => (window.kept = true)")
        expect(page.locator("#scene-words")).to_have_text(CELLS, timeout=PATIENCE)
        done = page.locator("#done")
        rows = page.locator("#workers tbody tr")
        expect(rows).to_have_count(2, timeout=PATIENCE)

        watched.kill("worker")
        expect(page.locator("#workers tr[data-state=gone]")).to_have_count(1, timeout=PATIENCE)

        watched.kill("coordinator")
        expect(page.locator("#origin")).to_contain_text("turn 2", timeout=PATIENCE)
        before = number(figure(page, "Successes").inner_text())
        watched.goes_on()
        page.wait_for_function(GROWN, arg=[figure(page, "Successes").element_handle(), before])

        watched.ends()
        expect(page.locator("#state")).to_have_text(re.compile("^ended: "), timeout=PATIENCE)
        expect(done).to_have_text(re.compile(r"^400 of 400\b"))
        info = qdgrasp.info("run")
        for name in ("Successes", "Cells", "Grasps", "Robust"):
            expect(figure(page, name)).to_have_text(str(info[name.lower()]))
        assert page.evaluate("() => window.kept"), "the page was loaded again"
        assert visit.complaints == []
