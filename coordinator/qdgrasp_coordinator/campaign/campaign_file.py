"""Reads a campaign: the runs that a TOML file or a folder of meshes asks for.

Mesh files are read before anything is begun, so that all faults are told at once.
"""

import csv
import hashlib
import itertools
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import tomli_w

from qdgrasp_assets import ycb
from qdgrasp_assets.asset_paths import named_path
from qdgrasp_assets.catalog import ABSENT, check_object, find_gripper
from qdgrasp_assets.genes import ANTIPODAL
from qdgrasp_assets.geometry.mesh_io import FORMAT_PACKAGES, READABLE_FORMATS
from qdgrasp_assets.object_model import ObjectDraft, read_draft
from qdgrasp_assets.stand_ins import STAND_INS
from qdgrasp_assets.ycb import SCANS
from qdgrasp_coordinator.scheduler.run_plan import absolute_asset, full_spec
from qdgrasp_coordinator.search.registry import method
from qdgrasp_protocol.errors import (
    AssetError,
    ImpossibleValue,
    InputError,
    JawNeeded,
    UnknownKey,
    UnusableMeshes,
)
from qdgrasp_protocol.keys import job_name
from qdgrasp_protocol.spec import DEFAULT_METHOD, STOP_KEYS, RunSpec, read_run_spec
from qdgrasp_protocol.text import counted

SHORT_KEYS = {
    "mutation_sigma": "sigma",
    "mutation_probability": "rate",
    "generations_in_flight": "flight",
    "surface_seed": "surface",
    "protocol": "",
    "overlaps": "",
}
"""Short forms of keys in the names of runs."""
NAME_KEYS = ("gripper", "object", "method", "seed")  # Keys that every run's name begins with
CAMPAIGN_DEFAULTS = {"method": DEFAULT_METHOD, "generations_in_flight": 1}
"""Defaults of a campaign's runs.

A second generation in flight keeps the workers of a single run busy; here other runs do, and the search
is told all that it asked.
"""
LONGEST_NAME = 64
CAMPAIGN_KEYS = frozenset({"prefer_scans", "defaults", "cross", "objects"})
OBJECT_KEYS = frozenset({"mass", "scale", "friction"})
"""Keys of an object: left out of its runs' names, and stronger than the defaults."""

ObjectValues = Mapping[str, Mapping[str, Any]]
"""Mass, scale and friction of objects, by name, as far as they are known."""


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
        """Sum of the budgets of all runs."""
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
    return make_campaign(source, str(path), here=here)


def is_campaign(path: Path) -> bool:
    """Return whether a TOML file is a campaign's, not a run's; raises as `read_campaign`."""
    return not CAMPAIGN_KEYS.isdisjoint(read_run_spec(path))


def make_campaign(source: dict[str, Any], where: str, *, here: bool = True) -> Campaign:
    """Return the campaign of a file's content; parameters and errors as of `read_campaign`."""
    _check_tables(source, where)
    assets = AssetNames(prefer_scans=source.get("prefer_scans", False))
    defaults = assets.taken(CAMPAIGN_DEFAULTS | source.get("defaults", {}))
    crosses = [assets.taken(cross) for cross in source["cross"]]
    objects = {absolute_asset(name): dict(known) for name, known in source.get("objects", {}).items()}
    runs: dict[str, RunSpec] = {}
    for values, known in _cross_lists(defaults, crosses, objects, where):
        _add_run(runs, values, known, where)
    _check_known(objects, {spec.object for spec in runs.values()}, where)
    if here:
        _check_assets(runs.values())
    resolved = {"defaults": defaults, "cross": crosses} | ({"objects": objects} if objects else {})
    return Campaign(runs, resolved, tuple(assets.scans), tuple(assets.stand_ins))


def run_name(spec: RunSpec, said: Mapping[str, Any]) -> str:
    """Return the name of a run: gripper, object, method, seed, and whatever is not as usual.

    Parameters
    ----------
    said
        The values that the campaign gave for it; when it ends is no part of its name.
    """
    parts = [Path(spec.gripper).stem, Path(spec.object).stem, spec.method, f"s{spec.seed}"]
    usual = full_spec(
        CAMPAIGN_DEFAULTS | {key: getattr(spec, key) for key in ("gripper", "object", "method")}
    )
    others = sorted(said.keys() - {*NAME_KEYS, *STOP_KEYS})
    told = [key for key in others if getattr(spec, key) != getattr(usual, key)]
    parts += [f"{SHORT_KEYS.get(key, key)}{getattr(spec, key)}".replace(".", "_") for key in told]
    return _shortened("-".join(parts))


