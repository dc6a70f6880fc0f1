"""Files that claim, nest or unfold to far more than they hold: one sentence, exit code 2, little memory."""

import json
import os
import re
import struct
import subprocess
import sys
import zipfile
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from tests.common import PATIENCE

MOST_MEMORY = 500 << 20  # bytes that a command may have in memory at once
MOST_ADDRESSES = 3 << 30  # bytes that it may ask for; its libraries take a part of these unused
COMMAND = """
import resource, sys
from pathlib import Path
from qdgrasp import entry

resource.setrlimit(resource.RLIMIT_AS, (int(sys.argv[1]),) * 2)
sys.argv = ["qdgrasp", *sys.argv[2:]]
try:
    entry.qdgrasp()
finally:
    Path("peak").write_text(Path("/proc/self/status").read_text().partition("VmHWM:")[2].split()[0])
"""
ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}  # the stacks of others are addresses too
DEEP = 50_000
POSES = ("evaluate", "--gripper", "panda", "--object", "mug", "--out", "scores.npz", "--poses")
IMPORT = ("import", "--gripper", "panda", "--object", "mug", "-o", "poses.npz")
CHECK = ("object", "check")
HAND = ("gripper", "check")
CAMPAIGN = ("campaign", "--gripper", "panda", "--mass", "1", "--out", "out", "--objects")


def array(shape: tuple[int, ...], kind: str = "<f8", payload: bytes = b"") -> bytes:
    """An array's file that says this shape."""
    file = BytesIO()
    header = {"descr": kind, "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(file, header)
    return file.getvalue() + payload


def npz(path: Path, payload: bytes) -> None:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("base_position.npy", payload)


def claiming_npz(path: Path) -> None:
    npz(path, array((600_000_000,)))


def unfolding_npz(path: Path) -> None:
    npz(path, array((100_000_000,), payload=bytes(800_000_000)))


def claiming_npy(path: Path) -> None:
    path.write_bytes(array((600_000_000,)))


def claiming_stl(path: Path) -> None:
    path.write_bytes(bytes(80) + struct.pack("<I", 400_000) + bytes(500))


def claiming_ply(path: Path) -> None:
    path.write_bytes(
        b"ply\nformat binary_little_endian 1.0\nelement vertex 400000000\nproperty float x\n"
        b"property float y\n"
        b"property float z\nelement face 4\nproperty list uchar int vertex_indices\nend_header\n"
        + bytes(1000)
    )


def claiming_text_ply(path: Path) -> None:
    claiming_ply(path)
    path.write_bytes(path.read_bytes().replace(b"binary_little_endian", b"ascii"))


def claiming_off(path: Path) -> None:
    path.write_text("OFF\n400000000 4 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")


def gltf(**changes: object) -> dict:
    accessor = {"componentType": 5126, "count": 400_000_000, "type": "VEC3", "max": [1] * 3, "min": [0] * 3}
    triangle = {"componentType": 5126, "count": 3, "type": "VEC3", "bufferView": 0}
    return {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [triangle, accessor],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "buffers": [{"byteLength": 36}],
    } | changes


def glb(path: Path, document: dict, more: bytes = b"") -> None:
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    data = np.eye(3, dtype="<f4").tobytes() + more
    head = struct.pack("<4sIIII", b"glTF", 2, 28 + len(text) + len(data), len(text), 0x4E4F534A)
    path.write_bytes(head + text + struct.pack("<II", len(data), 0x004E4942) + data)


def claiming_glb(path: Path) -> None:
    glb(path, gltf())


def repeating_glb(path: Path) -> None:
    """Three thousand triangles, some thousand times."""
    one = {"attributes": {"POSITION": 0}}
    nodes = [{"children": list(range(1, 4000))}, *({"mesh": 0} for _ in range(3999))]
    glb(path, gltf(accessors=gltf()["accessors"][:1], nodes=nodes, meshes=[{"primitives": [one] * 3000}]))


def crowded_glb(path: Path) -> None:
    """Thirty-four thousand triangles of one part, 350 times."""
    corners = {"componentType": 5121, "count": 102_000, "type": "SCALAR", "bufferView": 1}
    buffers = {
        "bufferViews": [
            {"buffer": 0, "byteLength": 36},
            {"buffer": 0, "byteOffset": 36, "byteLength": 102_000},
        ],
        "buffers": [{"byteLength": 102_036}],
    }
    nodes = [{"children": list(range(1, 351))}, *({"mesh": 0} for _ in range(350))]
    meshes = [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}]
    document = gltf(accessors=[gltf()["accessors"][0], corners], nodes=nodes, meshes=meshes, **buffers)
    glb(path, document, bytes([0, 1, 2] * 34_000))


def deep_gltf(path: Path) -> None:
    path.write_text('{"asset": ' + "[" * DEEP + "]" * DEEP + "}")


