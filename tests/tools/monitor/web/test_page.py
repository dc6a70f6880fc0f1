"""The page in a browser: jobs made by hand."""

import re
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from tests import browser
from tests.browser import PHONE, expect, figure, number
from tests.common import free_port
from tests.tools.monitor.web.conftest import FakeFeed, serving

pytestmark = browser.needed
Page = Any
Look = Callable[..., Page]


@pytest.fixture(scope="module")
def place() -> Iterator[str]:
    """A page of jobs that go on."""
    feed = FakeFeed()
    with feed.going_on(), serving(feed) as address:
        feed.happen("Worker 7 joined from node1.")
        yield address


def test_the_page_shows_numbers_that_grow(look: Look, place: str) -> None:
    page = look(f"{place}/#job=mug")
    expect(page).to_have_title(re.compile("^mug, running . qdgrasp$"))
    found = figure(page, "Successes")
    before = number(found.inner_text())
    page.wait_for_function(
        "([node, before]) => Number(node.textContent.replace(/\\D/g, '')) > before",
        arg=[found.element_handle(), before],
    )
    assert number(page.locator("#done").inner_text().partition(" of ")[0]) > 0
    assert number(figure(page, "Contact niches").inner_text()) > 0
    assert float(page.locator("#progress").get_attribute("value") or 0) > 0


def test_curves_are_drawn_and_their_last_points_are_told(look: Look, place: str) -> None:
    page = look(f"{place}/#job=mug")
    for plot, names in {
        "cells": ["Cells", "Contact niches"],
        "successes": ["Successes", "Robust"],
        "speed": ["Evaluations/s"],
    }.items():
        expect(page.locator(f"#{plot} canvas")).to_be_visible()
        expect(page.locator(f"#{plot}-legend dt")).to_have_text(names)
        expect(page.locator(f"#{plot}-legend dd")).to_have_text([re.compile("[1-9]")] * len(names))


def test_a_worker_that_was_killed_is_shown_as_gone(look: Look) -> None:
    feed = FakeFeed().step()
    with serving(feed) as place:
        page = look(f"{place}/#job=mug")
        expect(page.locator("#workers-words")).to_have_text("4 working")
        feed.gone = {2}
        feed.step()
        expect(page.locator("#workers tr[data-state=gone] th")).to_have_text("node2 4102")
        expect(page.locator("#workers-words")).to_have_text("3 working, 1 gone")


def test_the_page_goes_on_by_itself_when_the_monitor_is_back(look: Look) -> None:
    feed, port = FakeFeed(), free_port()
    feed.step()
    with serving(feed, port) as place:
        page = look(f"{place}/#job=mug")
        expect(page.locator("#link")).to_have_text("live")
        page.evaluate("() => (window.kept = true)")
    expect(page.locator("#link")).to_have_text(re.compile(r"^not connected since \d\d:\d\d:\d\d$"))
    before = number(figure(page, "Successes").inner_text())
    feed.step()
    with serving(feed, port):
        expect(page.locator("#link")).to_have_text("live")
        assert number(figure(page, "Successes").inner_text()) > before
        assert page.evaluate("() => window.kept"), "the page was loaded again"
        page.context.close()


def test_the_address_keeps_what_was_chosen(look: Look, place: str) -> None:
    page = look(f"{place}/")
    page.get_by_role("link", name=re.compile("^hands")).click()
    expect(page.locator("#name")).to_have_text("hands")
    page.get_by_role("link", name="panda-drill-portfolio-s1").click()
    expect(page.locator("#name")).to_have_text("panda-drill-portfolio-s1")
    assert page.url.endswith("#job=hands&run=panda-drill-portfolio-s1")
    page.reload()
    expect(page.locator("#name")).to_have_text("panda-drill-portfolio-s1")
    page.go_back()
    expect(page.locator("#name")).to_have_text("hands")


def test_workers_are_sorted_by_the_column_that_was_chosen(look: Look, place: str) -> None:
    page = look(f"{place}/#job=mug")
    memory = page.locator("#workers td[data-name=memory]")
    expect(memory).to_have_count(4)
    page.get_by_role("button", name="Memory").click()
    sizes = [re.compile(rf"^{size}\b") for size in (201, 194, 187, 180)]
    expect(memory).to_have_text(sizes)
    expect(page.locator("#workers th[aria-sort]")).to_have_text("Memory")
    page.get_by_role("button", name="Memory").press("Enter")
    expect(memory).to_have_text(sizes[::-1])


@pytest.mark.parametrize("job", ["mug", "hands"])
def test_a_phone_shows_everything_without_scrolling_sideways(look: Look, place: str, job: str) -> None:
    page = look(f"{place}/#job={job}", phone=True)
    expect(page.locator("#workers tbody tr").first).to_be_visible()
    assert page.evaluate("() => document.documentElement.scrollWidth") == PHONE["width"]
    panels = (
        "() => [...document.querySelectorAll('.panel')].map((node) => node.getBoundingClientRect().right)"
    )
    assert max(page.evaluate(panels)) <= PHONE["width"]


def test_the_token_opens_the_page_and_leaves_the_address(look: Look) -> None:
    feed = FakeFeed().step()
    with serving(feed, 0, "a-token-of-some-length") as place:
        page = look(f"{place}/?token=a-token-of-some-length")
        expect(page.locator("#link")).to_have_text("live")
        assert page.url == f"{place}/"
        page.context.close()
