"""Folders of campaigns over libraries, made by hand: objects with many grasps or few."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
import trimesh
from tests.coordinator.recorded_runs import SHAPE, write_journal
from tests.coordinator.scenes import made_scene

from qdgrasp_assets.scene import Bundle, pack_scene
from qdgrasp_coordinator.metrics.job_status import ObjectListing, RunListing
from qdgrasp_coordinator.metrics.run_stats import RunTotals
from qdgrasp_coordinator.storage.job_folder import JobFolder
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.rows import Outcome, Rows
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_tools.campaign.campaign_file import make_campaign
from qdgrasp_tools.campaign.campaign_folder import begin_campaign
from qdgrasp_tools.campaign.object_library import SkippedObject
from qdgrasp_tools.campaign.summaries import list_objects

KINDS: dict[str, dict[Outcome, float]] = {
    "good": {Outcome.HELD: 0.4, Outcome.DROPPED: 0.2, Outcome.MISSED: 0.2, Outcome.OVERLAP: 0.2},
    "better": {Outcome.HELD: 0.6, Outcome.SHAKEN: 0.2, Outcome.MISSED: 0.2},
    "overlaps": {Outcome.OVERLAP: 1.0},
    "untouched": {Outcome.MISSED: 0.98, Outcome.DROPPED: 0.02},
    "dropped": {Outcome.DROPPED: 0.9, Outcome.MISSED: 0.1},
    "plain": {Outcome.HELD: 0.3, Outcome.DROPPED: 0.3, Outcome.MISSED: 0.2, Outcome.BRUSHED: 0.2},
    "failing": {Outcome.ERROR: 1.0},
    "usual": {Outcome.HELD: 0.35, Outcome.SHAKEN: 0.1, Outcome.MISSED: 0.55},
}
"""Shares of outcomes of the kinds of objects, which follow each other again and again."""
SKIPPED = (
    SkippedObject("torn", "/library/torn.stl", "it is not closed; --remesh or --hull"),
    SkippedObject("split", "/library/split.stl", "it has 2 bodies; --glued"),
    SkippedObject("cracked", "/library/cracked.stl", "it is not closed; --remesh or --hull"),
)
CATEGORIES = ("mug", "tool", "box")
HANDS = ("panda", "allegro")
BUDGET = 50


def rows_of(kind: str, n: int = BUDGET, seed: int = 0) -> Rows:
    """Nominal rows of a kind of object, ten to a generation."""
    random = np.random.default_rng(seed)
    rows = SHAPE.empty(n)
    rows["generation"], rows["index"] = np.divmod(np.arange(n), 10)
    counts = [round(share * n) for share in KINDS[kind].values()]
    counts[0] += n - sum(counts)
    rows["outcome"] = np.repeat([int(outcome) for outcome in KINDS[kind]], counts)
    rows["fitness"] = np.clip(rows["outcome"].astype(int) - Outcome.DROPPED, 0, 2)
    rows["base_to_object"][:, :3] = random.uniform(-0.1, 0.1, (n, 3))
    rows["base_to_object"][:, 6], rows["surface_point"], rows["steps"] = 1, 0.01, 1
    rows["descriptor"] = rows["base_to_object"][:, :3]
    return rows


def shapes() -> list[Bundle]:
    """Scenes of a few shapes."""
    meshes = (
        trimesh.creation.box((0.06, 0.04, 0.09)),
        trimesh.creation.cylinder(0.03, 0.1, sections=48),
        trimesh.creation.torus(0.05, 0.015),
        trimesh.creation.icosphere(3, 0.04),
        trimesh.creation.cone(0.04, 0.1, sections=48),
    )
    scene, bundles = made_scene(), []
    for mesh in meshes:
        faces = mesh.faces.astype("<u4").tobytes()
        body = msgspec.structs.replace(
            scene.object, mesh_vertices=mesh.vertices.astype("<f4").tobytes(), mesh_faces=faces
        )
        bundles.append(pack_scene(msgspec.structs.replace(scene, object=body)))
    return bundles


def record_campaign(
    path: Path, objects: int, begun: float = 0.75, hands: tuple[str, ...] = HANDS, n: int = BUDGET
) -> JobFolder:
    """Begin a campaign over so many objects, and record the runs of a share of them.

    The last tenth of the recorded objects, at least one, has half of its rows in the run of the last hand.
    """
    known: dict[str, dict[str, Any]] = {
        f"/library/part_{number:05d}.stl": {
            "mass": 0.1,
            "about": {"id": f"part_{number:05d}", "category": CATEGORIES[number % len(CATEGORIES)]},
        }
        for number in range(objects)
    }
    cross = {"gripper": list(hands), "object": [*known], "evaluations": n, "population": 10}
    cross |= {"overlaps": "count"}
    campaign = make_campaign({"cross": [cross], "objects": known}, "library", here=False)
    begin_campaign(path, replace(campaign, skipped=SKIPPED))
    job, scenes = JobFolder(path), shapes()
    last = round(begun * objects)
    for name, spec in campaign.runs.items():
        number = int(Path(spec.object).stem.removeprefix("part_"))
        if number >= last:
            continue
        rows = rows_of([*KINDS][number % len(KINDS)], n, seed=number)
        is_open = number >= last - max(1, last // 10) and spec.gripper == hands[-1]
        bundle = scenes[number % len(scenes)]
        RunFolder.add(job, name, spec, bundle)
        write_journal(job.run_path(name), spec, rows[: n // 2] if is_open else rows, bundle, run=name)
    return job


class ObjectRun(NamedTuple):
    """A run of an object, as far as it has got; without totals it has not begun."""

    name: str
    spec: RunSpec
    totals: RunTotals | None = None
    is_done: bool = False

    @property
    def listing(self) -> RunListing:
        assert self.totals is not None
        names = ("gripper", "object", "method", "protocol", "seed")
        return RunListing(
            **msgspec.structs.asdict(self.totals),
            **{name: getattr(self.spec, name) for name in names},
            run=self.name,
            scene="",
            budget=self.spec.evaluations,
            rows=0,
            outcomes={},
            finished="done" if self.is_done else "",
        )


def listed(runs: Iterable[ObjectRun], skipped: Iterable[SkippedObject] = ()) -> list[ObjectListing]:
    """The table of the objects of these runs."""
    known = {run.name: run for run in runs}
    begun = {name: run.listing for name, run in known.items() if run.totals is not None}
    return list_objects({name: run.spec for name, run in known.items()}, begun, skipped)
