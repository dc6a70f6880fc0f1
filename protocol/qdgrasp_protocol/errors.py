"""Every error that qdgrasp raises on purpose; those of one module alone are made there.

* QdgraspError
    * InputError             bad input or environment: exit code 2
        * UnknownName            a name that no table has
        * UnknownKey             a key that no field of a spec has
        * ImpossibleValue        a value outside what a field allows
        * EndsTooSoon            a run that is to end before what is recorded of it
        * JawNeeded              a prior for two-finger hands with another hand
        * AssetError             a file, mesh, URDF or gripper that cannot be used
            * LacksReader            a mesh whose format needs a package that is not installed
            * NoDataFolder           a folder in a home that this machine does not have
            * WrongScan              a fetched file is not the one expected
            * UnusableMeshes         mesh files of which no objects can be made
            * DecompositionTimeout   a mesh that is not decomposed in time
            * DecompositionFailure   a mesh on which CoACD fails
        * FolderError            a run folder that cannot be used
            * NoFolder               a path where no folder is
            * DiskFull               there is no room to write in it
            * OutputError            a path where something cannot be written
            * OtherRun               a journal in a folder whose other files are of another run
        * NoSuchRow              a number that no row of a journal has
        * NoSuchTrial            a trial that is not recorded of a row
        * NoPose                 a row without a pose that could be shown
        * UnreadableGrasps       a file that no grasps can be read from
        * ReplayError            a journal that its own spec does not replay to
        * RunFailed              a run of a job that cannot be carried out
        * RunsFailed             runs of a job that could not be, when the others are
        * EndpointError          an endpoint that cannot be listened on or reached
            * NotListening           a router cannot listen there
            * Unreachable            no router answers there
        * SecurityError          certificates or keys that cannot be used
        * MissingRequirement     something that a run needs is not on this machine
        * MissingEngine          Bullet is to simulate where PyBullet is not installed
        * MissingPackage         a package of an extra is needed where it is not installed
    * BusError               the bus did not do what was asked
        * Refused                the other side answered with a reason why not
            * PlatformDiffers        a worker's platform is not the job's
            * LacksEngine            a worker does not have the engine of a run
            * RefusedByJob           the only job of a worker does not take it: exit code 2
        * NoReply                no answer came
        * Faulty                 the other side failed by a fault of its own
    * MessageError           a message that is not of the protocol; counted and dropped
        * TooLarge               a scene that is larger than one can be
    * RecorderFellBack       a recorder that no longer has the rows it reported durable
    * NoSimulator            a simulator that ends before it has evaluated the probes
    * DeviceDiffers          a device on which the probes fare otherwise than in MuJoCo
    * OtherPlatform          the package was changed while a worker ran
    * ReplayFailed           the process that replays ended without an answer
    * BadVerdict             a verdict that is not one on the hands that were given
    * EndedEarly             the job stopped before its budget; `resume` goes on: exit code 1
        * Cancelled              an admin told the coordinator to end: its exit code is 0
        * TookOver               another coordinator goes on with it: exit code 3
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from difflib import get_close_matches
from importlib.util import find_spec
from typing import Self

from qdgrasp_protocol.text import first_few, quoted


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
        more = f" {hint}" if hint else ""
        super().__init__(f"Unknown {kind} '{name}'.{_guess(name, names)} Known: {', '.join(names)}.{more}")


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


class LacksReader(AssetError):
    """A file that cannot be read here, as a package for its format is not installed."""


class NoDataFolder(AssetError):
    """A folder in a home that is not there; `variable` names another one."""

    def __init__(self, folder: object, variable: str) -> None:
        super().__init__(f"There is no home folder for '{folder}': set {variable} to a folder.")


class WrongScan(AssetError):
    """Fetched data that is not the expected scan; it was deleted."""

    def __init__(self, name: str, reason: object) -> None:
        super().__init__(f"The data fetched for '{name}' was thrown away: {reason}")


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


class NoFolder(FolderError):
    """A path that is no folder of a run or job; `is_there`: it is something else."""

    def __init__(self, path: object, *, is_there: bool) -> None:
        super().__init__(
            f"{path} is no folder; name that of a run."
            if is_there
            else f"There is no folder {path}; `qdgrasp run --out {path}` would begin a run there."
        )


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


class OtherRun(FolderError):
    """A journal in a folder where a file is of another run; `of` and `than` tell them in words."""

    def __init__(self, journal: object, file: object, of: str, than: str) -> None:
        super().__init__(
            f"{journal} is the journal of {of}, and {file} is of {than}: restore one of the two from a copy."
        )


class EndsTooSoon(InputError):
    """A run that is to end before what is recorded of it."""

    def __init__(self, folder: object, reason: ImpossibleValue) -> None:
        super().__init__(f"{folder} cannot end as is asked: {reason}")


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

    NAMED = 10
    """Number of runs that are named besides the first."""

    def __init__(self, failures: Sequence[RunFailed], total: int) -> None:
        first, *others = failures
        if total == 1:
            super().__init__(str(first))
            return
        names = first_few(quoted(other.run for other in others), self.NAMED)
        super().__init__(
            f"{len(failures)} of {total} runs could not be carried out; the first is '{first.run}': {first}"
            + (f" The others: {names}." if others else "")
        )


class RecorderFellBack(QdgraspError):
    """A recorder lost rows that it reported durable, or has rows that were never sent."""

    def __init__(self, reported: int, durable: int, sent: int) -> None:
        super().__init__(
            f"The recorder reports {reported} durable rows, expected {durable} to {sent}: its disk was "
            "restored or it serves another coordinator; the run is to be replayed from its journal."
        )
        self.run = ""  # Run of the rows; empty where there is one run only

    def of(self, run: str) -> "RecorderFellBack":
        """The same, for a run."""
        self.run = run
        return self


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

    def __init__(self, job: str, epoch: object) -> None:
        super().__init__(f"Another coordinator of job '{job}' took over (epoch {epoch}).")

    @staticmethod
    def refusal(own: int, other: int) -> Refused:
        """Return a recorder's refusal of a coordinator whose epoch is over."""
        return Refused(f"epoch {own} is over: another coordinator took over with {other}")

    @classmethod
    def told_by(cls, refusal: Exception, job: str) -> "TookOver | None":
        """Return the error if a recorder's refusal is one of `refusal`, else None."""
        found = re.search(r"another coordinator took over with (\d+)", str(refusal))
        return cls(job, found[1]) if found else None


EXTRAS = {
    "export": ("h5py", "pyarrow"),
    "gpu": ("mujoco_warp", "warp"),
    "monitor": ("prometheus_client", "sse_starlette", "starlette", "uvicorn"),
}
"""The packages of each extra of pyproject.toml, as they are imported."""


class MissingPackage(InputError):
    """A package of an extra is needed, and not installed here; `need` is what needs it."""

    def __init__(self, need: str, package: str, extra: str) -> None:
        super().__init__(
            f"{need} needs {package}, which is not installed here; install it with "
            f"`pip install 'qdgrasp[{extra}]'`."
        )
        self._words = need, package, extra

    def __reduce__(self) -> tuple[type[Self], tuple[str, str, str]]:
        """Come out of another process as it is."""
        return type(self), self._words


def check_packages(need: str, *packages: str) -> None:
    """Raise `MissingPackage` for the first of these packages that is not installed here.

    `need` begins the sentence: the format, method or option that cannot do without them.
    """
    for package in packages:
        if find_spec(package) is None:
            raise MissingPackage(need, package, next(name for name in EXTRAS if package in EXTRAS[name]))
