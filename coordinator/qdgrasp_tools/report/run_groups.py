"""Groups the runs of a campaign by scene and method; quartile curves over evaluations.

Runs of one hand are pooled over its objects: what a method reached on all of them, on average.
"""

import hashlib
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from qdgrasp_coordinator.metrics.reference_coverage import CoverageTarget, ReferenceLookup
from qdgrasp_coordinator.search import registry
from qdgrasp_coordinator.storage import atomic_files
from qdgrasp_coordinator.storage.outputs import RUNS, SPEC
from qdgrasp_coordinator.storage.run_folder import RunFolder, run_digest, search_digest
from qdgrasp_protocol.errors import FolderError
from qdgrasp_protocol.rows import GIVEN
from qdgrasp_protocol.spec import Overlaps, RunSpec
from qdgrasp_tools.report.run_history import RunHistory, read_history

HAND_ORDER = ("panda", "panda_2f", "robotiq_2f", "barrett", "bh280", "allegro", "shadow")
"""The paper's order of the hands; others follow."""
GROUP_KEYS = {"gripper", "object", "about", "protocol", "engine", "method", "seed", "evaluations"}
"""Keys of a spec that name the group of a run, or may differ between its runs."""
SPEC_UNITS = {"mass": " kg"}
SPEC_DEFAULTS = {
    field.name: field.default for field in msgspec.structs.fields(RunSpec) if field.name not in GROUP_KEYS
}
"""Values of a spec where neither its method nor the user asks for others."""
FLIGHT_SETTINGS = {"generations_in_flight", "in_flight"}
"""Settings whose default differs between single runs and campaigns."""
OWN_SEED = "of the run"
"""Stands for a surface seed that is the seed of the run."""


@dataclass(frozen=True)
class SceneName:
    """Gripper, object and evaluation protocol of runs."""

    gripper: str
    object: str
    """The object's name, or its mesh file's."""
    protocol: str

    @property
    def words(self) -> str:
        """For a person; the protocol is named where it is not the default."""
        return f"{self.gripper} on {self.object}{self._protocol_mark}"

    @property
    def hand_words(self) -> str:
        """The same without the object."""
        return f"{self.gripper}{self._protocol_mark}"

    @property
    def _protocol_mark(self) -> str:
        return "" if self.protocol == "paper" else f" ({self.protocol})"


@dataclass(frozen=True)
class RunGroup:
    """The runs of a method, and one variant of it, on a scene."""

    scene: SceneName
    method: str
    variant: str
    """The settings that tell it from other groups of the method, in words; mostly empty."""
    runs: tuple[RunHistory, ...]
    """At least one, by seed."""
    settings: Mapping[str, Any] = field(default_factory=dict)
    """The same settings by their names in a spec."""

    @property
    def name(self) -> str:
        """Method and variant in words."""
        return f"{self.method} {self.variant}".rstrip()

    @property
    def variant_key(self) -> tuple[str, str]:
        """Method and variant: the same on every scene."""
        return self.method, self.variant

    @property
    def overlaps(self) -> Overlaps:
        """Mode of counting overlaps, the same in all of its runs."""
        return self.runs[0].spec.overlaps

    @property
    def target(self) -> CoverageTarget:
        """The reference set that its positions are compared with."""
        return self.runs[0].target

    @property
    def unfinished(self) -> int:
        """Number of runs that have not spent their budget."""
        return sum(not run.complete for run in self.runs)

    @property
    def finished_runs(self) -> tuple[RunHistory, ...]:
        """The finished runs, or as long as no run is finished those with rows; claims use them."""
        finished = tuple(run for run in self.runs if run.complete)
        return finished or tuple(run for run in self.runs if run.evaluations)


