"""Entries: the runs of a campaign, by scene and method."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from qdgrasp_coordinator.analysis.history import History, history
from qdgrasp_coordinator.analysis.target import Target, Targets
from qdgrasp_coordinator.folders import disk
from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_coordinator.folders.names import RUNS, SPEC
from qdgrasp_coordinator.searches.search import METHODS
from qdgrasp_protocol.errors import FolderError
from qdgrasp_protocol.genome import GIVEN
from qdgrasp_protocol.spec import Overlaps, RunSpec

HANDS = ("panda", "panda_2f", "robotiq_2f", "barrett", "bh280", "allegro", "shadow")
"""The paper's order of the hands; others follow."""
ARM = {"gripper", "object", "protocol", "method", "seed", "evaluations"}
"""What of a spec says which entry a run belongs to, or may differ between its runs."""
UNITS = {"mass": " kg"}
DEFAULTS = {field.name: field.default for field in msgspec.structs.fields(RunSpec) if field.name not in ARM}
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
class Entry:
    """A method on a scene, and its runs."""

    scene: SceneName
    method: str
    variant: str
    """What tells it from other entries of the method on this scene, in words; mostly empty."""
    runs: tuple[History, ...]
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
    def target(self) -> Target:
        """What its positions are compared with."""
        return self.runs[0].target

    @property
    def unfinished(self) -> int:
        """How many of its runs have not spent their budget."""
        return sum(not run.complete for run in self.runs)

    @property
    def settled(self) -> tuple[History, ...]:
        """The runs that claims are made of: the finished ones; where there is none, those with any row."""
        finished = tuple(run for run in self.runs if run.complete)
        return finished or tuple(run for run in self.runs if run.evaluations)


def run_folders(path: Path) -> list[RunFolder]:
    """The folders of a campaign's runs, or of the runs that lie side by side in a folder; by name.

    Those that score given poses are passed over: they searched nothing. What a run found is read from its
    spec, scene and journal; the files of its job are not needed.

    Raises
    ------
    NoFolder, FolderError
        There is no such folder, or no run of a search in it.
    """
    disk.check_folder(path)
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


def histories(folders: Iterable[RunFolder], targets: Targets) -> Iterator[History]:
    """What each run found; a scene is looked at once."""
    known: dict[tuple[str, str], Target] = {}
    for folder in folders:
        run_object = folder.spec.object
        if not folder.has_bundle():
            yield history(folder, Target(why="the run's scene is not here"))
            continue
        key = folder.bundle().digest, run_object
        if key not in known:
            known[key] = targets.of(folder.scene(), run_object)
        yield history(folder, known[key])


def entries(runs: Iterable[History]) -> list[Entry]:
    """Put runs together that differ in their seed alone; hands and methods in the paper's order."""
    arms: dict[tuple[SceneName, str], list[History]] = {}
    for run in runs:
        arms.setdefault((scene_name(run.spec), run.spec.method), []).append(run)
    ordered = sorted(arms, key=lambda arm: (*_place(arm[0]), list(METHODS).index(arm[1])))
    return [entry for scene, method in ordered for entry in _variants(scene, method, arms[scene, method])]


def usual(entries: Iterable[Entry]) -> dict[SceneName, dict[str, Entry]]:
    """On each scene, for each method the variant that departs from the defaults in the fewest settings."""
    scenes: dict[SceneName, dict[str, Entry]] = {}
    for entry in sorted(entries, key=_departures):
        scenes.setdefault(entry.scene, {}).setdefault(entry.method, entry)
    return scenes


def _departures(entry: Entry) -> int:
    own, setting = METHODS[entry.method], _settings(entry.runs[0].spec)
    usual = DEFAULTS | {"overlaps": own.overlaps, "population": own.population}
    return sum(setting[name] != default for name, default in usual.items())


def scene_name(spec: RunSpec) -> SceneName:
    """The scene that a spec asks for."""
    return SceneName(Path(spec.gripper).stem, Path(spec.object).stem, spec.protocol)


def _place(scene: SceneName) -> tuple[Any, ...]:
    hand = scene.gripper.removeprefix("ref_")
    order = HANDS.index(hand) if hand in HANDS else len(HANDS)
    return order, scene.gripper, scene.object, scene.protocol


def _variants(scene: SceneName, method: str, runs: list[History]) -> Iterator[Entry]:
    """One entry for each setting that occurs, told apart by what differs between them."""
    settings = [_settings(run.spec) for run in runs]
    differing = [key for key in settings[0] if len({setting[key] for setting in settings}) > 1]
    parts: dict[tuple[Any, ...], list[History]] = {}
    for run, setting in zip(runs, settings, strict=True):
        parts.setdefault(tuple(setting[key] for key in differing), []).append(run)
    for values in sorted(parts, key=lambda values: [(value is not None, value) for value in values]):
        words = ", ".join(_words(key, value) for key, value in zip(differing, values, strict=True))
        members = sorted(parts[values], key=lambda run: (run.spec.seed, run.path.name))
        yield Entry(scene, method, words, tuple(members))


def _settings(spec: RunSpec) -> dict[str, Any]:
    return {key: value for key, value in msgspec.structs.asdict(spec).items() if key not in ARM}


def _words(key: str, value: object) -> str:
    return f"{key.replace('_', ' ')} {'default' if value is None else value}{UNITS.get(key, '')}"
