"""Reads a campaign: the runs that a TOML file or a library of objects asks for.

Mesh files are checked before anything is begun, so that all faults are named at once.
"""

import hashlib
import itertools
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

import msgspec
import tomli_w
from msgspec import Struct, structs

from qdgrasp_assets import ycb
from qdgrasp_assets.asset_paths import named_path
from qdgrasp_assets.catalog import ABSENT, check_object, find_gripper
from qdgrasp_assets.genes import ANTIPODAL
from qdgrasp_assets.geometry.collision_parts import Tell, ignore_progress
from qdgrasp_assets.object_model import check_mesh
from qdgrasp_assets.stand_ins import STAND_INS
from qdgrasp_assets.ycb import SCANS
from qdgrasp_coordinator.scheduler.run_plan import FLIGHT_KEYS, RUN_DEFAULTS, absolute_asset, complete_spec
from qdgrasp_coordinator.search.registry import method, prior_of
from qdgrasp_protocol.errors import ImpossibleValue, InputError, JawNeeded, UnusableMeshes
from qdgrasp_protocol.keys import job_name
from qdgrasp_protocol.spec import (
    DEFAULT_METHOD,
    GOAL_KEYS,
    OBJECTIVE_KEYS,
    STOP_KEYS,
    RunSpec,
    read_run_spec,
    run_spec,
    usual_engine,
)
from qdgrasp_protocol.text import counted
from qdgrasp_tools.campaign.object_library import LibraryRules, SkippedObject, mesh_fault, read_library

SHORT_KEYS = {
    "mutation_sigma": "sigma",
    "mutation_probability": "rate",
    "generations_in_flight": "flight",
    "in_flight": "inflight",
    "surface_seed": "surface",
    "protocol": "",
    "overlaps": "",
    "aim_for": "",
    "diversity": "",
    "approach_distance": "approach",
    "resting_pose": "resting",
}
"""Short forms of keys in the names of runs."""
NAME_KEYS = ("gripper", "object", "method", "seed")  # Keys that every run's name begins with
OWN_SEED = "seed"  # Value of `surface_seed` that stands for the run's own seed
CAMPAIGN_DEFAULTS = {"method": DEFAULT_METHOD, "generations_in_flight": 1}
"""Defaults of a campaign's runs.

A second generation in flight from the beginning keeps the workers of a single run busy; here other runs do,
and the search is told all that it asked.
"""
WRITTEN_DEFAULTS = {"aim_for": method(DEFAULT_METHOD).aim_for, "in_flight": 400}
"""Defaults of a campaign's runs that its file notes.

A third of the genomes in flight that a single run has in the end: other runs fill the gaps.
"""
SATURATION = 0.1
"""Share of its mean rate of new niches at which an object is saturated, where a target of grasps is given."""
ADAPTIVE_BUDGET = {"evaluations": 20_000, "saturation": SATURATION}
"""Budget and saturation of a campaign with a target of grasps, unless it says others."""
LONGEST_NAME = 64
LARGEST_CAMPAIGN = 64 << 20  # Most characters of a campaign's file; 100 000 objects have 30 million


ObjectValues = Mapping[str, Mapping[str, Any]]
"""Values of a spec's keys of objects, by name, as far as they are known; the runs' specs check them."""


@dataclass(frozen=True)
class Campaign:
    """Runs by name, in the order in which they are begun."""

    runs: Mapping[str, RunSpec]
    source: Mapping[str, Any]
    """The file's content, with objects as they were resolved."""
    stand_ins: tuple[str, ...] = ()
    """Objects whose scans were preferred and not found."""
    skipped: tuple[SkippedObject, ...] | None = None
    """Objects of a library that cannot be used and are left out; None: no library was read."""

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
        has_goals = any(getattr(spec, key) is not None for spec in self.runs.values() for key in GOAL_KEYS)
        most = "at most " if has_goals else ""
        parts = [f"{counted(len(self.runs), 'run')}, {most}{counted(self.evaluations, 'evaluation')} in all"]
        if self.stand_ins:
            parts.append(f"no scan found of {', '.join(self.stand_ins)}: stand-ins, without S_G coverage")
        if self.skipped:
            parts.append(f"{counted(len(self.skipped), 'object')} left out that cannot be used")
        return "; ".join(parts) + "."