def search_run_folders(path: Path) -> list[RunFolder]:
    """List the runs of searches in a campaign, in a folder of runs, or of one run; by name.

    Runs that score given poses are passed over. Their specs, scenes and journals are needed, the files of
    their jobs are not. Raises NoFolder or FolderError if there is no such folder, or no such run.
    """
    atomic_files.check_folder(path)
    home = path / RUNS if (path / RUNS).is_dir() else path
    places = [path] if (path / SPEC).is_file() else sorted(home.iterdir())
    runs = [RunFolder(place) for place in places if (place / SPEC).is_file()]
    found = [run for run in runs if run.spec.method != GIVEN]
    if runs and not found:
        raise FolderError(f"The runs in {path} score given poses: there is no search to look at.")
    if not found:
        raise FolderError(
            f"{path} holds no runs: expected run folders in {path / RUNS} or in {path} itself; "
            "`qdgrasp run --out` and `qdgrasp campaign` make them."
        )
    return found


def read_histories(folders: Iterable[RunFolder], targets: ReferenceLookup) -> Iterator[RunHistory]:
    """Read what each run found; each scene is looked up once."""
    known: dict[tuple[str, str], CoverageTarget] = {}
    for folder in folders:
        run_object = folder.spec.object
        if not folder.has_bundle():
            yield read_history(folder, CoverageTarget(why="the run's scene is not here"))
            continue
        scene = folder.bundle().digest
        if (scene, run_object) not in known:
            known[scene, run_object] = targets.of(folder.scene(), run_object)
        search = search_digest(folder.spec, scene)
        if folder.spec.has_own_search:
            with folder.journal() as journal:
                search = run_digest(folder.spec, journal, range(journal.count))
        yield read_history(folder, known[scene, run_object], search)


def distinct_searches(runs: Iterable[RunHistory]) -> tuple[list[RunHistory], list[RunHistory]]:
    """Separate runs from copies and shorter runs of the same searches: no samples of their own."""
    kept: dict[str, RunHistory] = {}
    there = list(runs)
    for run in sorted(there, key=lambda run: -run.evaluations):  # of equal ones the first
        kept.setdefault(run.search or str(run.path), run)
    longest = {run.path for run in kept.values()}
    return list(kept.values()), [run for run in there if run.path not in longest]


def group_runs(runs: Iterable[RunHistory]) -> list[RunGroup]:
    """Group runs that differ in their seed, and maybe in their budget.

    Hands and methods are in the paper's order, searches of a program's own last.
    """
    arms: dict[tuple[SceneName, str], list[RunHistory]] = {}
    for run in runs:
        spec = run.spec
        scene = SceneName(Path(spec.gripper).stem, Path(spec.object).stem, spec.protocol_words)
        arms.setdefault((scene, spec.method), []).append(run)
    known = list(registry.METHODS)
    order = {name: known.index(name) if name in known else len(known) for _, name in arms}
    ordered = sorted(arms, key=lambda arm: (*_scene_order(arm[0]), order[arm[1]], arm[1]))
    return [group for arm in ordered for group in _variants(*arm, arms[arm])]


def default_groups(groups: Iterable[RunGroup]) -> dict[SceneName, dict[str, RunGroup]]:
    """On each scene, choose for each method the variant with the fewest changed settings."""

    def changed_settings(group: RunGroup) -> int:
        setting = _settings(group.runs[0].spec)
        usual = usual_settings(group.method)
        return sum(setting[name] != usual[name] for name in usual.keys() - FLIGHT_SETTINGS)

    scenes: dict[SceneName, dict[str, RunGroup]] = {}
    for group in sorted(groups, key=changed_settings):
        scenes.setdefault(group.scene, {}).setdefault(group.method, group)
    return scenes


def usual_settings(method: str) -> dict[str, Any]:
    """Return the settings of a method's runs unless their specs say otherwise."""
    own = registry.method(method)
    return SPEC_DEFAULTS | {"aim_for": own.aim_for, "overlaps": own.overlaps, "population": own.population}


def _scene_order(scene: SceneName) -> tuple[Any, ...]:
    hand = scene.gripper.removeprefix("ref_")
    order = HAND_ORDER.index(hand) if hand in HAND_ORDER else len(HAND_ORDER)
    return order, scene.gripper, scene.object, scene.protocol


