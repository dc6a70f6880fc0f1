"""Shapes: the same wherever they are built, kept by content, and checked when they come from elsewhere."""

import hashlib
import json
import re
import shutil
from importlib.metadata import PackageNotFoundError
from pathlib import Path
from typing import Any

import msgpack
import msgspec
import numpy as np
import pytest
import trimesh

from qdgrasp_assets import code_version, object_shape
from qdgrasp_assets.catalog import build_scene
from qdgrasp_assets.object_shape import (
    ObjectShape,
    ShapeStore,
    build_shape,
    pack_shape,
    shape_task,
    unpack_shape,
)
from qdgrasp_assets.scene import pack_scene
from qdgrasp_protocol.build_messages import MeshPreparation, ShapeTask
from qdgrasp_protocol.errors import AssetError, MessageError, QdgraspError
from qdgrasp_protocol.spec import ObjectRecord, RunSpec

SIDES = (0.02, 0.03, 0.05)
Changes = dict[str, Any]


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("QDGRASP_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def angle(size: float = 0.03) -> trimesh.Trimesh:
    """Two blocks that make an L: its hull is no stand-in for it."""
    tall = trimesh.creation.box((size / 3, size, 2 * size))
    foot = trimesh.creation.box((2 * size, size, size / 3)).apply_translation((size, 0, 0))
    return trimesh.util.concatenate([tall, foot])


def apart(gap: float) -> trimesh.Trimesh:
    blocks = [trimesh.creation.box(SIDES) for _ in range(2)]
    blocks[1].apply_translation((SIDES[0] + gap, 0, 0))
    return trimesh.util.concatenate(blocks)


def split(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The mesh with seams: each triangle has vertices of its own, and one is there twice."""
    faces = np.concatenate([mesh.faces, mesh.faces[:1]])
    return trimesh.Trimesh(mesh.vertices, faces, process=False)


MESHES = {
    "block": lambda: trimesh.creation.box(SIDES),
    "angle": angle,
    "ball": lambda: trimesh.creation.icosphere(radius=0.03),
    "sheet": lambda: trimesh.creation.box((0.06, 0.05, 0.001)),
    "bead": lambda: trimesh.creation.icosphere(radius=0.002),
    "apart": lambda: apart(0.002),
    "open": lambda: trimesh.creation.box(SIDES).submesh([range(1, 12)], append=True),
    "split": lambda: split(trimesh.creation.box(SIDES)),
}


def mesh_spec(folder: Path, name: str = "block", suffix: str = ".stl", **values: Any) -> RunSpec:
    file = folder / f"{name}{suffix}"
    if not file.exists():
        MESHES[name]().export(file)
    return RunSpec(**{"gripper": "panda", "object": str(file), "mass": 0.1} | values)


def folder_of(task: ShapeTask, spec: RunSpec, folder: Path) -> Path:
    """A folder with the files of a task under the names that they have in it."""
    source = Path(spec.object)
    folder.mkdir()
    shutil.copy(source, folder / task.files[0].name)
    for file in task.files[1:]:
        shutil.copy(source.parent / file.name, folder / file.name)
    return folder


def built_elsewhere(spec: RunSpec, folder: Path) -> ObjectShape:
    task = shape_task(spec)
    assert task is not None
    return unpack_shape(pack_shape(build_shape(task, folder_of(task, spec, folder))))


SPECS: dict[str, tuple[str, Changes]] = {
    "plain": ("block", {"friction": 0.7}),
    "scaled, decomposed": ("angle", {"scale": 0.5, "about": ObjectRecord(id="an angle", source="acme")}),
    "glued": ("apart", {"mesh": MeshPreparation(glued=True)}),
    "hull": ("angle", {"mesh": MeshPreparation(hull=True), "surface_seed": 3}),
    "simplified": ("ball", {"mesh": MeshPreparation(simplify=100)}),
    "repaired": ("split", {}),
    "released": ("ball", {"protocol": "released"}),
}


@pytest.mark.parametrize(("name", "values"), SPECS.values(), ids=SPECS)
def test_a_scene_has_the_same_bytes_whether_its_shape_is_built_here_or_elsewhere_or_kept(
    tmp_path, monkeypatch, name, values
):
    spec = mesh_spec(tmp_path, name, **values)
    plain = pack_scene(build_scene(spec))
    monkeypatch.setattr(object_shape, "geometry_of", None)
    assert pack_scene(build_scene(spec)).digest == plain.digest
    monkeypatch.undo()
    monkeypatch.setenv("QDGRASP_CACHE", str(tmp_path / "another"))
    shape = built_elsewhere(spec, tmp_path / "elsewhere")
    assert pack_scene(build_scene(spec, known=shape)).digest == plain.digest


OTHERS: dict[str, Changes] = {
    "scale": {"scale": 1.0},
    "changes": {"mesh": MeshPreparation(hull=True)},
    "surface": {"protocol": "released"},
    "seed": {"surface_seed": 1},
}


def test_the_key_is_another_for_all_that_the_shape_depends_on(tmp_path, monkeypatch):
    spec = mesh_spec(tmp_path)
    tasks = [shape_task(spec)]
    tasks += [shape_task(msgspec.structs.replace(spec, **values)) for values in OTHERS.values()]
    monkeypatch.setattr(object_shape, "building_code", lambda: "0" * 64)
    tasks.append(shape_task(spec))
    monkeypatch.undo()
    trimesh.creation.box((0.02, 0.03, 0.06)).export(spec.object)
    tasks.append(shape_task(spec))
    assert all(tasks)
    assert len({task.key for task in tasks if task}) == len(tasks)


def test_an_installation_without_a_package_builds_no_shapes(monkeypatch):
    def not_there(name: str) -> str:
        raise PackageNotFoundError(name)

    monkeypatch.setattr(code_version, "version", not_there)
    assert not code_version.building_code.__wrapped__()


def buffered(folder: Path, uri: str = "gltf_buffer_0.bin") -> RunSpec:
    """A spec whose mesh has its coordinates in another file."""
    for name, content in trimesh.creation.box(SIDES).export(file_type="gltf").items():
        (folder / name).write_bytes(content)
    file = folder / "model.gltf"
    document = json.loads(file.read_text())
    document["buffers"][0]["uri"] = uri
    file.write_text(json.dumps(document))
    return RunSpec(gripper="panda", object=str(file), mass=0.1)


def test_files_that_a_mesh_names_are_part_of_its_task(tmp_path):
    spec = buffered(tmp_path)
    task = shape_task(spec)
    assert task is not None
    assert [file.name for file in task.files] == ["mesh.gltf", "gltf_buffer_0.bin", "gltf_buffer_1.bin"]
    shape = built_elsewhere(spec, tmp_path / "elsewhere")
    assert pack_scene(build_scene(spec, known=shape)) == pack_scene(build_scene(spec))
    content = bytearray((tmp_path / "gltf_buffer_1.bin").read_bytes())
    content[0] ^= 1
    (tmp_path / "gltf_buffer_1.bin").write_bytes(content)
    changed = shape_task(spec)
    assert changed is not None
    assert changed.key != task.key


@pytest.mark.parametrize(
    "uri", ["../gltf_buffer_0.bin", "{folder}/gltf_buffer_0.bin", "lost.bin", "mesh.gltf"]
)
def test_a_mesh_whose_files_no_other_folder_can_have_has_no_task(tmp_path, uri):
    assert shape_task(buffered(tmp_path, uri.format(folder=tmp_path))) is None


def test_a_shape_is_built_of_the_files_of_its_task_by_its_code_alone(tmp_path):
    spec = mesh_spec(tmp_path)
    task = shape_task(spec)
    assert task is not None
    folder = folder_of(task, spec, tmp_path / "elsewhere")
    with pytest.raises(QdgraspError, match="another version of qdgrasp") as caught:
        build_shape(msgspec.structs.replace(task, code="0" * 64), folder)
    assert not isinstance(caught.value, AssetError)
    (folder / "mesh.stl").write_bytes(b"another")
    with pytest.raises(AssetError, match=r"The file 'mesh\.stl' is not the one"):
        build_shape(task, folder)


def test_a_shape_warns_of_sheets_and_beads_that_the_simulator_does_not_resolve(tmp_path):
    warnings = {
        name: "; ".join(built_elsewhere(mesh_spec(tmp_path, name), tmp_path / f"at {name}").notes)
        for name in ("block", "sheet", "bead")
    }
    assert warnings["block"] == ""
    assert re.match(r"9\d % of its surface is of walls thinner than 2 mm", warnings["sheet"])
    assert "it is 4.0 mm large, smaller than the cells of 10 mm" in warnings["bead"]
    assert "as if it were 6.0 mm large" in warnings["bead"]


@pytest.fixture(scope="module")
def block(tmp_path_factory: pytest.TempPathFactory) -> ObjectShape:
    folder = tmp_path_factory.mktemp("block")
    return built_elsewhere(mesh_spec(folder), folder / "elsewhere")


def array(*values: float, kind: str = "<f4") -> bytes:
    return np.array(values, kind).tobytes()


FAULTS: dict[str, Changes] = {
    "no faces": {"mesh_faces": b""},
    "faces beyond the vertices": {"mesh_faces": array(*[0, 1, 8] * 4, kind="<u4")},
    "a number that is none": {"surface": {"points": array(0, 0, np.nan), "normals": array(0, 0, 1)}},
    "a point far away": {"surface": {"points": array(0, 0, 1e9), "normals": array(0, 0, 1)}},
    "no points": {"surface": {"points": b"", "normals": b""}},
    "fewer normals than points": {"surface": {"normals": array(0, 0, 1)}},
    "a long normal": {"surface": {"points": array(0, 0, 0), "normals": array(0, 0, 2)}},
    "a centre of mass that is nowhere": {"com_in_mesh": (0.0, 0.0, float("inf"))},
    "an empty box": {"surface": {"finder_high": (0.0, -1.0, 0.0)}},
    "no parts": {"collision": b""},
    "a part of other text": {"collision": b"mtllib x\n"},
    "many repairs": {"repairs": ("merged",) * 65},
    "long words": {"collision_source": "x" * 2000},
    "another field": {"more": 1},
    "another field of its points": {"surface": {"more": 1}},
    "no map": {},
}


@pytest.mark.parametrize("values", FAULTS.values(), ids=FAULTS)
def test_a_shape_that_cannot_be_used_is_refused(block, values):
    whole = msgspec.to_builtins(block, builtin_types=(bytes,))
    values = values | {"surface": whole["surface"] | values["surface"]} if "surface" in values else values
    with pytest.raises(MessageError):
        unpack_shape(msgpack.packb(whole | values if values else [1]))


KEYS = [hashlib.sha256(bytes([number])).hexdigest() for number in range(4)]


def test_a_store_gives_back_what_is_whole(block, cache):
    store = ShapeStore()
    assert store.get(KEYS[0]) is None
    store.put(KEYS[0], pack_shape(block))
    assert ShapeStore().get(KEYS[0]) == block
    (file,) = (cache / "shapes").iterdir()
    whole = file.read_bytes()
    for damaged in (b"", whole[:-1], bytes(len(whole))):
        file.write_bytes(damaged)
        assert store.get(KEYS[0]) is None
    store.put(KEYS[0], pack_shape(block))
    assert store.get(KEYS[0]) == block
