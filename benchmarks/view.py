"""Measures how fast a page with many cells opens and turns, without a graphics card.

`python -m benchmarks.view` serves the monitor's page with an archive made by hand, opens it in Chromium
drawing on the processor, and prints a line of JSON: how many pictures a second there are, and how finely
they are drawn, as the page chooses. These are no CPU times: measure while all is quiet.
"""

import argparse
import json
import os
import time
from typing import Any

import numpy as np
from tests import browser
from tests.coordinator.scenes import made_scene
from tests.tools.monitor.web.conftest import FakeFeed, HandMadeRecords, finds, serving

from qdgrasp_coordinator.storage.success_pages import MOST_SUCCESSES, SuccessTable
from qdgrasp_protocol.rows import Outcome
from qdgrasp_tools.monitor.web.run_cache import JobCaches

INSIDE = 10  # cells; the object is within this distance of the middle
IS_SHOWN = "(words) => document.querySelector('#scene-words').textContent.startsWith(words)"
ROTATE = """async (ms) => {
  const canvas = document.querySelector("#scene"), key = new KeyboardEvent("keydown", { key: "ArrowLeft" });
  const frame = () => new Promise(requestAnimationFrame);
  const times = [];
  for (const began = performance.now(); performance.now() < began + ms; ) {
    canvas.dispatchEvent(key);
    times.push(await frame());
  }
  return times;
}"""
WARM_UP, MEASURED = 3000, 6000  # ms, of warming up and of measuring


def archive(n: int) -> SuccessTable:
    """Successes in `n` cells around the object, at a usual density: two cells of three."""
    random = np.random.default_rng(0)
    reach = int(np.ceil((n * 1.5 / 4.19 + INSIDE**3) ** (1 / 3)))
    side = np.arange(-reach, reach + 1)
    places = np.stack(np.meshgrid(side, side, side), axis=-1).reshape(-1, 3)
    far = np.linalg.norm(places, axis=1)
    places = random.permutation(places[(far > INSIDE) & (far < reach)])[:n]
    return finds(np.arange(n), places, random.integers(Outcome.DROPPED, Outcome.HELD + 1, n))


def measured(page: Any, cells: int, address: str) -> dict[str, object]:
    """Figures of a visit to a page, in a browser that runs."""
    began = time.perf_counter()
    page.goto(f"{address}/#job=mug")
    page.wait_for_function(IS_SHOWN, arg=f"{cells:,} cells")
    page.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    opened = time.perf_counter() - began
    return {
        "opened_seconds": round(opened, 2),
        "cut_open": frame_rates(page),
        "whole": frame_rates(page, "Cut open"),
    }


def frame_rates(page: Any, button: str | None = None) -> dict[str, float | str]:
    """Frame rate and resolution while the page turns, after a button was pressed."""
    if button:
        page.get_by_role("button", name="Leave out the cells").click()
    page.evaluate(ROTATE, WARM_UP)
    times = np.diff(page.evaluate(ROTATE, MEASURED))
    return {
        "frames_per_second": round(1000 / float(times.mean()), 1),
        "p95_frame_ms": round(float(np.quantile(times, 0.95)), 1),
        "drawn_with": page.locator("#scene").get_attribute("data-quality"),
    }


def main() -> None:
    """Measure, and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cells", type=int, default=100_000)
    cells = parser.parse_args().cells
    records, feed = HandMadeRecords(made_scene(), run="mug", on_a_page=MOST_SUCCESSES), FakeFeed()
    records.record(archive(cells))
    feed.step()
    with serving(feed, library=JobCaches(records)) as address, browser.launched() as launched:
        page = launched.new_page(viewport=browser.DESKTOP)
        page.set_default_timeout(browser.PATIENCE)
        found = measured(page, cells, address)
    print(json.dumps({"cells": cells, **found, "cpus": os.cpu_count(), "load": os.getloadavg()[0]}))


if __name__ == "__main__":
    main()