class AssetNames:
    """Resolves grippers and objects of a campaign, and notes scans and stand-ins.

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
        takers = {"gripper": absolute_asset, "object": self._object}
        return {key: _map_values(value, takers.get(key, lambda one: one)) for key, value in values.items()}

    def _object(self, name: Any) -> Any:
        scan = f"{ycb.PREFIX}{name}"
        if not self._prefer_scans or scan not in ycb.SCAN_NAMES:
            return absolute_asset(name)
        if ycb.scan_source(scan) == ABSENT:
            self.stand_ins[name] = None
            return name
        self.scans[name] = None
        return scan


def _map_values(value: Any, act: Callable[[Any], Any]) -> Any:
    return [act(one) for one in value] if isinstance(value, list) else act(value)


def _check_assets(specs: Collection[RunSpec]) -> None:
    """Check that all grippers and objects are there, and that the methods are for such hands."""
    jawless = {name for name in {spec.gripper for spec in specs} if find_gripper(name).file.jaw is None}
    for name in {spec.object for spec in specs}:
        check_object(name)
    for spec in specs:
        if method(spec.method).prior == ANTIPODAL and spec.gripper in jawless:
            raise JawNeeded(ANTIPODAL, Path(spec.gripper).stem)


def _check_known(objects: ObjectValues, used: Collection[str], where: str) -> None:
    """Check that every object with known values is grasped by a run."""
    for name in objects:
        if name not in used:
            raise InputError(
                f"{where} says what is known of '{name}', which no run grasps; name it as `object` of a "
                "[[cross]], in the same words."
            )


def _check_tables(source: dict[str, Any], where: str) -> None:
    """Check the keys of a campaign's file that are not a run's."""
    for key in source:
        if key not in CAMPAIGN_KEYS:
            raise UnknownKey(where, key, sorted(CAMPAIGN_KEYS))
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
        if unknown := [key for key in known if key not in OBJECT_KEYS]:
            raise UnknownKey(f"{where}: objects.'{name}'", unknown[0], OBJECT_KEYS)
    if not isinstance(source.get("prefer_scans", False), bool):
        raise ImpossibleValue(f"{where}: prefer_scans", source["prefer_scans"], "true or false")


def _cross_lists(
    defaults: dict[str, Any], crosses: list[dict[str, Any]], objects: ObjectValues, where: str
) -> Iterator[tuple[dict[str, Any], dict[str, Any]]]:
    """Yield each run's values and those known of its object; first in `NAMED` change last."""
    for cross in crosses:
        whole = defaults | cross
        if empty := [key for key, value in whole.items() if value == []]:
            raise ImpossibleValue(f"{where}: {empty[0]}", [], "one value, or a list of at least one")
        order = sorted(whole, key=lambda key: NAME_KEYS.index(key) if key in NAME_KEYS else len(NAME_KEYS))
        axes = [whole[key] if isinstance(whole[key], list) else [whole[key]] for key in order]
        for each in itertools.product(*axes):
            values = dict(zip(order, each, strict=True))
            told = objects.get(values.get("object", ""), {})
            known = {key: value for key, value in told.items() if key not in cross}
            yield {key: value for key, value in values.items() if key not in known}, known


def _add_run(runs: dict[str, RunSpec], values: dict[str, Any], known: dict[str, Any], where: str) -> None:
    spec = full_spec(values | known, where)
    name = run_name(spec, values)
    if runs.setdefault(name, spec) != spec:
        raise InputError(
            f"{where} asks for run '{name}' twice, with different values; let each run differ in its "
            "gripper, object, method or seed, or in a key of its spec that does not say when it ends."
        )


def _shortened(name: str) -> str:
    """Return a name in the allowed characters; a long one is cut, and marked by its digest."""
    if len(name) <= LONGEST_NAME:
        return job_name(name)
    mark = hashlib.sha256(name.encode()).hexdigest()[:8]
    return f"{job_name(name)[: LONGEST_NAME - 9]}-{mark}"


MASS_TABLE = "masses.csv"  # The table of masses in a folder of meshes
MASS_COLUMNS = ["file", "mass"]
MASS_DIGITS = 6  # Significant digits of a mass that follows from a density
GREATEST_MASS = 1000  # Greatest mass that a spec allows [kg]
NO_MASS = "it has no mass: say what it weighs with --mass or --density, or in " + MASS_TABLE


@dataclass(frozen=True)
class MassRule:
    """Mass or density of objects that the table of masses does not name; one of them, or none."""

    mass: float | None = None
    """Mass of each [kg]."""
    density: float | None = None
    """Density of each [kg/m3]."""

    def of(self, draft: ObjectDraft) -> float | None:
        """The mass of a mesh [kg]; None: it is not said."""
        if self.density is None:
            return self.mass
        return float(f"{self.density * draft.mesh.volume:.{MASS_DIGITS}g}")


