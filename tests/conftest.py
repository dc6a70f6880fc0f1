import os
import threading
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
import structlog
from hypothesis import settings
from tests.coordinator.scenes import SceneMaker, made_scene
from tests.fakes.memory_bus import MemoryNetwork
from tests.fakes.recorder import FakeCoordinator
from xdist.scheduler import LoadScopeScheduling

from qdgrasp_coordinator.storage.journal_writer import JournalWriter

settings.register_profile("shared", deadline=None)  # machines are shared: an example's time means nothing
settings.load_profile("shared")

os.environ.setdefault("QDGRASP_NICE", "0")  # tests wait for simulators, which must not have a low priority

TESTS = Path(__file__).resolve().parent
STARTERS = {"system": "jobs", "chaos": "others", "examples": "others", "golden": "others", "docs": "others"}
"""Modules that start processes of their own, by row: two of one row never run at a time."""
LONG = ("worker", "simulation", "assets")
"""Modules that take long come first, so that all processes end together."""
SIBLING = TESTS.parents[1] / "shared" / "data"
"""Folder of the reference data beside a checkout; QDGRASP_ASSET_PATH names another one."""
HAS_BULLET = find_spec("pybullet") is not None
SAYS_MISSING = ("PyBullet is not installed", "No module named 'pybullet'", "import of pybullet halted")
"""Words of a test or a module that came to Bullet, where it is not installed."""


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Iterator[Any]:
    """Without PyBullet, a test that comes to it is skipped."""
    return skip_without_bullet((yield))


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(collector: pytest.Collector) -> Iterator[Any]:
    """Without PyBullet, modules of tests that import it are skipped."""
    return skip_without_bullet((yield))


def skip_without_bullet(report: Any) -> Any:
    """A report, as skipped where the test failed because Bullet is missing."""
    said = "".join([report.longreprtext, *(text for _, text in report.sections)]) if report.failed else ""
    if not HAS_BULLET and any(words in said for words in SAYS_MISSING):
        report.outcome, report.longrepr = "skipped", (report.nodeid, 0, "Skipped: PyBullet is not installed")
    return report


@pytest.fixture(autouse=True)
def _speaks_as_before() -> Iterator[None]:
    """A command that a test runs in its own process leaves the log of the others as it was."""
    before = structlog.get_config()
    yield
    structlog.configure(**before)
    structlog.contextvars.clear_contextvars()


class ByModule(LoadScopeScheduling):
    """Where several processes test (`pytest -n`): a module stays in one, and so does a row of `STARTERS`."""

    def _split_scope(self, nodeid: str) -> str:
        module = nodeid.partition("::")[0]
        return row(TESTS.parent / module) or module


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> ByModule:
    return ByModule(config, log)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """One process more than there are processors, for many tests wait for others."""
    return len(os.sched_getaffinity(0)) + 1


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest tests come first: those that start processes, and then long modules."""
    items.sort(key=lambda item: 0 if row(item.path) else 1 if folder(item.path) in LONG else 2)


def row(module: Path) -> str:
    """The row of a module that starts processes; empty: it starts none."""
    return STARTERS.get(folder(module), "")


def folder(module: Path) -> str:
    """The folder of the tests that a module is in."""
    return module.relative_to(TESTS).parts[0]


@pytest.fixture(scope="session")
def reference_data() -> Path:
    """The folder with the reference hands, objects, sets and parity files; skips where there is none."""
    named = os.environ.get("QDGRASP_ASSET_PATH")
    places = [Path(place) for place in named.split(os.pathsep)] if named else [SIBLING]
    for place in places:
        if (place / "reference").is_dir():
            return place
    pytest.skip(f"no reference data in {os.pathsep.join(map(str, places))}; set QDGRASP_ASSET_PATH")


@pytest.fixture
def asset_path(reference_data: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The reference data, set as the asset path."""
    monkeypatch.setenv("QDGRASP_ASSET_PATH", str(reference_data))
    return reference_data


@pytest.fixture
def network() -> MemoryNetwork:
    return MemoryNetwork()


@pytest.fixture
def coordinator(network: MemoryNetwork) -> FakeCoordinator:
    return FakeCoordinator(network.session())


@pytest.fixture
def room(monkeypatch: pytest.MonkeyPatch) -> threading.Event:
    """An event: until it is set, journals have no room to grow."""
    room, append = threading.Event(), JournalWriter.append

    def limited(journal: JournalWriter, *arguments: Any) -> None:
        pages = 1_000_000 if room.is_set() else 1
        journal._database.execute(f"PRAGMA max_page_count = {pages}")
        append(journal, *arguments)

    monkeypatch.setattr(JournalWriter, "append", limited)
    monkeypatch.setattr("qdgrasp_coordinator.recorder.recorder.RETRY_INTERVAL", 0.02)
    return room


@pytest.fixture
def make_scene() -> SceneMaker:
    """Makes scenes of the jaw with a given name, and an object with given hulls."""
    return made_scene