def _variants(scene: SceneName, method: str, runs: list[RunHistory]) -> Iterator[RunGroup]:
    """Yield one group for each setting that occurs, told apart by their differences."""
    settings = [_settings(run.spec) for run in runs]
    _mark_own_surfaces(runs, settings)
    differing = [key for key in settings[0] if len({setting[key] for setting in settings}) > 1]
    parts: dict[tuple[Any, ...], list[RunHistory]] = {}
    for run, setting in zip(runs, settings, strict=True):
        parts.setdefault(tuple(setting[key] for key in differing), []).append(run)
    for values in sorted(
        parts, key=lambda values: [(value is not None, isinstance(value, str), value) for value in values]
    ):
        setting = dict(zip(differing, values, strict=True))
        members = sorted(parts[values], key=lambda run: (run.spec.seed, run.path.name))
        yield RunGroup(scene, method, setting_words(setting), tuple(members), setting)


def _mark_own_surfaces(runs: Sequence[RunHistory], settings: Sequence[dict[str, Any]]) -> None:
    """Replace surface seeds that are those of the runs by one value: they are no difference.

    A surface seed that runs of several seeds have, all else equal, is a fixed one. That of a run with seed 0
    may be either; it is its own if those of other runs are.
    """
    others = [tuple(value for key, value in one.items() if key != "surface_seed") for one in settings]
    seeds: dict[tuple[Any, ...], set[int]] = {}
    for other, run in zip(others, runs, strict=True):
        seeds.setdefault((other, run.spec.surface_seed), set()).add(run.spec.seed)
    own = [
        (other, setting, run.spec.seed)
        for other, setting, run in zip(others, settings, runs, strict=True)
        if seeds[other, run.spec.surface_seed] == {run.spec.surface_seed}
    ]
    certain = {other for other, _, seed in own if seed}
    for other, setting, _ in own:
        if other in certain:
            setting["surface_seed"] = OWN_SEED


def setting_words(settings: Mapping[str, Any]) -> str:
    """Describe settings by their names and values."""
    return ", ".join(
        f"{key.replace('_', ' ')} {'default' if value is None else value}{SPEC_UNITS.get(key, '')}"
        for key, value in settings.items()
    )


def _settings(spec: RunSpec) -> dict[str, Any]:
    """Return the settings of a run; without a recorded objective `aimed` aimed for touch."""
    values = {key: value for key, value in msgspec.structs.asdict(spec).items() if key not in GROUP_KEYS}
    if spec.first_weights is not None:
        values["first_weights"] = hashlib.sha256(repr(spec.first_weights).encode()).hexdigest()[:8]
    if spec.mesh is not None:
        values["mesh"] = ", ".join(spec.mesh.words)
    return values | ({"aim_for": spec.aim_for or "touch"} if registry.method(spec.method).aim_for else {})


LEAST_OBJECTS = 2  # Objects, for a mean over objects


@dataclass(frozen=True)
class PooledRun(RunHistory):
    """Runs with one seed on several objects; coverage, cells and evaluations are of them all."""

    parts: tuple[RunHistory, ...] = ()

    def coverage(self, evaluations: ArrayLike) -> NDArray[np.float64]:
        """Mean over the objects after as many evaluations on each."""
        return np.asarray(np.mean([part.coverage(evaluations) for part in self.parts], axis=0))

    def published_coverage(self, evaluations: ArrayLike) -> NDArray[np.float64]:
        """Mean of the coverage as published."""
        return np.asarray(np.mean([part.published_coverage(evaluations) for part in self.parts], axis=0))

    def cell_count(self, evaluations: ArrayLike) -> NDArray[np.float64]:
        """Mean of the number of success cells."""
        return np.asarray(np.mean([part.cell_count(evaluations) for part in self.parts], axis=0))


def pool_objects(groups: Sequence[RunGroup]) -> list[RunGroup]:
    """Pool each hand's methods over the objects that were run with all of them.

    They are those that have a set, or all if fewer than two have one. A hand with less than two objects in
    common has its scenes as they are. Seeds that not every object has are left out.
    """
    return [pooled for same in hand_groups(groups).values() for pooled in _over_objects(same)]


