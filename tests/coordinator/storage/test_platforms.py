"""Which platforms give the same bits."""

import pytest

from qdgrasp_coordinator.storage.run_folder import PlatformDiffers, admit_platform, platform_differences

JOB = {"qdgrasp": "0.1.0", "numpy": "2.4.6", "code": "ab" * 32}


def test_the_first_worker_says_the_platform_of_the_job() -> None:
    assert admit_platform({}, JOB) == JOB


def test_the_version_of_the_package_is_kept_and_not_compared() -> None:
    later = JOB | {"qdgrasp": "0.2.0"}
    assert admit_platform(JOB, later) == JOB
    assert platform_differences(JOB, later) == ""


@pytest.mark.parametrize("other", [{"numpy": "2.5.0"}, {"code": "cd" * 32}, {"machine": "aarch64"}])
def test_all_else_is_compared_and_then_the_version_is_told_too(other: dict[str, str]) -> None:
    (name,) = other
    with pytest.raises(PlatformDiffers, match=f"{name} .* instead of .*, qdgrasp 0.2.0 instead of 0.1.0"):
        admit_platform(JOB, JOB | other | {"qdgrasp": "0.2.0"})
