"""Pictures of the page for docs/watching: a real job on two workers at its start, midway and at its end.

    python -m docs.website.monitor_pictures docs/watching

Midway a worker is killed, and the coordinator; how long the page took to show it is printed.
"""

import re
import sys
import tempfile
import time
from io import BytesIO
from pathlib import Path
from typing import Any

from PIL import Image
from tests import browser
from tests.browser import Visit
from tests.system.commands import Commands, Watched

JOB = ("--gripper", "panda", "--object", "mug", "--evaluations", 400)
FOUND = re.compile(r"cells of 1 cm")
LONG = 1_800_000  # ms that the job may take
SETTLED = 2500  # ms in which a view in 3D comes to rest
DONE = (
    "(share) => document.getElementById('progress').value / document.getElementById('progress').max >= share"
)
PICTURED = "() => [...document.querySelectorAll('#scene-best img')].slice(0, 6).every((one) => one.complete)"


def main(out: Path) -> None:
    """Run the job, and take its pictures."""
    from playwright.sync_api import expect

    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as home, browser.launched() as chromium:
        commands = Commands(Path(home))
        watched = Watched(commands, "mug", *JOB)
        watched.is_watched()
        visit = Visit(chromium, f"{watched.address}#job=mug", color_scheme="light")
        page = visit.page
        try:
            expect(page.locator("#scene-words")).to_contain_text(FOUND, timeout=LONG)
            until(page, 0.05)
            take(page, out, "start")
            until(page, 0.4)
            say(f"a killed worker is shown as gone after {dies(watched, 'worker', page):.1f} s")
            say(f"the next coordinator is shown after {dies(watched, 'coordinator', page):.1f} s")
            until(page, 0.6)
            page.keyboard.press("n")
            page.locator("#grasp").wait_for(timeout=LONG)
            take(page, out, "midway")
            page.keyboard.press("Escape")
            watched.ends()
            expect(page.locator("#state")).to_contain_text("ended", timeout=LONG)
            take(page, out, "end")
            say(f"the browser complained of {visit.complaints or 'nothing'}")
        finally:
            commands.end_all()


def say(words: str) -> None:
    """Print progress at once."""
    print(words, flush=True)


def dies(watched: Watched, role: str, page: Any) -> float:
    """Kill a process; gives how long the page took to show what follows [s]."""
    from playwright.sync_api import expect

    began = time.monotonic()
    watched.kill(role)
    if role == "worker":
        expect(page.locator("#workers tr[data-state=gone]")).to_have_count(1, timeout=browser.PATIENCE)
    else:
        expect(page.locator("#origin")).to_contain_text("epoch 2", timeout=browser.PATIENCE)
    return time.monotonic() - began


def until(page: Any, share: float) -> None:
    """Wait until so much of the job is done."""
    page.wait_for_function(DONE, arg=share, timeout=LONG)


def take(page: Any, out: Path, moment: str) -> None:
    """A picture as on a desk and one as on a phone, light and dark."""
    for kind, size in {"desktop": browser.DESKTOP, "phone": browser.PHONE}.items():
        for theme in ("light", "dark"):
            page.set_viewport_size(size)
            page.emulate_media(color_scheme=theme)
            page.evaluate("scrollTo(0, 0)")  # what stays in sight while one scrolls is where it belongs
            page.wait_for_function(PICTURED)
            page.wait_for_timeout(SETTLED)
            save(page.screenshot(full_page=True), out / f"{moment}-{kind}-{theme}.png")


def save(shot: bytes, path: Path) -> None:
    """Write a picture with few colours, so that it stays small."""
    picture = Image.open(BytesIO(shot)).convert("RGB")
    picture.quantize(128, Image.Quantize.MAXCOVERAGE, kmeans=3, dither=Image.Dither.NONE).save(
        path, optimize=True
    )
    say(f"{path.name}: {path.stat().st_size / 1024:.0f} KiB")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
