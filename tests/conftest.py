import os
from pathlib import Path

import pytest
from hypothesis import settings

settings.register_profile(
    "shared", deadline=None
)  # machines are shared: how long an example takes says nothing
settings.load_profile("shared")

SIBLING = Path(__file__).resolve().parents[2] / "shared" / "data"
"""Where the reference data lies beside a checkout; QDGRASP_ASSET_PATH names another place."""


@pytest.fixture(scope="session")
def reference_data() -> Path:
    """The folder with the reference hands, objects, sets and parity files; skips where there is none."""
    named = os.environ.get("QDGRASP_ASSET_PATH")
    places = [Path(place) for place in named.split(os.pathsep)] if named else [SIBLING]
    for place in places:
        if (place / "reference").is_dir():
            return place
    pytest.skip(f"no reference data in {os.pathsep.join(map(str, places))}; set QDGRASP_ASSET_PATH")
