import os
from pathlib import Path

import pytest
from hypothesis import settings

settings.register_profile(
    "shared", deadline=None
)  # machines are shared: how long an example takes says nothing
settings.load_profile("shared")

TESTS = Path(__file__).resolve().parent
SYSTEM = TESTS / "system"
"""Where tests start processes of their own."""
SIBLING = TESTS.parents[1] / "shared" / "data"
"""Where the reference data lies beside a checkout; QDGRASP_ASSET_PATH names another place."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Where several processes test (`pytest -n`), a module stays in one, and so does all of tests/system.

    That comes first: it takes longest, and starts processes of its own.
    """
    items.sort(key=lambda item: SYSTEM not in item.path.parents)
    for item in items:
        group = SYSTEM if SYSTEM in item.path.parents else item.path
        item.add_marker(pytest.mark.xdist_group(str(group)))


@pytest.fixture(scope="session")
def reference_data() -> Path:
    """The folder with the reference hands, objects, sets and parity files; skips where there is none."""
    named = os.environ.get("QDGRASP_ASSET_PATH")
    places = [Path(place) for place in named.split(os.pathsep)] if named else [SIBLING]
    for place in places:
        if (place / "reference").is_dir():
            return place
    pytest.skip(f"no reference data in {os.pathsep.join(map(str, places))}; set QDGRASP_ASSET_PATH")
