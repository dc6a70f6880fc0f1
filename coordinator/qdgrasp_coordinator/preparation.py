"""From what a user asks for to a run that can be carried out: spec, scene, search and pipeline."""

from pathlib import Path
from typing import Any

from qdgrasp_assets.catalog import build_scene
from qdgrasp_assets.genes import archive_box, layout
from qdgrasp_assets.scene import Bundle, Scene, pack_scene
from qdgrasp_coordinator.pipeline import Pipeline
from qdgrasp_coordinator.search import method
from qdgrasp_coordinator.service import Assignment
from qdgrasp_protocol.rows import Shape
from qdgrasp_protocol.spec import RunSpec, run_spec, to_toml

RUN = "run"
"""The name of the run in a job that has only one."""


def full_spec(values: dict[str, Any], where: str = "spec") -> RunSpec:
    """The spec that values stand for, complete: files as absolute paths, overlaps as the method has them.

    Raises
    ------
    InputError
        A key, value or name that cannot be; the ones that can are named.
    """
    spec = run_spec(values, where)
    chosen = method(spec.method)
    whole = dict(values)
    whole.setdefault("overlaps", chosen.overlaps)
    for name in ("gripper", "object"):
        path = Path(values[name]).expanduser()
        if path.suffix and path.is_file():
            whole[name] = str(path.resolve())
    return run_spec(whole, where)


def default_name(spec: RunSpec) -> str:
    """The name of a run's folder when none is given."""
    return f"{Path(spec.gripper).stem}-{Path(spec.object).stem}-{spec.method}-s{spec.seed}"


def make_bundle(spec: RunSpec) -> tuple[Scene, Bundle]:
    """The scene of a spec, and its bytes."""
    scene = build_scene(spec)
    return scene, pack_scene(scene)


def assignment(spec: RunSpec, scene: Scene, bundle: Bundle) -> Assignment:
    """A run, ready for the coordinator."""
    chosen = method(spec.method)
    shape = scene_shape(scene, chosen.prior)
    search = chosen.build(spec, shape.genes, archive_box(scene, chosen.prior))
    pipeline = Pipeline(
        search,
        shape,
        evaluations=spec.evaluations,
        overlaps=spec.overlaps,
        generations_in_flight=spec.generations_in_flight,
    )
    return Assignment(RUN, to_toml(spec).encode(), bundle, chosen.prior, shape, pipeline, spec.evaluations)


def scene_shape(scene: Scene, prior: str) -> Shape:
    """How wide the rows of a scene are."""
    return Shape(genes=len(layout(scene, prior)), joints=len(scene.gripper.joints))