def read_campaign(
    path: Path,
    *,
    here: bool = True,
    goals: Mapping[str, float | None] = MappingProxyType({}),
    usual: Mapping[str, Any] = MappingProxyType({}),
) -> Campaign:
    """Read the campaign in a TOML file.

    `here` checks that its grippers and objects are on this machine; `goals` are values of a spec's keys that
    end runs, in place of the file's defaults, before which `ADAPTIVE_BUDGET` holds if grasps are among them;
    `usual` are values of keys that the file's defaults lack.
    Raises InputError if the file is missing, is not TOML, or asks for a run that is not possible; the run is
    named.
    """
    source = read_run_spec(path, LARGEST_CAMPAIGN)
    _check_tables(source, str(path))
    source["defaults"] = {**usual, **_with_goals(source.get("defaults", {}), goals)}
    return make_campaign(source, str(path), here=here)


def _with_goals(defaults: Mapping[str, Any], goals: Mapping[str, Any]) -> dict[str, Any]:
    """Return a campaign's defaults with other goals, as far as these have a value."""
    asked = {key: value for key, value in goals.items() if value is not None}
    return {**(ADAPTIVE_BUDGET if "grasps" in asked else {}), **defaults, **asked}


def is_campaign(path: Path) -> bool:
    """Return whether a TOML file is a campaign's, not a run's; raises as `read_campaign`."""
    return not set(CampaignTables.__struct_fields__).isdisjoint(read_run_spec(path, LARGEST_CAMPAIGN))


def make_campaign(source: dict[str, Any], where: str, *, here: bool = True) -> Campaign:
    """Make the campaign of a file's content; parameters and errors are those of `read_campaign`."""
    _check_tables(source, where)
    said = source.get("defaults", {})
    says_flight = not said.keys().isdisjoint(FLIGHT_KEYS)
    usual = {
        key: value for key, value in WRITTEN_DEFAULTS.items() if not (key == "in_flight" and says_flight)
    }
    source = source | {"defaults": usual | said}
    stand_ins: dict[str, None] | None = {} if source.get("prefer_scans", False) else None
    first = CAMPAIGN_DEFAULTS | dict.fromkeys(WRITTEN_DEFAULTS) | source["defaults"]
    defaults = _resolved(first, stand_ins)
    crosses = [_resolved(cross, stand_ins) for cross in source["cross"]]
    objects = {absolute_asset(name): dict(known) for name, known in source.get("objects", {}).items()}
    runs: dict[str, RunSpec] = {}
    for values, known in _cross_lists(defaults, crosses, objects, where):
        spec = complete_spec(values | known, where)
        name = run_name(spec, values)
        if runs.setdefault(name, spec) != spec:
            raise InputError(
                f"{where} asks for run '{name}' twice, with different values; let each run differ in its "
                "gripper, object, method or seed, or in a key of its spec that does not say when it ends."
            )
    if here:
        _check_assets(runs.values())
    said = {key: value for key, value in defaults.items() if value is not None}
    resolved = {"defaults": said, "cross": crosses} | ({"objects": objects} if objects else {})
    return Campaign(runs, resolved, tuple(stand_ins or ()))


def run_name(spec: RunSpec, values: Mapping[str, Any]) -> str:
    """Name a run by gripper, object, method, seed, and other values that are not as usual.

    `values` are those that the campaign gave for it; its end is no part of its name.
    """
    own_name = spec.about.id if spec.about and spec.about.id else Path(spec.object).stem
    parts = [Path(spec.gripper).stem, own_name, spec.method, f"s{spec.seed}"]
    usual = _usual_spec(spec.method)
    others = sorted(values.keys() - {*NAME_KEYS, *STOP_KEYS})
    unusual = [key for key in others if getattr(spec, key) not in (None, getattr(usual, key))]
    parts += [f"{SHORT_KEYS.get(key, key)}{getattr(spec, key)}".replace(".", "_") for key in unusual]
    name = "-".join(parts)
    if len(name) <= LONGEST_NAME:
        return job_name(name)
    mark = hashlib.sha256(name.encode()).hexdigest()[:8]
    return f"{job_name(name)[: LONGEST_NAME - 9]}-{mark}"


@cache
def _usual_spec(method: str) -> RunSpec:
    """Return a method's spec as is usual in a campaign; hand and object are empty."""
    spec = complete_spec(CAMPAIGN_DEFAULTS | {"gripper": "", "object": "", "method": method})
    return structs.replace(spec, in_flight=WRITTEN_DEFAULTS["in_flight"])