def deep_json(path: Path) -> None:
    path.write_text('{"grasps": ' + '{"a": ' * DEEP + "1" + "}" * DEEP + "}")


def deep_yaml(path: Path) -> None:
    path.write_text("grasps: " + "[" * DEEP + "]" * DEEP)


def deep_toml(path: Path) -> None:
    path.write_text("urdf = " + "[" * DEEP + "]" * DEEP)


def far_mesh(path: Path) -> None:
    path.write_text("v 0 0 0\nv 1e30 0 0\nv 0 1e30 0\nv 0 0 1e30\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")


def far_origin(path: Path) -> None:
    """A hand of two links, one of them too far away."""
    path.write_text(
        '<robot name="far"><link name="a"/><link name="b"/><joint name="j" type="fixed">'
        '<parent link="a"/><child link="b"/><origin xyz="1e30 0 0"/></joint></robot>'
    )


def many_links(path: Path) -> None:
    """A chain of twenty thousand links."""
    joint = '<joint name="j{0}" type="fixed"><parent link="l{1}"/><child link="l{0}"/></joint>'
    links = "".join(f'<link name="l{n}"/>' for n in range(20_000))
    joints = "".join(joint.format(n, n - 1) for n in range(1, 20_000))
    path.write_text(f'<robot name="many">{links}{joints}</robot>')


def huge_chunk(path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        file.create_dataset(
            "grasps/transforms",
            (2, 4, 4),
            "f8",
            maxshape=(None, 4, 4),
            chunks=(20_000_000, 4, 4),
            compression=1,
        )


def many_rows(path: Path) -> None:
    pa, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    parquet.write_table(pa.table({"file": pa.array(np.zeros(20_000_000, dtype="i1"))}), path)


def wide_rows(path: Path) -> None:
    """Two thousand rows of one text of a megabyte."""
    pa, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    text = pa.DictionaryArray.from_arrays(np.zeros(2000, dtype="i4"), ["a" * (1 << 20)])
    parquet.write_table(pa.table({"file": text}), path, compression="zstd")


@pytest.mark.parametrize(
    ("make", "suffix", "command", "words"),
    [
        (claiming_npz, ".npz", POSES, "is not an npz file of plain arrays"),
        (unfolding_npz, ".npz", POSES, "at most 256 MiB are read"),
        (claiming_npy, ".npz", POSES, "is not an npz file of plain arrays"),
        (claiming_stl, ".stl", CHECK, "is damaged"),
        (claiming_ply, ".ply", CHECK, "it states 4800000004 bytes, and has"),
        (claiming_text_ply, ".ply", CHECK, "bytes, and has"),
        (claiming_off, ".off", CHECK, "it states 800000008 bytes, and has"),
        (claiming_glb, ".glb", CHECK, "it states 25600000000 bytes, and has"),
        (repeating_glb, ".glb", CHECK, "has 11997000 parts, and at most 10000 are read"),
        (crowded_glb, ".glb", CHECK, "repeats its parts to 11900000 triangles"),
        (deep_gltf, ".gltf", CHECK, "cannot be read as .gltf"),
        (deep_json, ".json", IMPORT, "it is not JSON with grasps"),
        (deep_yaml, ".yaml", IMPORT, "nested more than 16 levels|maximum nesting depth"),
        (deep_toml, ".toml", HAND, "is not TOML"),
        (far_mesh, ".obj", CHECK, "farther than 1e[+]09 units"),
        (far_origin, ".urdf", HAND, "must hold lengths in metres, of at most 1000"),
        (many_links, ".urdf", HAND, "has 20000 links, and at most 1000 are read"),
        (huge_chunk, ".h5", IMPORT, "chunks that are too large"),
        (many_rows, ".parquet", CAMPAIGN, "it has 20000000 rows, and at most 1000000 are read"),
        (wide_rows, ".parquet", CAMPAIGN, "it unfolds to many times its size"),
    ],
)
def test_a_file_that_stands_for_far_more_than_it_is_takes_little_room(tmp_path, make, suffix, command, words):
    made = tmp_path / f"made{suffix}"
    make(made)
    done = subprocess.run(
        [sys.executable, "-c", COMMAND, str(MOST_ADDRESSES), *command, made.name],
        cwd=tmp_path,
        env=os.environ | ONE_THREAD | {"QDGRASP_CACHE": str(tmp_path / "cache")},
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=False,
    )
    assert done.returncode == 2, done.stderr[-3000:]
    assert "Traceback" not in done.stderr
    assert [line for line in done.stderr.splitlines() if line.startswith("qdgrasp: ")], done.stderr
    assert re.search(words, done.stdout + done.stderr), done.stdout + done.stderr
    assert int((tmp_path / "peak").read_text()) << 10 < MOST_MEMORY
    assert {path.name for path in tmp_path.iterdir()} <= {"peak", "cache", made.name}
