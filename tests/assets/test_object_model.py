"""Mesh files as objects: accepted, repaired, or refused in one sentence."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from qdgrasp_assets.geometry.mesh import box
from qdgrasp_assets.geometry.mesh_io import WRITABLE_FORMATS, to_bytes
from qdgrasp_assets.object_model import file_facts, read_draft, read_solid, solid_draft
from qdgrasp_protocol.build_messages import MeshPreparation
from qdgrasp_protocol.errors import AssetError
from qdgrasp_protocol.spec import RunSpec

BLOCK = (0.02, 0.03, 0.05)


def write(path: Path, mesh: trimesh.Trimesh | trimesh.Scene) -> Path:
    mesh.export(path)
    return path


def block(*shift: float) -> trimesh.Trimesh:
    return trimesh.creation.box(BLOCK).apply_translation(shift or (0, 0, 0))


NAMES = ("block.STL", "my part.stl", "Müller-Gehäuse №1.stl", "部品.stl")


@pytest.mark.parametrize("name", [*NAMES, *(f"block{suffix}" for suffix in WRITABLE_FORMATS)])
def test_a_solid_is_written_and_read_in_any_format_and_may_have_any_name(tmp_path, name):
    (tmp_path / name).write_bytes(to_bytes(box(BLOCK).moved((0.1, 0, 0)), Path(name).suffix))
    mesh = read_solid(tmp_path / name)
    assert mesh.volume == pytest.approx(np.prod(BLOCK), rel=1e-5)
    assert mesh.extents == pytest.approx(BLOCK, rel=1e-5)
    assert mesh.centre_of_mass == pytest.approx([0.1, 0, 0], abs=1e-6)


def test_a_solid_that_nothing_is_wrong_with_stays_as_it_came(tmp_path):
    """To the last bit and in its order: scenes of scans were recorded so."""
    path = write(tmp_path / "ball.ply", trimesh.creation.icosphere(subdivisions=3, radius=0.03))
    as_came, draft = trimesh.load_mesh(path), read_draft(path)
    assert draft.repairs == ()
    assert np.array_equal(draft.mesh.vertices, as_came.vertices)
    assert np.array_equal(draft.mesh.faces, as_came.faces)


def test_bodies_that_are_apart_are_one_object_only_if_that_is_said_and_need_a_mass(tmp_path):
    path = write(tmp_path / "pair.stl", trimesh.util.concatenate([block(), block(0.1, 0, 0)]))
    assert read_solid(path).volume == pytest.approx(2 * np.prod(BLOCK), rel=1e-4)
    with pytest.raises(AssetError, match=r"about 0.08 m of air between them.* say with --mesh glued"):
        solid_draft(path)
    with pytest.raises(AssetError, match="has no mass; say how heavy the object is with --mass"):
        file_facts(RunSpec(gripper="", object=str(path)))


def test_several_geometries_of_a_scene_are_one_object_where_they_stand(tmp_path):
    scene = trimesh.Scene()
    for x in (0.0, 0.1):
        scene.add_geometry(block(), transform=trimesh.transformations.translation_matrix((x, 0, 0)))
    path = write(tmp_path / "pair.glb", scene)
    draft = read_draft(path)
    assert len(draft.geometries) == 2
    assert draft.mesh.extents == pytest.approx((0.12, 0.03, 0.05))
    for name in draft.geometries:
        assert read_draft(path, None, MeshPreparation(geometry=name)).mesh.extents == pytest.approx(BLOCK)
    with pytest.raises(AssetError, match=f"no geometry 'lid', but {', '.join(draft.geometries)}"):
        read_draft(path, None, MeshPreparation(geometry="lid"))


def open_block() -> trimesh.Trimesh:
    return trimesh.Trimesh(block().vertices, block().faces[1:], process=False)


def sheet() -> trimesh.Trimesh:
    corners = [(0, 0, 0), (0.1, 0, 0), (0, 0.1, 0)]
    return trimesh.Trimesh(corners, [(0, 1, 2), (2, 1, 0)], process=False)


def projective_plane() -> trimesh.Trimesh:
    """The ten triangles of a surface with one side."""
    faces = ["123", "134", "145", "156", "162", "235", "346", "452", "563", "624"]
    corners = np.random.default_rng(0).uniform(-0.05, 0.05, (7, 3))
    return trimesh.Trimesh(corners, [list(map(int, face)) for face in faces], process=False)


@pytest.mark.parametrize(
    ("mesh", "sentence"),
    [
        (block().apply_scale(1000), r"is 20 x 30 x 50 m large, larger than .* millimetres: add --units mm"),
        (block().apply_scale(0.001), r"is 2e-05 x 3e-05 x 5e-05 m large, smaller than .* with --units"),
        (
            open_block(),
            r"is not closed \(watertight\): 3 edges have only one triangle, around 1 hole 0\.0500 m wide at "
            r"\(-0\.0100, 0\.0000, 0\.0000\); close it .* --mesh fill",
        ),
        (sheet(), "is flat: it encloses no volume; give it a thickness"),
        (projective_plane(), "wound both ways along .* cannot all face outward"),
    ],
)
def test_a_mesh_that_is_no_solid_is_refused(tmp_path, mesh, sentence):
    with pytest.raises(AssetError, match=sentence) as refused:
        read_solid(write(tmp_path / "part.ply", mesh))
    assert "\n" not in str(refused.value)
