"""Groups the runs of a campaign by scene and method; quartile curves over evaluations.

Runs of one hand can be pooled over its objects: what a method reached on all of them, on average.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from qdgrasp_coordinator.metrics.reference_coverage import CoverageTarget, ReferenceLookup
from qdgrasp_coordinator.report.run_history import RunHistory, read_history
from qdgrasp_coordinator.search.registry import METHODS
from qdgrasp_coordinator.storage import atomic_files
from qdgrasp_coordinator.storage.outputs import RUNS, SPEC
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.errors import FolderError
from qdgrasp_protocol.rows import GIVEN
from qdgrasp_protocol.spec import Overlaps, RunSpec

HAND_ORDER = ("panda", "panda_2f", "robotiq_2f", "barrett", "bh280", "allegro", "shadow")
"""The paper's order of the hands; others follow."""
GROUP_KEYS = {"gripper", "object", "protocol", "method", "seed", "evaluations"}
"""What of a spec says which entry a run belongs to, or may differ between its runs."""
SPEC_UNITS = {"mass": " kg"}
SPEC_DEFAULTS = {
    field.name: field.default for field in msgspec.structs.fields(RunSpec) if field.name not in GROUP_KEYS
}
"""What a spec has where neither its method nor anybody else asks for something."""


@dataclass(frozen=True)
class SceneName:
    """What was grasped, with what, and under which evaluation protocol."""

    gripper: str
    object: str
    """The object's name, or its mesh file's."""
    protocol: str

    @property
    def words(self) -> str:
        """For a person; the protocol is named where it is not the default."""
        mark = "" if self.protocol == "paper" else f" ({self.protocol})"
        return f"{self.gripper} on {self.object}{mark}"


@dataclass(frozen=True)
class RunGroup:
    """A method on a scene, and its runs."""

    scene: SceneName
    method: str
    variant: str
    """What tells it from other entries of the method on this scene, in words; mostly empty."""
    runs: tuple[RunHistory, ...]
    """At least one, by seed."""

    @property
    def name(self) -> str:
        """The method, and what is special about it."""
        return f"{self.method} {self.variant}".rstrip()

    @property
    def arm(self) -> tuple[str, str]:
        """Method and variant: what it is on every scene."""
        return self.method, self.variant

    @property
    def overlaps(self) -> Overlaps:
        """Whether overlaps count as evaluations, in all of its runs alike."""
        return self.runs[0].spec.overlaps

    @property
    def target(self) -> CoverageTarget:
        """What its positions are compared with."""
        return self.runs[0].target

    @property
    def unfinished(self) -> int:
        """How many of its runs have not spent their budget."""
        return sum(not run.complete for run in self.runs)

    @property
    def settled(self) -> tuple[RunHistory, ...]:
        """The runs that claims are made of: the finished ones; where there is none, those with any row."""
        finished = tuple(run for run in self.runs if run.complete)
        return finished or tuple(run for run in self.runs if run.evaluations)


def search_run_folders(path: Path) -> list[RunFolder]:
    """The folders of a campaign's runs, or of the runs that lie side by side in a folder; by name.

    Those that score given poses are passed over: they searched nothing. What a run found is read from its
    spec, scene and journal; the files of its job are not needed.

    Raises NoFolder or FolderError: there is no such folder, or no run of a search in it.
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
    """What each run found; a scene is looked at once."""
    known: dict[tuple[str, str], CoverageTarget] = {}
    for folder in folders:
        run_object = folder.spec.object
        if not folder.has_bundle():
            yield read_history(folder, CoverageTarget(why="the run's scene is not here"))
            continue
        key = folder.bundle().digest, run_object
        if key not in known:
            known[key] = targets.of(folder.scene(), run_object)
        yield read_history(folder, known[key])


def group_runs(runs: Iterable[RunHistory]) -> list[RunGroup]:
    """Put runs together that differ in their seed alone; hands and methods in the paper's order."""
    arms: dict[tuple[SceneName, str], list[RunHistory]] = {}
    for run in runs:
        arms.setdefault((scene_name(run.spec), run.spec.method), []).append(run)
    ordered = sorted(arms, key=lambda arm: (*_scene_order(arm[0]), list(METHODS).index(arm[1])))
    return [entry for scene, method in ordered for entry in _variants(scene, method, arms[scene, method])]


