"""Reads what runs found, and groups them by scene and method; quartile curves.

Nominal rows are counted; a success's randomised trials give its eta and nothing else. Runs of one hand are
pooled over its objects: a sample is then what a method reached with one seed on all of them, on average.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import bootstrap

from qdgrasp_coordinator.metrics.reference_coverage import CoverageTarget, ReferenceLookup
from qdgrasp_coordinator.metrics.success_metrics import StepSeries, cell_growth, reference_growth
from qdgrasp_coordinator.search import registry
from qdgrasp_coordinator.storage import outputs
from qdgrasp_coordinator.storage.outputs import RUNS, SPEC
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.errors import FolderError
from qdgrasp_protocol.rows import GIVEN, Outcome
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_tools.report.run_report import RunSummary, read_summary

MethodVariant = tuple[str, str]  # A method, and the words that tell its variant from others


@dataclass(frozen=True)
class RunHistory:
    """Growth of one run over its evaluations; without a reference set there is no coverage."""

    path: Path
    spec: RunSpec
    target: CoverageTarget
    summary: RunSummary
    cells: StepSeries
    """Distinct 1 cm cells with a success."""
    robust_cells: StepSeries
    """Distinct 1 cm cells with a robust success."""
    found: StepSeries | None
    """Distinct entries of the reference set."""
    robust_found: StepSeries | None
    """Entries of fitness 2, found by robust successes."""

    @property
    def evaluations(self) -> int:
        """Number of counted evaluations."""
        return self.summary.evaluations

    @property
    def complete(self) -> bool:
        """True if it has spent its budget or reached its goal."""
        return self.summary.complete

    def coverage(self, evaluations: ArrayLike) -> NDArray[np.float64]:
        """Share of the reference set found after so many evaluations; NaN without one."""
        if self.found is None or not self.target.size:
            return np.full(np.shape(evaluations), np.nan)
        return self.found.after(evaluations) / self.target.size


def read_history(folder: RunFolder, target: CoverageTarget) -> RunHistory:
    """Read what a run found, also while it goes on; FolderError if its journal cannot be read."""
    summary, found = read_summary(folder)
    known = target.reference
    return RunHistory(
        path=folder.path,
        spec=folder.spec,
        target=target,
        summary=summary,
        cells=cell_growth(found),
        robust_cells=cell_growth(found, Outcome.HELD),
        found=None if known is None else reference_growth(found, known),
        robust_found=None if known is None else reference_growth(found, known.robust, Outcome.HELD),
    )


HAND_ORDER = ("panda", "panda_2f", "robotiq_2f", "barrett", "bh280", "allegro", "shadow")
"""The paper's order of the hands; others follow."""
GROUP_KEYS = {"gripper", "object", "about", "protocol", "engine", "method", "seed", "surface_seed"}
GROUP_KEYS |= {"evaluations"}
"""Keys of a spec that name the group of a run, or may differ between its runs."""


@dataclass(frozen=True)
class SceneName:
    """Gripper, object and evaluation protocol of runs."""

    gripper: str
    object: str
    """The object's name, or its mesh file's; "3 objects" of pooled runs."""
    protocol: str

    @property
    def words(self) -> str:
        """For a person; the protocol is named where it is not the default."""
        mark = "" if self.protocol == "paper" else f" ({self.protocol})"
        return f"{self.gripper} on {self.object}{mark}"


@dataclass(frozen=True)
class RunGroup:
    """The runs of a method, and one variant of it, on a scene."""

    scene: SceneName
    method: str
    variant: str
    """The settings that tell it from other groups of the method, in words; mostly empty."""
    runs: tuple[RunHistory, ...]
    """At least one, by seed."""

    @property
    def arm(self) -> MethodVariant:
        """Method and variant: the same on every scene."""
        return self.method, self.variant

    @property
    def finished_runs(self) -> tuple[RunHistory, ...]:
        """The finished runs, or as long as no run is finished those with rows."""
        finished = tuple(run for run in self.runs if run.complete)
        return finished or tuple(run for run in self.runs if run.evaluations)


def find_runs(path: Path) -> list[RunFolder]:
    """List the runs of searches in a campaign, in a folder of runs, or of one run; by name.

    Runs that score given poses are passed over. Raises FolderError if there is no such folder, or
    no such run.
    """
    outputs.check_folder(path)
    home = path / RUNS if (path / RUNS).is_dir() else path
    places = [path] if (path / SPEC).is_file() else sorted(home.iterdir())
    runs = [RunFolder(place) for place in places if (place / SPEC).is_file()]
    found = [run for run in runs if run.spec.method != GIVEN]
    if not found:
        raise FolderError(
            f"{path} holds no runs of a search: expected run folders in {path / RUNS} or in {path} itself; "
            "`qdgrasp run --out` and `qdgrasp campaign` make them."
        )
    return found


