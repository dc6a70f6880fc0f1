"""From what a user asks for to a run that can be carried out: spec, scene, search and pipeline."""

from pathlib import Path
from typing import Any

from qdgrasp_assets.catalog import build_scene
from qdgrasp_assets.files import amiss, named_path
from qdgrasp_assets.genes import descriptors, layout
from qdgrasp_assets.scene import Bundle, Scene, pack_scene
from qdgrasp_coordinator.counts.goals import Goals
from qdgrasp_coordinator.folders.job_folder import RUN
from qdgrasp_coordinator.runs.assignment import Assignment
from qdgrasp_coordinator.runs.pipeline import Pipeline
from qdgrasp_coordinator.searches.search import Search, check, method
from qdgrasp_coordinator.searches.space import space
from qdgrasp_protocol.rows import Shape
from qdgrasp_protocol.spec import RunSpec, run_spec, to_toml
from qdgrasp_protocol.trials import trials


def full_spec(values: dict[str, Any], where: str = "spec") -> RunSpec:
    """The spec that values stand for, complete: files as absolute paths, the rest as the method has it.

    Raises
    ------
    InputError
        A key, value or name that cannot be, or not with this method; what can is named.
    """
    chosen = method(run_spec(values, where).method)
    usual = {name: getattr(chosen, name) for name in ("overlaps", "population", "generations_in_flight")}
    whole = usual | values
    whole |= {name: located(values[name]) for name in ("gripper", "object")}
    spec = run_spec(whole, where)
    check(spec)
    return spec


def located(name: Any) -> Any:
    """A gripper or object: a file as its absolute path, anything else as it is."""
    path = named_path(name) if isinstance(name, str) else Path()
    return str(path.resolve()) if path.suffix and not amiss(path) else name


def default_name(spec: RunSpec) -> str:
    """The name of a run's folder when none is given."""
    return f"{Path(spec.gripper).stem}-{Path(spec.object).stem}-{spec.method}-s{spec.seed}"


def make_bundle(spec: RunSpec) -> tuple[Scene, Bundle]:
    """The scene of a spec, and its bytes.

    Raises
    ------
    InputError
        It cannot be built, or the method's prior is not for such a hand.
    """
    scene = build_scene(spec)
    scene_shape(scene, method(spec.method).prior)
    return scene, pack_scene(scene)


def assignment(spec: RunSpec, scene: Scene, bundle: Bundle, run: str = RUN) -> Assignment:
    """A run, ready for the coordinator."""
    chosen = method(spec.method)
    return with_search(chosen.build(spec, space(scene, chosen.prior)), spec, scene, bundle, run)


def with_search(search: Search, spec: RunSpec, scene: Scene, bundle: Bundle, run: str = RUN) -> Assignment:
    """The same with a search of whatever making, that asks genomes of the method's prior."""
    chosen = method(spec.method)
    shape = scene_shape(scene, chosen.prior)
    pipeline = Pipeline(
        search,
        shape,
        evaluations=spec.evaluations,
        overlaps=spec.overlaps,
        generations_in_flight=spec.generations_in_flight,
        trials=trials(spec.protocol),
        goals=Goals.of(spec),
    )
    return Assignment(run, to_toml(spec).encode(), bundle, chosen.prior, shape, pipeline, spec.evaluations)


def scene_shape(scene: Scene, prior: str) -> Shape:
    """How wide the rows of a scene are."""
    return Shape(len(layout(scene, prior)), len(scene.gripper.joints), descriptors(prior))
