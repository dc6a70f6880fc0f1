"""Reads a campaign: the runs that a TOML file or a folder of meshes asks for.

Mesh files are read before anything is begun, so that all faults are named at once.
"""

import csv
import hashlib
import itertools
from collections.abc import Collection, Iterable, Iterator, Mapping
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
from qdgrasp_coordinator.search.registry import method, prior_of
from qdgrasp_protocol.errors import (
    AssetError,
    ImpossibleValue,
    InputError,
    JawNeeded,
    UnknownKey,
    UnusableMeshes,
)
from qdgrasp_protocol.keys import job_name
from qdgrasp_protocol.spec import (
    DEFAULT_METHOD,
    OBJECTIVE_KEYS,
    STOP_KEYS,
    RunSpec,
    read_run_spec,
    run_spec,
)
from qdgrasp_protocol.text import counted

SHORT_KEYS = {
    "mutation_sigma": "sigma",
    "mutation_probability": "rate",
    "generations_in_flight": "flight",
    "surface_seed": "surface",
    "protocol": "",
    "overlaps": "",
    "aim_for": "",
    "trials": "",
    "diversity": "",
    "grasps_per_cell": "grasps",
}
"""Short forms of keys in the names of runs."""
NAME_KEYS = ("gripper", "object", "method", "seed")  # Keys that every run's name begins with
CAMPAIGN_DEFAULTS = {"method": DEFAULT_METHOD, "generations_in_flight": 1}
"""Defaults of a campaign's runs.

A second generation in flight keeps the workers of a single run busy; here other runs do, and the search is
told all that it asked.
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
    """The file's content, with objects as they were resolved."""
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
    path: Path,
    *,
    here: bool = True,
    is_begun: bool = False,
    goals: Mapping[str, int | None] = MappingProxyType({}),
) -> Campaign:
    """Read the campaign in a TOML file.

    `here` checks that its grippers and objects are on this machine; `is_begun`: it may have been begun by a
    version without objectives, which a missing `aim_for` then means; `goals` are values of a spec's keys that
    end runs, in place of the file's defaults.
    Raises InputError if the file is missing, is not TOML, or asks
    for a run that is not possible; the run is named.
    """
    source, asked = read_run_spec(path), {key: value for key, value in goals.items() if value is not None}
    if asked and isinstance(source.get("defaults", {}), dict):
        source["defaults"] = source.get("defaults", {}) | asked
    return make_campaign(source, str(path), here=here, is_begun=is_begun)


def is_campaign(path: Path) -> bool:
    """Return whether a TOML file is a campaign's, not a run's; raises as `read_campaign`."""
    return not CAMPAIGN_KEYS.isdisjoint(read_run_spec(path))


def make_campaign(
    source: dict[str, Any], where: str, *, here: bool = True, is_begun: bool = False
) -> Campaign:
    """Make the campaign of a file's content; parameters and errors as of `read_campaign`."""
    _check_tables(source, where)
    objective = {"aim_for": method(DEFAULT_METHOD).aim_for}
    if not is_begun:  # the folder's file says it; one without was begun when there was no choice
        source = source | {"defaults": objective | source.get("defaults", {})}
    assets = AssetNames(prefer_scans=source.get("prefer_scans", False))
    defaults = assets.resolve(CAMPAIGN_DEFAULTS | {"aim_for": None} | source.get("defaults", {}))
    crosses = [assets.resolve(cross) for cross in source["cross"]]
    objects = {absolute_asset(name): dict(known) for name, known in source.get("objects", {}).items()}
    runs: dict[str, RunSpec] = {}
    for values, known in _cross_lists(defaults, crosses, objects, where):
        spec = full_spec(values | known, where)
        name = run_name(spec, values)
        if runs.setdefault(name, spec) != spec:
            raise InputError(
                f"{where} asks for run '{name}' twice, with different values; let each run differ in its "
                "gripper, object, method or seed, or in a key of its spec that does not say when it ends."
            )
    used = {spec.object for spec in runs.values()}
    for name in objects:
        if name not in used:
            raise InputError(
                f"{where} says what is known of '{name}', which no run grasps; name it as `object` of a "
                "[[cross]], in the same words."
            )
    if here:
        _check_assets(runs.values())
    said = {key: value for key, value in defaults.items() if value is not None}
    resolved = {"defaults": said, "cross": crosses} | ({"objects": objects} if objects else {})
    return Campaign(runs, resolved, tuple(assets.scans), tuple(assets.stand_ins))


