import pytest
from tests.golden import runs


@pytest.fixture
def same_platform() -> None:
    """Skips where digests are others because the platform is (docs/reproducibility.md)."""
    golden, here = runs.golden()["platform"], runs.platform()
    other = [
        f"{name} {here[name]} instead of {golden[name]}" for name in golden if here[name] != golden[name]
    ]
    if other:
        pytest.skip(f"the golden digests are of another platform: here is {', '.join(other)}")