def campaign_of_meshes(
    folder: Path, weighing: MassRule, scale: float | None, said: Mapping[str, Any]
) -> Campaign:
    """The campaign of all meshes in a folder.

    Parameters
    ----------
    scale
        Metres to a unit of each file; None: 1.
    said
        Values or lists of keys of a spec, crossed as in a campaign's file; None: not said.

    Raises
    ------
    InputError
        As in `mesh_values`, or a run is asked for that cannot be.
    """
    known = mesh_values(folder, weighing, scale)
    cross = {key: value for key, value in said.items() if value is not None} | {"object": list(known)}
    return make_campaign({"cross": [cross], "objects": known}, f"campaign of {folder}")


def mesh_values(folder: Path, weighing: MassRule, scale: float | None) -> dict[str, dict[str, float]]:
    """Return the keys `mass` and `scale` of a spec for every mesh in a folder, by its path.

    Raises
    ------
    InputError
        There is no such folder, no mesh in it, or its table of masses cannot be read.
    UnusableMeshes
        Of some of them no object can be made, or what they weigh is not known.
    """
    files, masses = _mesh_files(folder), _read_masses(folder / MASS_TABLE)
    faults = _name_clashes(files.values())
    faults |= dict.fromkeys(masses.keys() - files.keys(), f"{MASS_TABLE} names it, and there is no such mesh")
    known: dict[str, dict[str, float]] = {}
    for name, file in files.items():
        draft = _read_mesh(file, scale)
        mass = masses[name] if name in masses else weighing.of(draft)
        why = _mesh_fault(draft, mass)
        if why or mass is None:
            faults.setdefault(name, why)
        else:
            known[str(file)] = {"mass": mass} | ({} if scale is None else {"scale": scale})
    if faults:
        raise UnusableMeshes(len(files.keys() | masses.keys()), faults)
    return known


def check_meshes(specs: Iterable[RunSpec]) -> None:
    """Check that an object can be made of every mesh file that runs grasp.

    Raises
    ------
    UnusableMeshes
        Of some of them it cannot.
    """
    named = STAND_INS.keys() | SCANS.keys()
    wanted = {(spec.object, spec.scale): spec.mass for spec in specs if spec.object not in named}
    faults: dict[str, str] = {}
    for (name, scale), mass in wanted.items():
        if why := _mesh_fault(_read_mesh(named_path(name), scale), mass):
            faults[name] = why
    if faults:
        raise UnusableMeshes(len({name for name, _ in wanted}), faults)


def _mesh_fault(draft: ObjectDraft, mass: float | None) -> str:
    """Return the reason why no object can be made of a mesh; empty where one can."""
    if draft.faults:
        return "; and ".join(draft.faults)
    if mass is None:
        return NO_MASS
    return (
        ""
        if 0 < mass <= GREATEST_MASS
        else f"its mass must be more than 0 and at most {GREATEST_MASS} kg, got {mass:g}"
    )


def _mesh_files(folder: Path) -> dict[str, Path]:
    """The meshes in a folder by their names."""
    if not folder.is_dir():
        raise InputError(f"There is no folder of meshes at '{folder}'.")
    kinds = {*READABLE_FORMATS, *FORMAT_PACKAGES}
    found = sorted(file for file in folder.iterdir() if file.is_file() and file.suffix.lower() in kinds)
    if not found:
        raise InputError(
            f"There is no mesh in '{folder}': name a folder of files such as {', '.join(READABLE_FORMATS)}."
        )
    return {file.name: file.resolve() for file in found}


def _read_masses(table: Path) -> dict[str, float]:
    """The masses [kg] that a table names, by file; none where there is no table."""
    if not table.is_file():
        return {}
    try:
        with table.open(encoding="utf-8-sig", newline="") as lines:
            rows = [[cell.strip() for cell in row] for row in csv.reader(lines) if row]
        header, *rest = rows
        return {name: float(mass) for name, mass in rest} if header == MASS_COLUMNS else _refuse_table(table)
    except (OSError, ValueError) as error:
        return _refuse_table(table, f": {error}")


def _refuse_table(table: Path, why: str = "") -> dict[str, float]:
    raise InputError(
        f"'{table}' is no table of masses: it begins with the line "
        f"`{','.join(MASS_COLUMNS)}`, and every other "
        f"one is a mesh's file name and its mass in kg{why}."
    )


def _name_clashes(files: Iterable[Path]) -> dict[str, str]:
    """Meshes whose runs would be called as those of another one."""
    first, faults = dict[str, str](), dict[str, str]()
    for file in files:
        other = first.setdefault(job_name(f"a-{file.stem}"), file.name)
        if other != file.name:
            faults[file.name] = f"its runs would be called as those of '{other}': rename one of the two"
    return faults


def _read_mesh(file: Path, scale: float | None) -> ObjectDraft:
    """A mesh file as an object would be made of it; what cannot be read at all is a fault too."""
    try:
        return read_draft(file, scale)
    except AssetError as error:
        return ObjectDraft.unread(str(error))