def run_name(spec: RunSpec, values: Mapping[str, Any]) -> str:
    """Name a run by gripper, object, method, seed, and whatever is not as usual.

    `values` are those that the campaign gave for it; when it ends is no part of its name.
    """
    parts = [Path(spec.gripper).stem, Path(spec.object).stem, spec.method, f"s{spec.seed}"]
    usual = full_spec(
        CAMPAIGN_DEFAULTS | {key: getattr(spec, key) for key in ("gripper", "object", "method")}
    )
    others = sorted(values.keys() - {*NAME_KEYS, *STOP_KEYS})
    unusual = [key for key in others if getattr(spec, key) not in (None, getattr(usual, key))]
    parts += [f"{SHORT_KEYS.get(key, key)}{getattr(spec, key)}".replace(".", "_") for key in unusual]
    name = "-".join(parts)
    if len(name) <= LONGEST_NAME:
        return job_name(name)
    mark = hashlib.sha256(name.encode()).hexdigest()[:8]
    return f"{job_name(name)[: LONGEST_NAME - 9]}-{mark}"


class AssetNames:
    """Resolves grippers and objects of a campaign, and notes scans and stand-ins.

    With `prefer_scans` an object is taken as its scan if that is found.
    """

    def __init__(self, *, prefer_scans: bool) -> None:
        self._prefer_scans = prefer_scans
        self.scans: dict[str, None] = {}
        self.stand_ins: dict[str, None] = {}

    def resolve(self, values: dict[str, Any]) -> dict[str, Any]:
        """Return values of a crossing with absolute paths, and objects as they are taken."""
        resolved = dict(values)
        for key, act in (("gripper", absolute_asset), ("object", self._object)):
            if key in values:
                value = values[key]
                resolved[key] = [act(one) for one in value] if isinstance(value, list) else act(value)
        return resolved

    def _object(self, name: Any) -> Any:
        scan = f"{ycb.PREFIX}{name}"
        if not self._prefer_scans or scan not in ycb.SCAN_NAMES:
            return absolute_asset(name)
        if ycb.scan_source(scan) == ABSENT:
            self.stand_ins[name] = None
            return name
        self.scans[name] = None
        return scan


def _check_assets(specs: Collection[RunSpec]) -> None:
    jawless = {name for name in {spec.gripper for spec in specs} if find_gripper(name).file.jaw is None}
    for name in {spec.object for spec in specs}:
        check_object(name)
    for spec in specs:
        if prior_of(spec) == ANTIPODAL and spec.gripper in jawless:
            raise JawNeeded(ANTIPODAL, Path(spec.gripper).stem)


def _check_tables(source: dict[str, Any], where: str) -> None:
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
    """Yield each run's values and those known of its object; `NAME_KEYS` change last first."""
    for cross in crosses:
        whole = defaults | cross
        if empty := [key for key, value in whole.items() if value == []]:
            raise ImpossibleValue(f"{where}: {empty[0]}", [], "one value, or a list of at least one")
        order = sorted(whole, key=lambda key: NAME_KEYS.index(key) if key in NAME_KEYS else len(NAME_KEYS))
        axes = [whole[key] if isinstance(whole[key], list) else [whole[key]] for key in order]
        for each in itertools.product(*axes):
            values = dict(zip(order, each, strict=True))
            own = objects.get(values.get("object", ""), {})
            known = {key: value for key, value in own.items() if key not in cross}
            for key in OBJECTIVE_KEYS:
                if key in values and key not in cross and values["method"] != DEFAULT_METHOD:
                    run_spec({"gripper": "", "object": "", key: values.pop(key)}, where)
            yield {key: value for key, value in values.items() if key not in known}, known


MASS_TABLE = "masses.csv"  # The table of masses in a folder of meshes
MASS_COLUMNS = ["file", "mass"]
MASS_DIGITS = 6  # Significant digits of a mass that follows from a density
GREATEST_MASS = 1000  # Greatest mass that a spec allows [kg]
NO_MASS = "it has no mass: say what it weighs with --mass or --density, or in " + MASS_TABLE