def default_groups(entries: Iterable[RunGroup]) -> dict[SceneName, dict[str, RunGroup]]:
    """On each scene, for each method the variant that departs from the defaults in the fewest settings."""
    scenes: dict[SceneName, dict[str, RunGroup]] = {}
    for entry in sorted(entries, key=_changed_settings):
        scenes.setdefault(entry.scene, {}).setdefault(entry.method, entry)
    return scenes


def _changed_settings(entry: RunGroup) -> int:
    own, setting = METHODS[entry.method], _settings(entry.runs[0].spec)
    usual = SPEC_DEFAULTS | {"overlaps": own.overlaps, "population": own.population}
    return sum(setting[name] != default for name, default in usual.items())


def scene_name(spec: RunSpec) -> SceneName:
    """The scene that a spec asks for."""
    return SceneName(Path(spec.gripper).stem, Path(spec.object).stem, spec.protocol)


def _scene_order(scene: SceneName) -> tuple[Any, ...]:
    hand = scene.gripper.removeprefix("ref_")
    order = HAND_ORDER.index(hand) if hand in HAND_ORDER else len(HAND_ORDER)
    return order, scene.gripper, scene.object, scene.protocol


def _variants(scene: SceneName, method: str, runs: list[RunHistory]) -> Iterator[RunGroup]:
    """One entry for each setting that occurs, told apart by what differs between them."""
    settings = [_settings(run.spec) for run in runs]
    differing = [key for key in settings[0] if len({setting[key] for setting in settings}) > 1]
    parts: dict[tuple[Any, ...], list[RunHistory]] = {}
    for run, setting in zip(runs, settings, strict=True):
        parts.setdefault(tuple(setting[key] for key in differing), []).append(run)
    for values in sorted(parts, key=lambda values: [(value is not None, value) for value in values]):
        words = ", ".join(_setting_words(key, value) for key, value in zip(differing, values, strict=True))
        members = sorted(parts[values], key=lambda run: (run.spec.seed, run.path.name))
        yield RunGroup(scene, method, words, tuple(members))


def _settings(spec: RunSpec) -> dict[str, Any]:
    return {key: value for key, value in msgspec.structs.asdict(spec).items() if key not in GROUP_KEYS}


def _setting_words(key: str, value: object) -> str:
    return f"{key.replace('_', ' ')} {'default' if value is None else value}{SPEC_UNITS.get(key, '')}"


LEAST_OBJECTS = 2  # Objects, for a mean over objects


@dataclass(frozen=True)
class PooledRun(RunHistory):
    """Runs with one seed on several objects; only coverage and evaluations are theirs together."""

    parts: tuple[RunHistory, ...] = ()

    def coverage(self, evaluations: ArrayLike) -> NDArray[np.float64]:
        """Mean over the objects after as many evaluations on each."""
        return np.asarray(np.mean([part.coverage(evaluations) for part in self.parts], axis=0))

    def published_coverage(self, evaluations: ArrayLike) -> NDArray[np.float64]:
        """The same, as published."""
        return np.asarray(np.mean([part.published_coverage(evaluations) for part in self.parts], axis=0))


