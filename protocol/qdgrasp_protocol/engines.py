"""Names of the physics engines, and whether they are installed here (docs/engines.md)."""

import sys
from importlib.util import find_spec
from typing import Literal, NamedTuple, Self, get_args

from qdgrasp_protocol.errors import EXTRAS, InputError, check_packages

EngineName = Literal["bullet", "mujoco", "mujoco-warp"]
"""The physics engines (docs/engines.md)."""
ENGINES: tuple[EngineName, ...] = get_args(EngineName)
EngineChoice = Literal[EngineName, "bullet,mujoco", "mujoco,bullet"]
"""An engine, or two: what holds in the first is tried in the second."""
DEFAULT_ENGINE = "bullet"  # Meant where a spec names none
DEVICE_ENGINE: Literal["mujoco-warp"] = "mujoco-warp"  # Of workers with a device alone
DEVICE_VARIABLE = "QDGRASP_DEVICE"  # Variable that names the device of workers
ENGINE_PACKAGES = {"bullet": "pybullet", "mujoco": "mujoco-core", DEVICE_ENGINE: "mujoco-warp"}
LAST_WHEEL = (3, 11)  # The last Python that PyBullet has a wheel for


class MissingEngine(InputError):
    """Bullet is to simulate where PyBullet is not installed."""

    def __init__(self) -> None:
        why, how = "", "install it with `pip install pybullet`"
        if (python := sys.version_info[:2]) > LAST_WHEEL:
            why = f", and it has no wheel for Python {python[0]}.{python[1]}"
            how = "build it with `pip install pybullet`, which takes a C++ compiler and some ten minutes"
        super().__init__(
            f"PyBullet is not installed{why}: add --engine mujoco (not for the protocol released), or {how}."
        )

    def __reduce__(self) -> tuple[type[Self], tuple[()]]:
        """Come out of another process as it is."""
        return type(self), ()


def engine_names(engine: str | None) -> tuple[str, ...]:
    """The engines that a spec or scene names, in the order in which a grasp is tried in them."""
    return tuple((engine or DEFAULT_ENGINE).split(","))


def has_bullet() -> bool:
    """Return whether PyBullet is installed here."""
    return find_spec("pybullet") is not None


def check_engine(engine: str | None) -> None:
    """Raise `MissingEngine` if Bullet (None) is among these, and PyBullet is not installed here."""
    if DEFAULT_ENGINE in engine_names(engine) and not has_bullet():
        raise MissingEngine


MOST_WORLDS = 4096  # Most genomes of a generation
CPU_WORLDS = 64  # On warp's CPU device, which is for tests


class Device(NamedTuple):
    """A device that evaluates many rows together."""

    name: str
    """Its name in warp: cpu, cuda, cuda:1."""
    worlds: int
    """Rows that it evaluates at once."""

    @classmethod
    def find(cls, name: str, worlds: int | None = None) -> Self:
        """A device by its name; None: as many worlds as fill it. An InputError without the packages."""
        check_packages(f"--device {name}", *EXTRAS["gpu"])
        return cls(name, worlds or (CPU_WORLDS if name == "cpu" else MOST_WORLDS))