def read_histories(
    folders: Iterable[RunFolder], targets: ReferenceLookup
) -> tuple[list[RunHistory], list[RunHistory]]:
    """Read what each run found, and set copies and shorter runs of the same search apart.

    These, the second list, are no samples of their own.
    """
    known: dict[MethodVariant, CoverageTarget] = {}
    there, longest = [], dict[Any, RunHistory]()
    for folder in folders:
        scene = folder.bundle().digest if folder.has_bundle() else ""
        key = scene, folder.spec.object
        if key not in known:
            none = CoverageTarget(why="the run's scene is not here")
            known[key] = targets.of(folder.scene(), folder.spec.object) if scene else none
        there.append((folder, scene, read_history(folder, known[key])))
    for folder, scene, run in sorted(there, key=lambda one: -one[2].evaluations):
        same = msgspec.structs.replace(run.spec, evaluations=0)
        # a program's own search may differ where the spec does not
        search = (scene, msgspec.json.encode(same)) if scene and not same.has_own_search else folder.path
        longest.setdefault(search, run)
    kept = {run.path for run in longest.values()}
    runs = [run for *_, run in there]
    return [run for run in runs if run.path in kept], [run for run in runs if run.path not in kept]


def group_runs(runs: Iterable[RunHistory]) -> list[RunGroup]:
    """Group runs that differ in their seed, and maybe in their budget.

    Hands and methods are in the paper's order, searches of a program's own last.
    """
    arms: dict[tuple[SceneName, str], list[RunHistory]] = {}
    for run in runs:
        spec = run.spec
        scene = SceneName(Path(spec.gripper).stem, Path(spec.object).stem, spec.protocol_words)
        arms.setdefault((scene, spec.method), []).append(run)
    methods = [*registry.METHODS, *sorted({method for _, method in arms} - set(registry.METHODS))]
    ordered = sorted(arms, key=lambda arm: (*_scene_order(arm[0]), methods.index(arm[1])))
    return [group for arm in ordered for group in _variants(*arm, arms[arm])]


def _scene_order(scene: SceneName) -> tuple[Any, ...]:
    hand = scene.gripper.removeprefix("ref_")
    order = HAND_ORDER.index(hand) if hand in HAND_ORDER else len(HAND_ORDER)
    return order, scene.gripper, scene.object, scene.protocol


def _variants(scene: SceneName, method: str, runs: list[RunHistory]) -> Iterator[RunGroup]:
    """Yield one group for each setting that occurs, told apart by their differences."""
    settings = [_settings(run.spec) for run in runs]
    differing = [key for key in settings[0] if len({setting[key] for setting in settings}) > 1]
    parts: dict[str, list[RunHistory]] = {}
    for run, setting in zip(runs, settings, strict=True):
        words = ", ".join(f"{key.replace('_', ' ')} {setting[key]}" for key in differing)
        parts.setdefault(words, []).append(run)
    for words, members in sorted(parts.items()):
        yield RunGroup(scene, method, words, tuple(sorted(members, key=lambda run: run.spec.seed)))


def _settings(spec: RunSpec) -> dict[str, str]:
    values = {key: msgspec.to_builtins(value) for key, value in msgspec.structs.asdict(spec).items()}
    values |= {key: " ".join(values[key] or ("-",)) for key in ("on", "avoid")}
    return {
        key: " ".join(f"{name}={one}" for name, one in value.items())
        if isinstance(value, dict)
        else str(value)
        for key, value in values.items()
        if key not in GROUP_KEYS
    }


def grouped_by(groups: Iterable[RunGroup], *, by_object: bool) -> dict[SceneName, list[RunGroup]]:
    """Sort groups by scene, or by hand and protocol alone, in order of first occurrence."""
    found: dict[SceneName, list[RunGroup]] = {}
    for group in groups:
        scene = group.scene if by_object else SceneName(group.scene.gripper, "", group.scene.protocol)
        found.setdefault(scene, []).append(group)
    return found


CURVE_STEPS = 200
QUARTILES = (0.25, 0.5, 0.75)
LEAST_OBJECTS = 2  # Objects, for a mean over objects
Sample = tuple[RunHistory, ...]
"""Runs with one seed, on one object each."""


@dataclass(frozen=True)
class QuartileCurve:
    """Quartiles over the samples of a method after so many counted evaluations: (k,) each."""

    arm: MethodVariant
    samples: tuple[Sample, ...]
    evaluations: NDArray[np.int64]
    runs: NDArray[np.int64]
    """Samples that have got that far, which the quartiles are of."""
    low: NDArray[np.float64]
    median: NDArray[np.float64]
    high: NDArray[np.float64]


