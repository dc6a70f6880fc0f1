"""Pictures of `qdgrasp view` for docs/looking.md: a grasp, and another run after filters.

python -m docs.website.view_pictures docs/looking runs/mug runs/mug-allegro
"""

import re
import sys
from pathlib import Path
from typing import Any

from docs.website.monitor_pictures import PICTURED, SETTLED, save
from tests import browser
from tests.browser import Visit
from tests.system.commands import Commands


def main(out: Path, *runs: str) -> None:
    """Take the pictures."""
    out.mkdir(parents=True, exist_ok=True)
    commands = Commands(Path.cwd())
    with browser.launched() as chromium:
        try:
            for run, take in zip(runs, (grasp, filtered), strict=True):
                take(chromium, address(commands, run), out)
        finally:
            commands.end_all()


def address(commands: Commands, run: str) -> str:
    """Return the address at which the grasps of a run are shown."""
    process = commands.start("view", run)
    found = re.search(r"http://\S+", process.stdout.readline()) if process.stdout else None
    if not found:
        raise SystemExit(process.stderr and process.stderr.read())
    return found[0]


def grasp(chromium: Any, place: str, out: Path) -> None:
    """A chosen grasp with its frames, and two grasps beside each other, on a desk."""
    page = opened(chromium, place, color_scheme="light")
    page.keyboard.press("n")
    page.locator("#grasp h4").wait_for()
    take(page, out / "grasp-desktop-light.png")
    page = opened(chromium, place, color_scheme="light")
    page.locator("#scene-best button").nth(2).click()
    page.get_by_role("button", name="Keep beside").click()
    page.locator("#scene-best button").nth(4).click()
    page.get_by_role("button", name="Draw the frames").click()
    take(page, out / "pair-desktop-light.png")


def filtered(chromium: Any, place: str, out: Path) -> None:
    """Grasps from above with one synergy, on a desk and on a phone."""
    for phone, name in ((False, "filters-desktop-dark"), (True, "filters-phone-dark")):
        page = opened(chromium, place, phone=phone, color_scheme="dark")
        page.get_by_label("Synergy").select_option(index=1)
        page.get_by_label("z lowest").fill("3")
        for button in page.locator("[aria-pressed=true]", has_text="Cut open").all():
            button.click()  # so that all cells that pass are there
        page.locator("#scene").press("-")  # the box is larger than the cells
        page.locator("#scene").blur()
        take(page, out / f"{name}.png", full_page=phone)


def opened(chromium: Any, place: str, **looks: Any) -> Any:
    """A page that shows all cells of its run."""
    page = Visit(chromium, place, **looks).page
    page.wait_for_function("() => document.querySelector('#scene-words').textContent.includes('cells of')")
    return page


def take(page: Any, path: Path, *, full_page: bool = False) -> None:
    """A picture of a page that has come to rest."""
    page.wait_for_timeout(SETTLED)
    page.wait_for_function(PICTURED)
    save(page.screenshot(full_page=full_page), path)


if __name__ == "__main__":
    main(Path(sys.argv[1]), *sys.argv[2:])
