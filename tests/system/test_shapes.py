"""Workers build the shapes of a campaign's meshes, each once, also after kills."""

from pathlib import Path

import pytest
import trimesh
from tests.system.commands import Commands, digest_of

from qdgrasp_coordinator.storage.job_folder import JobFolder

ASKED = ("--gripper", "panda", "--mass", 0.1, "--protocol", "physical", "--evaluations", 40)
CAMPAIGN = ("campaign", "--objects", "parts", *ASKED, "--seed", 0, "--seed", 1)


@pytest.fixture
def parts(qdgrasp: Commands) -> Path:
    """A folder of three boxes, and a ring that has to be decomposed."""
    folder = qdgrasp.home / "parts"
    folder.mkdir()
    for name, sides in {"cube": (0.05,) * 3, "block": (0.04, 0.05, 0.08), "bar": (0.02, 0.02, 0.2)}.items():
        trimesh.creation.box(sides).export(folder / f"{name}.stl")
    trimesh.creation.annulus(0.03, 0.045, 0.03).export(folder / "ring.stl")
    return folder


def shapes(qdgrasp: Commands) -> dict[str, int]:
    """The shapes that are kept, with the inode of each: one that is built again has another."""
    folder = qdgrasp.home / "cache" / "shapes"
    return {file.name: file.stat().st_ino for file in folder.glob("*.shape")} if folder.is_dir() else {}


def digests(qdgrasp: Commands, folder: str) -> dict[str, str]:
    return {path.name: digest_of(path) for path in JobFolder.open(qdgrasp.home / folder).run_paths}


@pytest.mark.slow
def test_each_shape_is_built_once_and_runs_are_those_of_scenes_that_are_built_here(qdgrasp, parts) -> None:
    qdgrasp.succeed(*CAMPAIGN, "--workers", 2, "--out", "out")
    built = shapes(qdgrasp)
    assert len(built) == len(list(parts.iterdir()))
    assert "Decomposing" not in (qdgrasp.home / "out" / "logs" / "coordinator.log").read_text()
    alone = ("run", "--object", parts / "ring.stl", *ASKED)
    alone += ("--set", "in_flight=400", "--set", "generations_in_flight=1")
    qdgrasp.succeed(*alone, "--workers", 1, "--out", "alone")
    (name,) = [name for name in digests(qdgrasp, "out") if "ring" in name and "-s0" in name]
    assert digest_of(qdgrasp.home / "alone") == digests(qdgrasp, "out")[name]
