"""The page of runs in folders in a browser."""

from collections.abc import Callable, Iterator
from typing import Any

import pytest
from tests import browser
from tests.browser import expect
from tests.coordinator.recorded_runs import random_rows, record, success_mask
from tests.coordinator.scenes import made_scene
from tests.tools.monitor.web.conftest import serving_routes

from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_tools.monitor.records import FolderIndex
from qdgrasp_tools.monitor.web.server import folder_routes

pytestmark = browser.needed
ROWS = random_rows(60, reach=0.3)
CELLS = f"{len(ROWS[success_mask(ROWS)])} cells of 1 cm"
Look = Callable[..., Any]


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> list[RunFolder]:
    home = tmp_path_factory.mktemp("runs")
    return [record(home / name, made_scene(), ROWS) for name in ("bowl", "mug")]


@pytest.fixture(scope="module")
def place(runs: list[RunFolder]) -> Iterator[str]:
    """Two runs."""
    with serving_routes(lambda _: folder_routes(FolderIndex([runs[0].path.parent]))) as address:
        yield address


@pytest.fixture
def look(look: Look) -> Look:
    """Opens a page, and waits until it shows grasps."""

    def opened(address: str, **looks: Any) -> Any:
        page = look(address, **looks)
        expect(page.locator("#scene-words")).to_contain_text("cells of 1 cm")
        return page

    return opened


def test_the_first_run_is_shown_and_another_may_be_chosen(look: Look, place: str) -> None:
    page = look(place)
    expect(page.locator("#name")).to_have_text("bowl")
    expect(page.locator("#scene-words")).to_have_text(CELLS)
    page.get_by_role("link", name="mug").click()
    expect(page).to_have_title("mug \N{EN DASH} qdgrasp")
    assert page.url.endswith("#job=mug&run=run")
    page.reload()
    expect(page.locator("#name")).to_have_text("mug")