@dataclass(frozen=True)
class MassRule:
    """Mass or density of objects that the table of masses does not name; one of them at most."""

    mass: float | None = None
    """Mass of each [kg]."""
    density: float | None = None
    """Density of each [kg/m3]."""

    def mass_of(self, draft: ObjectDraft) -> float | None:
        """Return the mass of a mesh [kg]; None: it is not given."""
        if self.density is None:
            return self.mass
        return float(f"{self.density * draft.mesh.volume:.{MASS_DIGITS}g}")


def campaign_of_meshes(
    folder: Path,
    mass_rule: MassRule,
    scale: float | None,
    values: Mapping[str, Any],
    *,
    is_begun: bool = False,
) -> Campaign:
    """Make the campaign of all meshes in a folder, at `scale` metres to a unit (None: 1).

    `is_begun` is that of `read_campaign`. `values` are values or lists of keys of a spec, crossed as in a
    campaign's file; None: not given. Raises InputError as `mesh_values`, or for a run that is not possible.
    """
    known = mesh_values(folder, mass_rule, scale)
    cross = {key: value for key, value in values.items() if value is not None} | {"object": list(known)}
    return make_campaign({"cross": [cross], "objects": known}, f"campaign of {folder}", is_begun=is_begun)


def mesh_values(folder: Path, mass_rule: MassRule, scale: float | None) -> dict[str, dict[str, float]]:
    """Return the keys `mass` and `scale` of a spec for every mesh in a folder, by its path.

    Raises InputError if there is no such folder, no mesh in it, or its table of masses cannot be read, and
    UnusableMeshes for meshes that no object can be made of, or whose mass is not known.
    """
    files, masses = _mesh_files(folder), _read_masses(folder / MASS_TABLE)
    faults = _name_clashes(files.values())
    faults |= dict.fromkeys(masses.keys() - files.keys(), f"{MASS_TABLE} names it, and there is no such mesh")
    known: dict[str, dict[str, float]] = {}
    for name, file in files.items():
        draft = _read_mesh(file, scale)
        mass = masses[name] if name in masses else mass_rule.mass_of(draft)
        why = _mesh_fault(draft, mass)
        if why or mass is None:
            faults.setdefault(name, why)
        else:
            known[str(file)] = {"mass": mass} | ({} if scale is None else {"scale": scale})
    if faults:
        raise UnusableMeshes(len(files.keys() | masses.keys()), faults)
    return known


def check_meshes(specs: Iterable[RunSpec]) -> None:
    """Check that an object can be made of every mesh file in specs; raises UnusableMeshes."""
    named = STAND_INS.keys() | SCANS.keys()
    wanted = {(spec.object, spec.scale): spec.mass for spec in specs if spec.object not in named}
    faults = {
        name: fault
        for (name, scale), mass in wanted.items()
        if (fault := _mesh_fault(_read_mesh(named_path(name), scale), mass))
    }
    if faults:
        raise UnusableMeshes(len({name for name, _ in wanted}), faults)


def _mesh_fault(draft: ObjectDraft, mass: float | None) -> str:
    """Return the reason why no object can be made of a mesh; empty where one can."""
    if draft.faults:
        return "; and ".join(draft.faults)
    if mass is None:
        return NO_MASS
    if not 0 < mass <= GREATEST_MASS:
        return f"its mass must be more than 0 and at most {GREATEST_MASS} kg, got {mass:g}"
    return ""


def _mesh_files(folder: Path) -> dict[str, Path]:
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
    """Read the masses [kg] in a table by file; empty if there is no table."""
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
        f"'{table}' is no table of masses: it begins with the line `{','.join(MASS_COLUMNS)}`, and every "
        f"other one is a mesh's file name and its mass in kg{why}."
    )


def _name_clashes(files: Iterable[Path]) -> dict[str, str]:
    """Find meshes whose runs would have the names of those of another one."""
    first, faults = dict[str, str](), dict[str, str]()
    for file in files:
        other = first.setdefault(job_name(f"a-{file.stem}"), file.name)
        if other != file.name:
            faults[file.name] = f"its runs would be called as those of '{other}': rename one of the two"
    return faults


def _read_mesh(file: Path, scale: float | None) -> ObjectDraft:
    try:
        return read_draft(file, scale)
    except AssetError as error:
        return ObjectDraft.unreadable(str(error))
