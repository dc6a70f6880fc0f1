from pathlib import Path

import pytest
from tests.assets.hands import jaw


@pytest.fixture
def jaw_toml(tmp_path: Path) -> Path:
    """The file of the jaw, its URDF beside it."""
    (tmp_path / "jaw.urdf").write_text(jaw.URDF, encoding="utf-8")
    toml = tmp_path / "jaw.toml"
    toml.write_text(jaw.TOML, encoding="utf-8")
    return toml


@pytest.fixture
def jaw_urdf(jaw_toml: Path) -> Path:
    """The URDF of the jaw."""
    return jaw_toml.with_suffix(".urdf")