def _resolved(values: dict[str, Any], stand_ins: dict[str, None] | None) -> dict[str, Any]:
    """Return values of a crossing with absolute paths, and objects as they are taken.

    Unless `stand_ins` is None an object is taken as its scan if that is found, else it is noted there.
    """

    def taken(name: Any) -> Any:
        scan = f"{ycb.PREFIX}{name}"
        if stand_ins is None or scan not in ycb.SCAN_NAMES:
            return absolute_asset(name)
        if ycb.scan_source(scan) != ABSENT:
            return scan
        stand_ins[name] = None
        return name

    resolved = dict(values)
    for key, act in (("gripper", absolute_asset), ("object", taken), ("scene", absolute_asset)):
        if key in values:
            value = values[key]
            resolved[key] = [act(one) for one in value] if isinstance(value, list) else act(value)
    for key in ("on", "avoid"):
        if isinstance(value := values.get(key), list) and value:
            lists = value if all(isinstance(each, list) for each in value) else [value]  # one, as in a spec
            resolved[key] = [[absolute_asset(name) for name in names] for names in lists]
    return resolved


def _check_assets(specs: Collection[RunSpec]) -> None:
    jawless = {name for name in {spec.gripper for spec in specs} if find_gripper(name).file.jaw is None}
    for name in {spec.object for spec in specs}:
        check_object(name)
    for spec in specs:
        if prior_of(spec) == ANTIPODAL and spec.gripper in jawless:
            raise JawNeeded(ANTIPODAL, Path(spec.gripper).stem)


class CampaignTables(Struct, forbid_unknown_fields=True):
    """The tables of a campaign's file."""

    cross: list[dict[str, Any]]
    defaults: dict[str, Any] = {}
    objects: dict[str, dict[str, Any]] = {}
    prefer_scans: bool = False


def _check_tables(source: dict[str, Any], where: str) -> None:
    if not source.get("cross"):
        raise InputError(
            f"{where} asks for no run: give at least one [[cross]] with gripper, object, method."
        )
    try:
        msgspec.convert(source, CampaignTables)
    except msgspec.ValidationError as error:
        raise InputError(f"{where} cannot be read as a campaign: {error}.") from None


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
            if values.get("surface_seed") == OWN_SEED:
                values["surface_seed"] = values.get("seed", 0)
            name = values.get("object")
            own = objects.get(name, {}) if isinstance(name, str) else {}
            known = {key: value for key, value in own.items() if key not in cross}
            for key in OBJECTIVE_KEYS:
                if key in values and key not in cross and values["method"] != DEFAULT_METHOD:
                    run_spec({"gripper": "", "object": "", key: values.pop(key)}, where)
            if "in_flight" not in cross and not _may_grow(values, cross):
                values["in_flight"] = None
            yield {key: value for key, value in values.items() if key not in known}, known


def _may_grow(values: Mapping[str, Any], cross: Mapping[str, Any]) -> bool:
    """Return whether a run has the defaults' genomes in flight.

    A crossing that says how many are in flight has its own.
    """
    redraws = values.get("overlaps") in (None, "redraw")
    return values["method"] == DEFAULT_METHOD and redraws and cross.keys().isdisjoint(FLIGHT_KEYS)


def campaign_of_meshes(
    where: Path,
    rules: LibraryRules,
    values: Mapping[str, Any],
    *,
    tell: Tell = ignore_progress,
) -> Campaign:
    """Make the campaign of all objects of a library: a manifest, or a folder of meshes.

    `values` are values or lists of keys of a spec, crossed as in a campaign's file; None: not given. `tell`
    is called before each mesh is checked. Raises InputError as `read_library`, or for a run that is not
    possible.
    """
    library = read_library(where, rules, tell)
    cross = {key: value for key, value in values.items() if value is not None and key not in STOP_KEYS}
    source = {
        "defaults": _with_goals(usual_engine() | RUN_DEFAULTS, {key: values.get(key) for key in STOP_KEYS}),
        "cross": [cross | {"object": list(library.objects)}],
        "objects": library.objects,
    }
    campaign = make_campaign(source, f"campaign of {where}")
    return replace(campaign, skipped=library.skipped)


def check_meshes(specs: Iterable[RunSpec], tell: Tell = ignore_progress) -> None:
    """Check that an object can be made of every mesh file in specs; raises UnusableMeshes."""
    named = STAND_INS.keys() | SCANS.keys()
    wanted = {(spec.object, spec.scale, spec.mesh): spec.mass for spec in specs if spec.object not in named}
    faults = {}
    for number, ((name, scale, mesh), mass) in enumerate(wanted.items(), start=1):
        tell(f"checking meshes: {number} of {len(wanted)}")
        if fault := mesh_fault(check_mesh(named_path(name), scale, mesh), mass):
            faults[name] = fault
    if faults:
        raise UnusableMeshes(len({name for name, *_ in wanted}), faults)
