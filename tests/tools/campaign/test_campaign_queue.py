"""Runs of a campaign on mesh files wait for their shapes, and are made once these are there."""

from pathlib import Path

import pytest
import trimesh

from qdgrasp_assets.object_shape import build_shape, pack_shape
from qdgrasp_coordinator.scheduler.run_plan import (
    BuildReply,
    ShapesMissing,
    WantedShape,
    full_spec,
    prepare_scene,
)
from qdgrasp_coordinator.storage.job_folder import JobFolder
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.build_messages import split_payload
from qdgrasp_protocol.errors import RunFailed
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_tools.campaign.campaign_file import make_campaign
from qdgrasp_tools.campaign.campaign_folder import CampaignRunQueue

POSES = (((0.0, 0.0, 0.2), (0.0, 0.0, 0.0, 1.0)), ((0.0, 0.0, 0.2), (0.0, 0.0, 0.0, 0.0)))
"""Places and quaternions of hands; the second is no rotation."""


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache folder."""
    monkeypatch.setenv("QDGRASP_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def runs(tmp_path: Path) -> dict[str, RunSpec]:
    """Two seeds on each of two boxes, and one run on an object of the catalog."""
    meshes = []
    for side in (0.04, 0.05):
        meshes.append(str(tmp_path / f"box{1000 * side:.0f}.stl"))
        trimesh.creation.box((side, side, 0.1)).export(meshes[-1])
    crosses = [
        {"gripper": "panda", "object": meshes, "mass": 0.1, "seed": [0, 1], "evaluations": 10},
        {"gripper": "panda", "object": "tennis_ball", "evaluations": 10},
    ]
    return dict(make_campaign({"cross": crosses}, "test").runs)


def files(wanted: WantedShape, folder: Path) -> Path:
    """A folder with the files of a shape, as a worker has them."""
    folder.mkdir(exist_ok=True)
    for file, path in zip(wanted.task.files, wanted.paths.values(), strict=True):
        (folder / file.name).write_bytes(path.read_bytes())
    return folder


def built(wanted: WantedShape, folder: Path) -> BuildReply:
    """The answer of a worker."""
    shape = build_shape(wanted.task, files(wanted, folder))
    return BuildReply(wanted.task.key, split_payload(pack_shape(shape)))


def open_all(queue: CampaignRunQueue) -> list[str]:
    """The names of all runs that can be made now."""
    names = []
    try:
        while plan := queue.next():
            names.append(plan.run)
    except ShapesMissing:
        pass
    return names


def test_each_shape_is_wanted_once_and_runs_that_need_none_go_first(runs: dict[str, RunSpec]) -> None:
    queue = CampaignRunQueue(None, runs)
    wanted = queue.wanted_shapes(10)
    assert wanted.is_last
    assert [shape.mesh.name for shape in wanted.shapes] == ["box40.stl", "box50.stl"]
    assert open_all(queue) == ["panda-tennis_ball-portfolio-s0"]
    assert not queue.wanted_shapes(10).shapes


def test_runs_are_made_with_the_scene_that_this_machine_would_build(runs, tmp_path) -> None:
    queue = CampaignRunQueue(None, runs)
    for wanted in queue.wanted_shapes(10).shapes:
        assert queue.take_shape(built(wanted, tmp_path / "worker")) is None
    assert queue.ready_runs == 5
    scenes = {}
    while plan := queue.next():
        scenes[plan.run] = plan.bundle.digest
    assert scenes == {name: prepare_scene(spec).bundle.digest for name, spec in runs.items()}


def test_runs_that_may_touch_an_object_elsewhere_have_other_scenes() -> None:
    cross = {"gripper": "panda", "object": "mug", "on": [["handle"], ["rim"]]}
    queue = CampaignRunQueue(None, make_campaign({"cross": [cross]}, "test").runs)
    scenes = [plan.bundle.digest for plan in iter(queue.next, None)]
    assert len(set(scenes)) == 2


def test_the_runs_of_a_shape_that_cannot_be_built_fail_and_the_others_are_made(runs, tmp_path) -> None:
    queue = CampaignRunQueue(None, runs)
    bad, good = queue.wanted_shapes(10).shapes
    queue.take_shape(BuildReply(bad.task.key, reason="it burst"))
    queue.take_shape(built(good, tmp_path / "worker"))
    failed = []
    for _ in range(2):
        with pytest.raises(RunFailed, match="The shape of its object cannot be built: it burst") as failure:
            queue.next()
        failed.append(failure.value.run)
    assert failed == [name for name in runs if "box40" in name]
    assert [queue.object_of(name) for name in failed] == [runs[name].object for name in failed]
    assert sorted([*failed, *open_all(queue)]) == sorted(runs)


@pytest.mark.parametrize("pieces", [(), (b"no shape",), split_payload(b"no shape")])
def test_a_shape_that_no_worker_gives_is_built_here(runs, pieces) -> None:
    queue = CampaignRunQueue(None, runs)
    warnings = [queue.take_shape(BuildReply(one.task.key, pieces)) for one in queue.wanted_shapes(10).shapes]
    if pieces:
        assert all(warning and "is left aside" in warning.words for warning in warnings)
    else:
        assert warnings == [None, None]
    assert sorted(open_all(queue)) == sorted(runs)


def test_poses_that_the_hand_cannot_take_fail_their_run_alone_and_leave_no_folder(tmp_path: Path) -> None:
    asked = {"gripper": "panda", "object": "tennis_ball", "method": "given", "evaluations": 1}
    good, bad = ({**asked, "poses": [[*place, *turn]]} for place, turn in POSES)
    specs = {name: full_spec(values) for name, values in (("a", good), ("b", bad), ("c", good))}
    folder = JobFolder.create(tmp_path / "campaign", "campaign")
    queue = CampaignRunQueue(folder, specs)
    assert queue.next().run == "a"
    with pytest.raises(RunFailed, match="of length zero"):
        queue.next()
    assert open_all(queue) == ["c"]
    assert not folder.run_path("b").exists()
    RunFolder.add(folder, "b", specs["b"], prepare_scene(specs["a"]).bundle)
    with pytest.raises(RunFailed, match="of length zero"):
        CampaignRunQueue(folder, {"b": specs["b"]}).next()