def hand_groups(groups: Iterable[RunGroup]) -> dict[str, list[RunGroup]]:
    """Sort groups by hand and protocol, in the order of their first occurrence."""
    hands: dict[str, list[RunGroup]] = {}
    for group in groups:
        hands.setdefault(group.scene.hand_words, []).append(group)
    return hands


def _over_objects(groups: Sequence[RunGroup]) -> list[RunGroup]:
    """Pool the groups of one hand and protocol."""
    arms: dict[tuple[str, str], dict[str, RunGroup]] = {}
    for group in groups:
        arms.setdefault(group.variant_key, {})[group.scene.object] = group
    common = sorted(set.intersection(*(set(objects) for objects in arms.values())))
    with_set = [name for name in common if all(objects[name].target.size for objects in arms.values())]
    names = with_set if len(with_set) >= LEAST_OBJECTS else common
    if len(names) < LEAST_OBJECTS:
        return list(groups)
    scene = replace(groups[0].scene, object=f"{len(names)} objects")
    found = [(objects[names[0]], _pool_seeds([objects[name] for name in names])) for objects in arms.values()]
    return [replace(first, scene=scene, runs=runs) for first, runs in found if runs]


def _pool_seeds(groups: Sequence[RunGroup]) -> tuple[PooledRun, ...]:
    """Pool the runs of each seed that has begun on every object."""
    seeds = [{run.spec.seed: run for run in group.runs if run.evaluations} for group in groups]
    common = sorted(set.intersection(*map(set, seeds)))
    return tuple(_pool_runs(tuple(runs[seed] for runs in seeds)) for seed in common)


def _pool_runs(parts: tuple[RunHistory, ...]) -> PooledRun:
    first = {field.name: getattr(parts[0], field.name) for field in fields(RunHistory)}
    lacking = [part.target for part in parts if not part.target.size]
    target = replace((lacking or [parts[0].target])[0], stand_in=any(part.target.stand_in for part in parts))
    ends, complete = min(part.evaluations for part in parts), all(part.complete for part in parts)
    return PooledRun(**first | {"evaluations": ends, "complete": complete, "target": target}, parts=parts)


CURVE_STEPS = 200
QUARTILES = (0.25, 0.5, 0.75)


@dataclass(frozen=True)
class CurveMeasure:
    """A number of a run after some of its evaluations."""

    name: str
    words: str
    """The label of an axis, with its unit."""
    values: Callable[[RunHistory, ArrayLike], NDArray[np.float64]]


COVERAGE = CurveMeasure("coverage", "coverage of S_G", lambda run, at: run.coverage(at))
PUBLISHED_COVERAGE = CurveMeasure(
    "published", "coverage of S_G as published", lambda run, at: run.published_coverage(at)
)
CELLS = CurveMeasure("cells", "success cells of 1 cm", lambda run, at: run.cell_count(at))


def measure_of(groups: Iterable[RunGroup]) -> CurveMeasure:
    """Choose coverage to compare groups on a scene, or cells where one lacks a set."""
    return COVERAGE if all(group.target.size for group in groups) else CELLS


@dataclass(frozen=True)
class QuartileCurve:
    """Quartiles over runs after so many counted evaluations: (k,) each."""

    group: RunGroup
    measure: CurveMeasure
    evaluations: NDArray[np.int64]
    runs: NDArray[np.int64]
    """Runs that have got that far, which the quartiles are of."""
    low: NDArray[np.float64]
    median: NDArray[np.float64]
    high: NDArray[np.float64]

    @property
    def common_points(self) -> int:
        """Number of points that all runs that have begun have reached."""
        return int(np.count_nonzero(self.runs == self.runs.max(initial=0)))


