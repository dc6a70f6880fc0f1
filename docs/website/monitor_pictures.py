"""Pictures of the page for docs/watching: a real job on two workers, midway.

    python -m docs.website.monitor_pictures docs/watching

Before, a worker is killed, and the coordinator; how long the page took to show it is printed.
"""

import re
import subprocess
import sys
import tempfile
import threading
import time
from io import BytesIO
from pathlib import Path
from typing import Any

from PIL import Image
from tests import browser
from tests.browser import Visit
from tests.common import own_endpoint
from tests.system.commands import MONITOR, Commands, kill, pids

JOB = ("--gripper", "panda", "--object", "mug", "--evaluations", 400, "--workers", 2)
FOUND = re.compile(r"cells of 1 cm")
LONG = 1_800_000  # ms that the job may take
SETTLED = 2500  # ms in which a view in 3D comes to rest
DONE = (
    "(share) => document.getElementById('progress').value / document.getElementById('progress').max >= share"
)
PICTURED = "() => [...document.querySelectorAll('#scene-best img')].slice(0, 6).every((one) => one.complete)"
PICTURES = (("desktop", "light"), ("desktop", "dark"), ("phone", "dark"))


def main(out: Path) -> None:
    """Run the job, and take its pictures."""
    from playwright.sync_api import expect

    out.mkdir(parents=True, exist_ok=True)
    with (
        tempfile.TemporaryDirectory() as home,
        browser.launched() as chromium,
        Commands(Path(home)) as commands,
    ):
        endpoint = own_endpoint()
        run = commands.start("run", *JOB, "--out", "mug", "--listen", endpoint)
        watched = ("--web", "127.0.0.1:0", "--connect", endpoint, "--wait", 120)
        monitor = commands.start(*watched, module=MONITOR)
        visit = Visit(chromium, f"{address(monitor)}#job=mug", color_scheme="light")
        page = visit.page
        expect(page.locator("#scene-words")).to_contain_text(FOUND, timeout=LONG)
        until(page, 0.4)
        say(f"a killed worker is shown as gone after {dies(run, 'worker', page):.1f} s")
        say(f"the next coordinator is shown after {dies(run, 'coordinator', page):.1f} s")
        until(page, 0.6)
        page.locator("#scene-best button").nth(2).click()
        page.locator("#grasp h4").wait_for(timeout=LONG)
        take(page, out)
        say(f"the browser complained of {visit.complaints or 'nothing'}")


def address(process: subprocess.Popen[str]) -> str:
    """Return the address of the page that a command serves, which it says on standard error."""
    for line in process.stderr or ():
        if found := re.search(r"http://127\.0\.0\.1:\d+/", line):
            threading.Thread(target=process.stderr.read, daemon=True).start()  # so that it never has to wait
            return found[0]
    raise SystemExit("The monitor says no address.")


def say(words: str) -> None:
    """Print progress at once."""
    print(words, flush=True)


def dies(run: subprocess.Popen[str], role: str, page: Any) -> float:
    """Kill a process; gives how long the page took to show what follows [s]."""
    from playwright.sync_api import expect

    began = time.monotonic()
    kill(pids(run, role)[0])
    if role == "worker":
        expect(page.locator("#workers tr[data-state=gone]")).to_have_count(1, timeout=browser.PATIENCE)
    else:
        expect(page.locator("#origin")).to_contain_text("epoch 2", timeout=browser.PATIENCE)
    return time.monotonic() - began


def until(page: Any, share: float) -> None:
    """Wait until so much of the job is done."""
    page.wait_for_function(DONE, arg=share, timeout=LONG)


def take(page: Any, out: Path) -> None:
    """The pictures as on a desk and on a phone, light and dark."""
    for kind, theme in PICTURES:
        page.set_viewport_size({"desktop": browser.DESKTOP, "phone": browser.PHONE}[kind])
        page.emulate_media(color_scheme=theme)
        page.evaluate("scrollTo(0, 0)")  # what stays in sight while one scrolls is where it belongs
        page.wait_for_function(PICTURED)
        page.wait_for_timeout(SETTLED)
        save(page.screenshot(full_page=True), out / f"midway-{kind}-{theme}.png")


def save(shot: bytes, path: Path) -> None:
    """Write a picture with few colours, so that it stays small."""
    picture = Image.open(BytesIO(shot)).convert("RGB")
    picture.quantize(128, Image.Quantize.MAXCOVERAGE, kmeans=3, dither=Image.Dither.NONE).save(
        path, optimize=True
    )
    say(f"{path.name}: {path.stat().st_size / 1024:.0f} KiB")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
