"""Which workers may serve one job: those whose results have the same bits (docs/reproducibility.md)."""

from collections.abc import Mapping

from qdgrasp_protocol.errors import Refused

VERSION = "qdgrasp"
"""The version of this package: recorded and told, not compared. The evaluation has its own digest."""


class PlatformDiffers(Refused):
    """A worker's platform is not the one that the job's rows come from."""

    def __init__(self, job: Mapping[str, str], worker: Mapping[str, str]) -> None:
        super().__init__(f"its platform differs: {differences(job, worker)}.")


def differences(job: Mapping[str, str], other: Mapping[str, str]) -> str:
    """What another platform has instead of the job's, in words; empty where results have the same bits."""
    differing = [name for name in sorted({*job, *other}) if job.get(name) != other.get(name)]
    if differing == [VERSION]:
        return ""
    return ", ".join(
        f"{name} {other.get(name, 'absent')[:24]} instead of {job.get(name, 'absent')[:24]}"
        for name in differing
    )


def admit(job: Mapping[str, str], worker: Mapping[str, str]) -> dict[str, str]:
    """The platform of the job once this worker has joined: the first worker sets it.

    Raises
    ------
    PlatformDiffers
        Another platform was there first; what differs is named.
    """
    if job and differences(job, worker):
        raise PlatformDiffers(job, worker)
    return dict(job or worker)