def quartile_curve(group: RunGroup, measure: CurveMeasure) -> QuartileCurve:
    """Make a group's curve at `CURVE_STEPS` equal steps and at as many equal factors.

    A run counts as far as it goes, so that the median is of fewer runs beyond the end of the shortest.
    """
    begun = [run for run in group.runs if run.evaluations]
    ends = np.array([run.evaluations for run in begun], dtype=np.int64)
    end = ends.max(initial=0)
    even, early = np.linspace(0, end, CURVE_STEPS + 1), np.geomspace(1, max(end, 1), CURVE_STEPS)
    at = np.unique(np.concatenate([np.concatenate([even, early]).round().astype(np.int64), ends]))
    values = np.array([np.where(at <= run.evaluations, measure.values(run, at), np.nan) for run in begun])
    if not begun:
        values = np.full((1, len(at)), np.nan)
    low, median, high = quartiles(values)
    return QuartileCurve(group, measure, at, (at <= ends[:, None]).sum(axis=0), low, median, high)


def quartiles(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """First quartile, median and third quartile of each column of (n, k), without NaN: (3, k)."""
    result = np.full((3, values.shape[1]), np.nan)
    some = ~np.isnan(values).all(axis=0)
    result[:, some] = np.nanquantile(values[:, some], QUARTILES, axis=0)
    return result


LETTERS_PER_INCH = 17  # Of a panel's heading, in an inch


@dataclass(frozen=True)
class CurvePanel:
    """The curves on one scene."""

    scene: SceneName
    measure: CurveMeasure
    curves: tuple[QuartileCurve, ...]

    @property
    def measure_words(self) -> str:
        """The measure in words, and the limits of comparing by it."""
        return measure_words(self.measure, self.curves[0].group)

    @property
    def end(self) -> int:
        """Evaluations of the longest curve."""
        return max(int(one.evaluations[-1]) for one in self.curves)

    @property
    def greatest_value(self) -> float:
        """The greatest third quartile."""
        return max(float(np.nanmax(one.high, initial=0.0)) for one in self.curves)


def curve_panels(groups: Sequence[RunGroup]) -> list[CurvePanel]:
    """Make the curves of all groups, scene by scene."""
    return [
        CurvePanel(scene, measure, tuple(quartile_curve(group, measure) for group in here))
        for scene, here in scene_groups(groups).items()
        for measure in [measure_of(here)]
    ]


def scene_groups(groups: Iterable[RunGroup]) -> dict[SceneName, list[RunGroup]]:
    """Sort groups by scene, in the order of their first occurrence."""
    scenes: dict[SceneName, list[RunGroup]] = {}
    for group in groups:
        scenes.setdefault(group.scene, []).append(group)
    return scenes


def measure_words(measure: CurveMeasure, group: RunGroup) -> str:
    """Describe the measure on a group's scene, and the limits of comparing by it."""
    target = group.target
    pool = ", mean over objects" if isinstance(group.runs[0], PooledRun) else ""
    if measure is COVERAGE:
        mark = ", on a stand-in for the scan" if target.stand_in else ""
        return f"{measure.words}{pool}{mark}"
    return f"{measure.words}{pool}: {target.why or 'not all runs have an S_G'}"


def run_words(groups: Sequence[RunGroup], room: float) -> str:
    """Describe seeds and evaluations in `room` inches; methods that have others are named."""
    kinds: dict[str, list[str]] = {}
    for group in groups:
        kinds.setdefault(_seeds_in_words([group]), []).append(group.name)
    usual, *others = sorted(kinds, key=lambda kind: -len(kinds[kind]))
    short = {kind: re.sub(" seeds?| evaluations", "", kind) for kind in others}
    words = "; ".join([usual, *(f"{', '.join(kinds[kind])}: {short[kind]}" for kind in others)])
    return words if len(words) <= LETTERS_PER_INCH * room else _seeds_in_words(groups)


def _seeds_in_words(groups: Sequence[RunGroup]) -> str:
    seeds = number_span([len(group.runs) for group in groups])
    ends = number_span([run.evaluations for group in groups for run in group.runs])
    unfinished = sum(group.unfinished for group in groups)
    mark = f", {unfinished} unfinished" if unfinished else ""
    return f"{seeds} seed{'' if seeds == '1' else 's'} \u00d7 {ends} evaluations{mark}"


def number_span(numbers: Sequence[int]) -> str:
    """Write a number that is the same throughout, or the least and the greatest."""
    low, high = min(numbers), max(numbers)
    return f"{low:,}" if low == high else f"{low:,}\u2013{high:,}"