def pool_objects(entries: Sequence[RunGroup]) -> list[RunGroup]:
    """For each hand, its methods over those of its objects that have a set and that all of them were run on.

    Hands with less than two such objects are left out, and so are seeds that not every object has.
    """
    hands: dict[tuple[str, str], dict[tuple[str, str], dict[str, RunGroup]]] = {}
    for entry in entries:
        arms = hands.setdefault((entry.scene.gripper, entry.scene.protocol), {})
        arms.setdefault(entry.arm, {})
        if entry.target.size:
            arms[entry.arm][entry.scene.object] = entry
    return [entry for hand, arms in hands.items() for entry in _over_objects(*hand, arms)]


def _over_objects(
    hand: str, protocol: str, arms: dict[tuple[str, str], dict[str, RunGroup]]
) -> list[RunGroup]:
    common = sorted(set.intersection(*(set(objects) for objects in arms.values())))
    if len(common) < LEAST_OBJECTS:
        return []
    scene = SceneName(hand, f"{len(common)} objects", protocol)
    found = [(arm, _pool_seeds([objects[name] for name in common])) for arm, objects in arms.items()]
    return [RunGroup(scene, *arm, runs) for arm, runs in found if runs]


def _pool_seeds(entries: Sequence[RunGroup]) -> tuple[PooledRun, ...]:
    """One pooled run for each seed that has begun on every object."""
    seeds = [{run.spec.seed: run for run in entry.runs if run.evaluations} for entry in entries]
    common = sorted(set.intersection(*(set(runs) for runs in seeds)))
    return tuple(_pool_runs(tuple(runs[seed] for runs in seeds)) for seed in common)


def _pool_runs(parts: tuple[RunHistory, ...]) -> PooledRun:
    first = {field.name: getattr(parts[0], field.name) for field in fields(RunHistory)}
    target = replace(parts[0].target, stand_in=any(part.target.stand_in for part in parts))
    together = {
        "evaluations": min(part.evaluations for part in parts),
        "complete": all(part.complete for part in parts),
        "target": target,
    }
    return PooledRun(**first | together, parts=parts)


CURVE_STEPS = 200
QUARTILES = (0.25, 0.5, 0.75)


@dataclass(frozen=True)
class CurveMeasure:
    """A number of a run after some of its evaluations."""

    name: str
    words: str
    """What it is, and its unit, for an axis."""
    of: Callable[[RunHistory, ArrayLike], NDArray[np.float64]]


COVERAGE = CurveMeasure("coverage", "coverage of S_G", lambda run, at: run.coverage(at))
PUBLISHED_COVERAGE = CurveMeasure(
    "published", "coverage of S_G as published", lambda run, at: run.published_coverage(at)
)
CELLS = CurveMeasure("cells", "success cells of 1 cm", lambda run, at: run.cells.after(at).astype(np.float64))


def measure_of(entries: Iterable[RunGroup]) -> CurveMeasure:
    """How entries on one scene compare: by coverage, or by success cells where one lacks a set."""
    return COVERAGE if all(entry.target.size for entry in entries) else CELLS


@dataclass(frozen=True)
class QuartileCurve:
    """Quartiles over runs after so many counted evaluations: (k,) each."""

    entry: RunGroup
    measure: CurveMeasure
    evaluations: NDArray[np.int64]
    runs: NDArray[np.int64]
    """How many runs have got that far, which are those that the quartiles are of."""
    low: NDArray[np.float64]
    median: NDArray[np.float64]
    high: NDArray[np.float64]

    @property
    def whole(self) -> int:
        """How many of its points all runs that have begun have reached."""
        return int(np.count_nonzero(self.runs == self.runs.max(initial=0)))


def quartile_curve(entry: RunGroup, measure: CurveMeasure, points: int = CURVE_STEPS) -> QuartileCurve:
    """The curve of an entry at `points` equal steps and at as many equal factors, up to its longest run.

    A run counts as far as it goes, so that the median is of fewer runs beyond the end of the shortest.
    """
    begun = [run for run in entry.runs if run.evaluations]
    ends = np.array([run.evaluations for run in begun], dtype=np.int64)
    end = ends.max(initial=0)
    even, early = np.linspace(0, end, points + 1), np.geomspace(1, max(end, 1), points)
    at = np.unique(np.concatenate([np.concatenate([even, early]).round().astype(np.int64), ends]))
    values = np.array([np.where(at <= run.evaluations, measure.of(run, at), np.nan) for run in begun])
    if not begun:
        values = np.full((1, len(at)), np.nan)
    low, median, high = quartiles(values)
    return QuartileCurve(entry, measure, at, (at <= ends[:, None]).sum(axis=0), low, median, high)


