"""A campaign: many runs asked for at once, as the crossings of lists in one TOML file.

    prefer_scans = true                # `mug` means the scan `ycb_mug` where that is found

    [defaults]                         # of every run; any key of a run's spec
    evaluations = 10_000

    [[cross]]                          # any number of these; each key one value or a list
    gripper = "panda"
    object = ["rubiks_cube", "mug"]
    method = ["contact_rand", "contact_me_scs"]
    seed = [0, 1]

    [objects."parts/lever.stl"]        # what is known of a mesh file, in every run of it
    mass = 0.3
    scale = 0.001

A run's name says what it is and does not depend on the other runs, so that a campaign can grow.
"""

import hashlib
import itertools
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import tomli_w

from qdgrasp_assets import ycb
from qdgrasp_assets.catalog import ABSENT, check_object, find_gripper
from qdgrasp_assets.genes import ANTIPODAL
from qdgrasp_coordinator.runs.preparation import full_spec, located
from qdgrasp_coordinator.searches.search import method
from qdgrasp_protocol.errors import ImpossibleValue, InputError, JawNeeded, UnknownKey
from qdgrasp_protocol.keys import job_name
from qdgrasp_protocol.phrases import counted
from qdgrasp_protocol.spec import DEFAULT_METHOD, GOALS, RunSpec, read_run_spec

SHORT = {
    "mutation_sigma": "sigma",
    "mutation_probability": "rate",
    "generations_in_flight": "flight",
    "surface_seed": "surface",
    "protocol": "",
    "overlaps": "",
}
"""How keys are called in the names of runs, where not by themselves."""
NAMED = ("gripper", "object", "method", "seed")
"""What every run's name begins with; these must be said."""
USUAL = {"method": DEFAULT_METHOD, "generations_in_flight": 1}
"""What a run of a campaign has unless the file says otherwise. A second generation in flight keeps the
workers of a single run busy; here other runs do, and the search hears of all that it asked."""
LONGEST = 64
KEYS = frozenset({"prefer_scans", "defaults", "cross", "objects"})
OF_OBJECT = frozenset({"mass", "scale", "friction"})
"""What may be said of an object: no part of the names of its runs, and before what the defaults say."""

Objects = Mapping[str, Mapping[str, Any]]
"""What is known of objects, by name."""


@dataclass(frozen=True)
class Campaign:
    """Runs by name, in the order in which they are begun."""

    runs: Mapping[str, RunSpec]
    source: Mapping[str, Any]
    """The file's content, with objects as they were taken."""
    scans: tuple[str, ...] = ()
    """Objects that were taken as their scans."""
    stand_ins: tuple[str, ...] = ()
    """Objects whose scans were preferred and not found."""

    @property
    def evaluations(self) -> int:
        """The budgets of all runs."""
        return sum(spec.evaluations for spec in self.runs.values())

    @property
    def toml(self) -> str:
        """The campaign as a file that means the same on every machine."""
        return tomli_w.dumps(self.source)

    @property
    def words(self) -> str:
        """One sentence for a person."""
        parts = [f"{counted(len(self.runs), 'run')}, {counted(self.evaluations, 'evaluation')} in all"]
        if self.scans:
            parts.append(f"scans of {', '.join(self.scans)}")
        if self.stand_ins:
            parts.append(f"no scan found of {', '.join(self.stand_ins)}: stand-ins, without S_G coverage")
        return "; ".join(parts) + "."


def read_campaign(
    path: Path, *, here: bool = True, goals: Mapping[str, int | None] = MappingProxyType({})
) -> Campaign:
    """The campaign in a TOML file.

    Parameters
    ----------
    here
        Whether its grippers and objects must be on this machine.
    goals
        What ends runs, by keys of a spec, in place of what the file's defaults say; None: what they say.

    Raises
    ------
    InputError
        There is no such file, it is not TOML, or it asks for a run that cannot be; the run is named.
    """
    source, asked = read_run_spec(path), {key: value for key, value in goals.items() if value is not None}
    if asked and isinstance(source.get("defaults", {}), dict):
        source["defaults"] = source.get("defaults", {}) | asked
    return campaign(source, str(path), here=here)


def is_campaign(path: Path) -> bool:
    """Whether a TOML file is a campaign's, not a run's; raises as `read_campaign` where it is no TOML."""
    return not KEYS.isdisjoint(read_run_spec(path))


def campaign(source: dict[str, Any], where: str, *, here: bool = True) -> Campaign:
    """The campaign that a file's content stands for; parameters and errors as those of `read_campaign`."""
    _check(source, where)
    assets = Assets(prefer_scans=source.get("prefer_scans", False))
    defaults = assets.taken(USUAL | source.get("defaults", {}))
    crosses = [assets.taken(cross) for cross in source["cross"]]
    objects = {located(name): dict(known) for name, known in source.get("objects", {}).items()}
    runs: dict[str, RunSpec] = {}
    for values, known in _crossed(defaults, crosses, objects, where):
        _add(runs, values, known, where)
    _check_known(objects, {spec.object for spec in runs.values()}, where)
    if here:
        _check_assets(runs.values())
    resolved = {"defaults": defaults, "cross": crosses} | ({"objects": objects} if objects else {})
    return Campaign(runs, resolved, tuple(assets.scans), tuple(assets.stand_ins))


