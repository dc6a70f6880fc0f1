"""Platforms: which workers may serve a job, and in what two platforms differ.

Rows of one job come from workers of one platform, whose results have the same bits.
"""

from collections.abc import Mapping

from qdgrasp_protocol.errors import Refused
from qdgrasp_protocol.spec import DEVICE_ENGINE, ENGINE_PACKAGES, engine_names

VERSION = "qdgrasp"  # The version of this package: recorded and shown, not compared
IN_MUJOCO = ("mujoco", "mujoco_probes")
ENGINE_ENTRIES = {
    "bullet": ("pybullet", "probes"),
    "mujoco": IN_MUJOCO,
    "mujoco-fine": IN_MUJOCO,
    DEVICE_ENGINE: (DEVICE_ENGINE, "warp", "warp_device", *IN_MUJOCO),
}
"""Entries of a platform that concern the rows of an engine alone, first its version.

The platform of rows of another engine lacks them, and so does that of a machine without the engine.
"""
ENGINE_NAMES = {name for names in ENGINE_ENTRIES.values() for name in names}


class LacksEngine(Refused):
    """A worker does not have the engine of a run that is carried out."""

    def __init__(self, run: str, engine: str | None) -> None:
        package = " and ".join(ENGINE_PACKAGES[name] for name in engine_names(engine))
        super().__init__(
            f"run '{run}' is simulated in {package}, which is not installed there; install it, or start the "
            "worker where it is"
        )


def platform_differences(job: Mapping[str, str], other: Mapping[str, str]) -> str:
    """Describe the entries in which another platform differs from the job's."""
    compared = sorted({*job, *other} - ENGINE_NAMES | ENGINE_NAMES & {*job} & {*other})
    differing = [name for name in compared if job.get(name) != other.get(name)]
    if differing == [VERSION]:
        return ""
    return ", ".join(
        f"{name} {other.get(name, 'absent')[:24]} instead of {job.get(name, 'absent')[:24]}"
        for name in differing
    )


def admit_platform(job: Mapping[str, str], worker: Mapping[str, str]) -> dict[str, str]:
    """The platform of the job once this worker has joined: the first worker sets it.

    Raises `Refused` where another platform was there first; what differs is named.
    """
    if job and (differing := platform_differences(job, worker)):
        raise Refused(f"its platform differs: {differing}")
    if not job:
        return dict(worker)
    return {name: worker[name] for name in sorted(ENGINE_NAMES & {*worker})} | dict(job)


def platform_of(engine: str | None, platform: Mapping[str, str]) -> dict[str, str]:
    """The part of a platform that concerns the rows of an engine, or of two; None: Bullet."""
    others = ENGINE_NAMES.difference(*(ENGINE_ENTRIES[name] for name in engine_names(engine)))
    return {name: value for name, value in platform.items() if name not in others}


def is_of_gpu(platform: Mapping[str, str]) -> bool:
    """Return whether a platform has a GPU, on which the bits of rows are not fixed."""
    return platform.get("warp_device", "CPU") != "CPU"


def lacks_engine(engine: str | None, platform: Mapping[str, str]) -> bool:
    """Return whether a worker's platform has engines, and not this one or these; None: Bullet.

    Rows of a device are leased to workers that have it alone; others may serve a job beside them.
    """
    wanted = {ENGINE_ENTRIES[name][0] for name in engine_names(engine) if name != DEVICE_ENGINE}
    return not ENGINE_NAMES.isdisjoint(platform) and not wanted <= platform.keys()