@dataclass(frozen=True)
class CurvePanel:
    """The curves of methods on one scene, or of one hand over its objects."""

    scene: SceneName
    is_share: bool
    """True: they are coverage of S_G; False: success cells, as a scene lacks a set."""
    why: str
    """Why it is no coverage; empty where it is."""
    curves: tuple[QuartileCurve, ...]

    @property
    def measure(self) -> str:
        """The label of its axis."""
        return "coverage of S_G" if self.is_share else f"success cells of 1 cm: {self.why}"

    @property
    def end(self) -> int:
        """Evaluations of the longest curve."""
        return max(int(one.evaluations[-1]) for one in self.curves)

    @property
    def common_end(self) -> int:
        """Evaluations that every sample has reached."""
        return min(sample_end(sample) for one in self.curves for sample in one.samples)

    def values(self, sample: Sample, evaluations: ArrayLike) -> NDArray[np.float64]:
        """Return the mean over the objects of a sample after so many evaluations on each."""
        runs = [run.coverage if self.is_share else run.cells.after for run in sample]
        return np.asarray(np.mean([run(evaluations) for run in runs], axis=0))


def sample_end(sample: Sample) -> int:
    """Return the evaluations of the shortest run of a sample."""
    return min(run.evaluations for run in sample)


def scene_panels(groups: Sequence[RunGroup]) -> list[CurvePanel]:
    """Make the curves of all groups, scene by scene."""
    return [
        _panel(scene, {group.arm: [(run,) for run in group.runs] for group in here})
        for scene, here in grouped_by(groups, by_object=True).items()
    ]


def hand_panels(groups: Sequence[RunGroup]) -> list[CurvePanel]:
    """Make the curves of each hand, over the objects that were run with all of its methods.

    They are those that have a set, or all if fewer than two have one. A hand with less than two such objects
    has a panel for each scene. Seeds that not every object has are left out.
    """
    found = []
    for hand, here in grouped_by(groups, by_object=False).items():
        arms: dict[MethodVariant, dict[str, RunGroup]] = {}
        for group in here:
            arms.setdefault(group.arm, {})[group.scene.object] = group
        common = sorted(set.intersection(*(set(objects) for objects in arms.values())))
        with_set = [name for name in common if all(one[name].runs[0].target.size for one in arms.values())]
        names = with_set if len(with_set) >= LEAST_OBJECTS else common
        if len(names) < LEAST_OBJECTS:
            found += scene_panels(here)
            continue
        scene = SceneName(hand.gripper, f"{len(names)} objects", hand.protocol)
        samples = {arm: _pooled([objects[name] for name in names]) for arm, objects in arms.items()}
        if any(samples.values()):
            found.append(_panel(scene, {arm: some for arm, some in samples.items() if some}))
    return found


def _pooled(groups: Sequence[RunGroup]) -> list[Sample]:
    seeds = [{run.spec.seed: run for run in group.runs if run.evaluations} for group in groups]
    common = sorted(set.intersection(*map(set, seeds)))
    return [tuple(runs[seed] for runs in seeds) for seed in common]


def _panel(scene: SceneName, arms: dict[MethodVariant, list[Sample]]) -> CurvePanel:
    targets = [run.target for samples in arms.values() for sample in samples for run in sample]
    why = next((target.why for target in targets if not target.size), "")
    empty = CurvePanel(scene, not why, why, ())
    return CurvePanel(scene, not why, why, tuple(_curve(empty, arm, arms[arm]) for arm in arms))


def _curve(panel: CurvePanel, arm: MethodVariant, samples: Sequence[Sample]) -> QuartileCurve:
    """Make a curve at `CURVE_STEPS` equal steps; fewer samples after the shortest ended."""
    begun = tuple(sample for sample in samples if sample_end(sample))
    ends = np.array([sample_end(sample) for sample in begun], dtype=np.int64)
    even = np.linspace(0, ends.max(initial=0), CURVE_STEPS + 1).round().astype(np.int64)
    at = np.unique(np.concatenate([even, ends]))
    runs = (at <= ends[:, None]).sum(axis=0)
    spread = np.full((3, len(at)), np.nan)
    if begun:
        values = [np.where(at <= sample_end(sample), panel.values(sample, at), np.nan) for sample in begun]
        spread = np.nanquantile(values, QUARTILES, axis=0)
    return QuartileCurve(arm, begun, at, runs, *spread)


LEAST_RUNS = 5
"""Runs without which there is no interval: of fewer, draws repeat one run."""


def mean_interval(values: Sequence[float]) -> tuple[float, float] | None:
    """Return the 95 % bootstrap interval of the mean of runs, bias-corrected and accelerated.

    None of fewer than five runs. The same runs give the same interval.
    """
    if len(values) < LEAST_RUNS:
        return None
    if len(set(values)) == 1:
        return values[0], values[0]
    found = bootstrap((values,), np.mean, random_state=0).confidence_interval
    return float(found.low), float(found.high)