def run_name(spec: RunSpec, said: Mapping[str, Any]) -> str:
    """The name of a run: its gripper, object, method and seed, and whatever else is not as usual.

    Parameters
    ----------
    said
        The values that the campaign gave for it; when it ends is no part of its name.
    """
    parts = [Path(spec.gripper).stem, Path(spec.object).stem, spec.method, f"s{spec.seed}"]
    usual = full_spec(USUAL | {key: getattr(spec, key) for key in ("gripper", "object", "method")})
    others = sorted(said.keys() - {*NAMED, *GOALS})
    told = [key for key in others if getattr(spec, key) != getattr(usual, key)]
    parts += [f"{SHORT.get(key, key)}{getattr(spec, key)}".replace(".", "_") for key in told]
    return _fitting("-".join(parts))


class Assets:
    """The grippers and objects of a campaign as they are taken, and what is to be said of that.

    Parameters
    ----------
    prefer_scans
        Whether an object is taken as its scan where that is found.
    """

    def __init__(self, *, prefer_scans: bool) -> None:
        self._prefer_scans = prefer_scans
        self.scans: dict[str, None] = {}
        self.stand_ins: dict[str, None] = {}

    def taken(self, values: dict[str, Any]) -> dict[str, Any]:
        """Values of a crossing with its files as absolute paths and its objects as they are taken."""
        takers = {"gripper": located, "object": self._object}
        return {key: _each(value, takers.get(key, lambda one: one)) for key, value in values.items()}

    def _object(self, name: Any) -> Any:
        scan = f"{ycb.PREFIX}{name}"
        if not self._prefer_scans or scan not in ycb.SCANS:
            return located(name)
        if ycb.source(scan) == ABSENT:
            self.stand_ins[name] = None
            return name
        self.scans[name] = None
        return scan


def _each(value: Any, act: Callable[[Any], Any]) -> Any:
    return [act(one) for one in value] if isinstance(value, list) else act(value)


def _check_assets(specs: Collection[RunSpec]) -> None:
    """Check that all grippers and objects are there, and that the methods are for such hands."""
    jawless = {name for name in {spec.gripper for spec in specs} if find_gripper(name).file.jaw is None}
    for name in {spec.object for spec in specs}:
        check_object(name)
    for spec in specs:
        if method(spec.method).prior == ANTIPODAL and spec.gripper in jawless:
            raise JawNeeded(ANTIPODAL, Path(spec.gripper).stem)


def _check_known(objects: Objects, used: Collection[str], where: str) -> None:
    """Check that what is known of objects is of objects that a run has."""
    for name in objects:
        if name not in used:
            raise InputError(
                f"{where} says what is known of '{name}', which no run grasps; name it as `object` of a "
                "[[cross]], in the same words."
            )


def _check(source: dict[str, Any], where: str) -> None:
    """Check what is not a run's."""
    for key in source:
        if key not in KEYS:
            raise UnknownKey(where, key, sorted(KEYS))
    crosses = source.get("cross")
    if not isinstance(crosses, list) or not crosses or not all(isinstance(c, dict) for c in crosses):
        raise InputError(
            f"{where} asks for no run: give at least one [[cross]] with gripper, object, method."
        )
    if not isinstance(source.get("defaults", {}), dict):
        raise ImpossibleValue(f"{where}: defaults", source["defaults"], "a table of keys of a run's spec")
    objects = source.get("objects", {})
    if not isinstance(objects, dict) or not all(isinstance(known, dict) for known in objects.values()):
        raise ImpossibleValue(f"{where}: objects", objects, "a table for each mesh file")
    for name, known in objects.items():
        if unknown := [key for key in known if key not in OF_OBJECT]:
            raise UnknownKey(f"{where}: objects.'{name}'", unknown[0], OF_OBJECT)
    if not isinstance(source.get("prefer_scans", False), bool):
        raise ImpossibleValue(f"{where}: prefer_scans", source["prefer_scans"], "true or false")


def _crossed(
    defaults: dict[str, Any], crosses: list[dict[str, Any]], objects: Objects, where: str
) -> Iterator[tuple[dict[str, Any], dict[str, Any]]]:
    """The values of each run, and what is known of its object; those named first in `NAMED` change last."""
    for cross in crosses:
        whole = defaults | cross
        if empty := [key for key, value in whole.items() if value == []]:
            raise ImpossibleValue(f"{where}: {empty[0]}", [], "one value, or a list of at least one")
        order = sorted(whole, key=lambda key: NAMED.index(key) if key in NAMED else len(NAMED))
        axes = [whole[key] if isinstance(whole[key], list) else [whole[key]] for key in order]
        for each in itertools.product(*axes):
            values = dict(zip(order, each, strict=True))
            told = objects.get(values.get("object", ""), {})
            known = {key: value for key, value in told.items() if key not in cross}
            yield {key: value for key, value in values.items() if key not in known}, known


def _add(runs: dict[str, RunSpec], values: dict[str, Any], known: dict[str, Any], where: str) -> None:
    spec = full_spec(values | known, where)
    name = run_name(spec, values)
    if runs.setdefault(name, spec) != spec:
        raise InputError(
            f"{where} asks for run '{name}' twice, with different values; let each run differ in its "
            "gripper, object, method or seed, or in a key of its spec that does not say when it ends."
        )


def _fitting(name: str) -> str:
    """A name in the allowed characters; a long one is cut, with a mark that keeps it apart from others."""
    if len(name) <= LONGEST:
        return job_name(name)
    mark = hashlib.sha256(name.encode()).hexdigest()[:8]
    return f"{job_name(name)[: LONGEST - 9]}-{mark}"
