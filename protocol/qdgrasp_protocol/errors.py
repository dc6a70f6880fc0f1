"""Errors of several modules; those of one module alone are made there.

`QdgraspError` is the root of all. `InputError` is about what the user can correct, `BusError` and
`MessageError` are about what other processes do.
"""

from collections.abc import Iterable, Mapping, Sequence
from difflib import get_close_matches
from importlib.util import find_spec


class QdgraspError(Exception):
    """Base class of all errors; `exit_code` is that of a command that ends with it."""

    exit_code = 1


class InputError(QdgraspError):
    """Bad input or environment, said in one sentence."""

    exit_code = 2


class UnknownName(InputError):
    """A name of some kind ("gripper", "object" ...) that no table has; `hint` is further advice."""

    def __init__(self, kind: str, name: str, known: Iterable[str], hint: str = "") -> None:
        names = sorted(known)
        more, listed = f" {hint}" if hint else "", ", ".join(names) or "none"
        super().__init__(f"Unknown {kind} '{name}'.{_guess(name, names)} Known: {listed}.{more}")


class UnknownKey(InputError):
    """A key in a TOML file that no field has."""

    def __init__(self, where: str, key: str, known: Iterable[str]) -> None:
        names = sorted(known)
        super().__init__(f"{where}: unknown key '{key}'.{_guess(key, names)} Known keys: {', '.join(names)}.")


def _guess(name: str, names: Sequence[str]) -> str:
    """Suggest the name that may have been meant, in a sentence; empty if no name is near."""
    close = get_close_matches(name, names, n=1)
    return f" Did you mean '{close[0]}'?" if close else ""


class ImpossibleValue(InputError):
    """A value outside what a field allows."""

    def __init__(self, field: str, value: object, expected: str) -> None:
        super().__init__(f"{field} must be {expected}, got {value!r}.")


class AssetError(InputError):
    """A file, mesh, URDF or gripper that cannot be used."""


class UnreadableHere(AssetError):
    """A file that another machine may read: a package or a home folder is lacking on this one."""


class UnusableMeshes(AssetError):
    """Mesh files of which no objects can be made, with the fault of each; nothing was begun."""

    def __init__(self, total: int, faults: Mapping[str, str]) -> None:
        told = "".join(f"\n  {name}: {why}" for name, why in faults.items())
        super().__init__(
            f"{len(faults)} of {total} meshes cannot be used as they are, and nothing was begun; `qdgrasp "
            f"object check FILE` says more of each:{told}"
        )


class FolderError(InputError):
    """A run folder that cannot be used."""


class DiskFull(FolderError):
    """No disk space to write in a run folder; earlier content is intact."""


class OutputError(FolderError):
    """A path where something cannot be written; what is there was left as it was.

    `why` completes the sentence that the path begins, `instead` is advice, empty where there is none, and
    `forces` says that `--force` helps too.
    """

    def __init__(self, path: object, why: str, instead: str = "", *, forces: bool = False) -> None:
        advice = ", or ".join([instead] * bool(instead) + ["replace it with --force"] * forces)
        super().__init__(f"{path} {why}{'; ' if advice else ''}{advice}.")


class JawNeeded(InputError):
    """A prior for two-finger hands was asked for with another hand."""

    def __init__(self, prior: str, gripper: str) -> None:
        super().__init__(
            f"The prior '{prior}' is for two-finger hands, and the gripper '{gripper}' has no [jaw]; "
            "choose a method with another prior (`qdgrasp methods` lists them)."
        )


class EndpointError(InputError):
    """An endpoint that cannot be listened on or reached."""


class SecurityError(InputError):
    """Certificates or keys that cannot be used."""


class BusError(QdgraspError):
    """Failure of an operation on the bus."""


class Refused(BusError):
    """Refusal of a query by the other side, with its reason."""


class NoReply(BusError):
    """Query without an answer in time."""


class Faulty(BusError):
    """Internal error of the side that was queried, logged there; a retry may succeed."""


class MessageError(QdgraspError):
    """A message that is not of the protocol; it is counted and dropped."""


class ReplayError(InputError):
    """A journal that its own spec does not replay to."""


class RunFailed(InputError):
    """A run of a job that cannot be carried out, with the reason as a sentence."""

    def __init__(self, run: str, reason: str) -> None:
        super().__init__(reason)
        self.run = run


class RunsFailed(InputError):
    """Runs of a job, one or more of a total, that could not be carried out, when the others are."""

    def __init__(self, failures: Sequence[RunFailed], total: int) -> None:
        first, how_many = failures[0], f"{len(failures)} of {total} runs could not be carried out"
        super().__init__(f"{how_many}; the first is '{first.run}': {first}" if total > 1 else str(first))


class RecorderFellBack(QdgraspError):
    """A recorder lost rows that it reported durable, or has rows that were never sent."""

    def __init__(self, reported: int, durable: int, sent: int) -> None:
        super().__init__(
            f"The recorder reports {reported} durable rows, expected {durable} to {sent}: its disk was "
            "restored or it serves another coordinator; the run is to be replayed from its journal."
        )


class EndedEarly(QdgraspError):
    """End of a job before its budget; `qdgrasp resume` continues it."""


class Cancelled(EndedEarly):
    """The job's coordinator was told by an admin to end, which it does as asked.

    To the coordinator this is no failure, and it is not to be started again. To those who wait for the job,
    such as `qdgrasp run`, it is an `EndedEarly` like any other.
    """

    exit_code = 0

    def __init__(self, job: str) -> None:
        super().__init__(f"Job '{job}' was cancelled.")


class TookOver(EndedEarly):
    """Another coordinator goes on with the job; this one ends, and is not to be started again."""

    exit_code = 3
    BY = "another coordinator took over with"
    """Words of a recorder's refusal, before the epoch of the other coordinator."""

    def __init__(self, job: str, epoch: object) -> None:
        super().__init__(f"Another coordinator of job '{job}' took over (epoch {epoch}).")


EXTRAS = {
    "arm": ("pinocchio",),
    "export": ("h5py", "pyarrow"),
    "gpu": ("mujoco_warp", "warp"),
    "monitor": ("prometheus_client", "sse_starlette", "starlette", "uvicorn"),
}
"""The packages of each extra of pyproject.toml, as they are imported."""


def check_packages(need: str, *packages: str) -> None:
    """Raise `InputError` for the first of these packages that is not installed here.

    `need` begins the sentence: the format, method or option that cannot do without them.
    """
    for package in packages:
        if find_spec(package) is None:
            wanted = next((f"'qdgrasp[{name}]'" for name in EXTRAS if package in EXTRAS[name]), package)
            raise InputError(
                f"{need} needs {package}, which is not installed here; install it with "
                f"`pip install {wanted}`."
            )