def quartiles(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """First quartile, median and third quartile of each column of (n, k), NaN apart: (3, k)."""
    result = np.full((3, values.shape[1]), np.nan)
    some = ~np.isnan(values).all(axis=0)
    result[:, some] = np.nanquantile(values[:, some], QUARTILES, axis=0)
    return result


def value_after(run: RunHistory, measure: CurveMeasure, evaluations: int) -> float:
    """The number of one run after so many evaluations."""
    return float(measure.of(run, evaluations))


LETTERS_PER_INCH = 17  # Of a panel's heading, in an inch


@dataclass(frozen=True)
class CurvePanel:
    """The curves on one scene."""

    scene: SceneName
    measure: CurveMeasure
    curves: tuple[QuartileCurve, ...]

    @property
    def end(self) -> int:
        """Evaluations of the longest curve."""
        return max(int(one.evaluations[-1]) for one in self.curves)

    @property
    def top(self) -> float:
        """The greatest third quartile."""
        return max(float(np.nanmax(one.high, initial=0.0)) for one in self.curves)


def curve_panels(entries: Sequence[RunGroup]) -> list[CurvePanel]:
    """The curves of all entries, scene by scene."""
    scenes: dict[SceneName, list[RunGroup]] = {}
    for entry in entries:
        scenes.setdefault(entry.scene, []).append(entry)
    found = []
    for scene, here in scenes.items():
        measure = measure_of(here)
        found.append(CurvePanel(scene, measure, tuple(quartile_curve(entry, measure) for entry in here)))
    return found


def measure_words(panel: CurvePanel) -> str:
    """What is measured on a scene, and how far it can be compared."""
    target = panel.curves[0].entry.target
    if panel.measure is COVERAGE:
        pool = ", mean over objects" if isinstance(panel.curves[0].entry.runs[0], PooledRun) else ""
        return f"{panel.measure.words}{pool}{', on a stand-in for the scan' if target.stand_in else ''}"
    return f"{panel.measure.words}: {target.why or 'not all runs have an S_G'}"


def run_words(entries: Sequence[RunGroup], room: float) -> str:
    """How many seeds of how many evaluations there are, in `room` inches: which methods have others."""
    kinds: dict[str, list[str]] = {}
    for entry in entries:
        kinds.setdefault(_seeds_in_words([entry]), []).append(entry.name)
    usual, *others = sorted(kinds, key=lambda kind: -len(kinds[kind]))
    words = "; ".join([usual, *(f"{', '.join(kinds[kind])}: {_shortened(kind)}" for kind in others)])
    return words if len(words) <= LETTERS_PER_INCH * room else _seeds_in_words(entries)


def _shortened(kind: str) -> str:
    return kind.replace(" seeds", "").replace(" seed", "").replace(" evaluations", "")


def _seeds_in_words(entries: Sequence[RunGroup]) -> str:
    seeds = _span([len(entry.runs) for entry in entries])
    ends = _span([run.evaluations for entry in entries for run in entry.runs])
    unfinished = sum(entry.unfinished for entry in entries)
    mark = f", {unfinished} unfinished" if unfinished else ""
    return f"{seeds} seed{'' if seeds == '1' else 's'} \u00d7 {ends} evaluations{mark}"


def _span(numbers: Sequence[int]) -> str:
    low, high = min(numbers), max(numbers)
    return f"{low:,}" if low == high else f"{low:,}\u2013{high:,}"
