"""Generator of a library of varied closed meshes, some of them broken on purpose.

Meshes go into OUT/meshes, the manifest is OUT/library.csv, and OUT/broken.csv says which are broken, and how.
Mesh i is a function of seed and i alone, so that a larger library begins with the smaller one.
"""

import argparse
import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np
import trimesh
from numpy.random import Generator

SUFFIXES = (".stl", ".obj", ".ply", ".glb")
SPLITS = ("train", "train", "train", "train", "test")
BROKEN_EVERY = 50  # One mesh in so many is broken: 2 %


def lathe(random: Generator) -> trimesh.Trimesh:
    """A turned body: vase, bottle, knob."""
    rings = int(random.integers(5, 14))
    height = random.uniform(0.05, 0.2)
    radii = random.uniform(0.012, 0.045, rings)
    profile = np.column_stack([radii, np.linspace(0, height, rings)])
    closed = np.concatenate([[[0, 0]], profile, [[0, height]]])
    return trimesh.creation.revolve(closed, sections=int(random.integers(16, 49)))


def pipe(random: Generator) -> trimesh.Trimesh:
    """A tube that is open at both ends."""
    outer = random.uniform(0.015, 0.04)
    return trimesh.creation.annulus(
        r_min=outer * random.uniform(0.4, 0.9), r_max=outer, height=random.uniform(0.04, 0.2), sections=48
    )


def tool(random: Generator) -> trimesh.Trimesh:
    """A handle with a head across it, as bodies that overlap."""
    length = random.uniform(0.1, 0.22)
    handle = trimesh.creation.cylinder(radius=random.uniform(0.008, 0.016), height=length, sections=24)
    head = trimesh.creation.box(random.uniform((0.05, 0.015, 0.015), (0.11, 0.035, 0.035)))
    head.apply_translation([random.uniform(-0.02, 0.02), 0.0, length / 2])
    return trimesh.util.concatenate([handle, head])


def thin(random: Generator) -> trimesh.Trimesh:
    """A plate or a strip of one to three millimetres."""
    sides = random.uniform(0.03, 0.18, 3)
    sides[random.integers(3)] = random.uniform(0.001, 0.003)
    return trimesh.creation.box(sides)


def dense(random: Generator) -> trimesh.Trimesh:
    """A lump of 20 480 or 81 920 triangles."""
    mesh = trimesh.creation.icosphere(subdivisions=int(random.integers(5, 7)), radius=1.0)
    waves, shifts = random.uniform(2, 6, (4, 3)), random.uniform(0, 2 * np.pi, 4)
    bumps = np.sin(mesh.vertices @ waves.T + shifts).sum(axis=1, keepdims=True)
    mesh.vertices = mesh.vertices * (1 + 0.06 * bumps) * random.uniform(0.015, 0.05, 3)
    return mesh


def torus(random: Generator) -> trimesh.Trimesh:
    """A ring."""
    major = random.uniform(0.02, 0.07)
    return trimesh.creation.torus(
        major, major * random.uniform(0.12, 0.45), major_sections=48, minor_sections=20
    )


def box(random: Generator) -> trimesh.Trimesh:
    """A box, turned at random."""
    mesh = trimesh.creation.box(random.uniform(0.015, 0.12, 3))
    mesh.apply_transform(trimesh.transformations.random_rotation_matrix(random.random(3)))
    return mesh


KINDS: dict[str, Callable[[Generator], trimesh.Trimesh]] = {
    each.__name__: each for each in (lathe, pipe, tool, thin, dense, torus, box)
}


def opened(mesh: trimesh.Trimesh, content: Callable[[trimesh.Trimesh], bytes]) -> bytes:
    """A third of its triangles are missing."""
    return content(trimesh.Trimesh(mesh.vertices, mesh.faces[len(mesh.faces) // 3 :], process=False))


def flat(mesh: trimesh.Trimesh, content: Callable[[trimesh.Trimesh], bytes]) -> bytes:
    """All vertices in a plane."""
    return content(trimesh.Trimesh(mesh.vertices * (1, 1, 0), mesh.faces, process=False))


def in_millimetres(mesh: trimesh.Trimesh, content: Callable[[trimesh.Trimesh], bytes]) -> bytes:
    """A thousand times too large for the unit that the manifest says."""
    return content(trimesh.Trimesh(mesh.vertices * 1000, mesh.faces, process=False))


def apart(mesh: trimesh.Trimesh, content: Callable[[trimesh.Trimesh], bytes]) -> bytes:
    """Two bodies with 5 cm of air between them."""
    other = mesh.copy()
    other.apply_translation([mesh.extents[0] + 0.05, 0.0, 0.0])
    return content(trimesh.util.concatenate([mesh, other]))


def cut_off(mesh: trimesh.Trimesh, content: Callable[[trimesh.Trimesh], bytes]) -> bytes:
    """The first 40 bytes of its file, as a download leaves them."""
    return content(mesh)[:40]


FAULTS = (opened, flat, in_millimetres, apart, cut_off)


def make_library(out: Path, meshes: int, seed: int) -> Path:
    """Write the library, and return its manifest."""
    (out / "meshes").mkdir(parents=True)
    rows, broken = [], []
    for i in range(meshes):
        random = np.random.default_rng((seed, i))
        kind = list(KINDS)[i % len(KINDS)]
        suffix = SUFFIXES[i // len(KINDS) % len(SUFFIXES)]
        file = out / "meshes" / f"{kind}_{i:05}{suffix}"
        mesh = KINDS[kind](random)

        def content(given: trimesh.Trimesh, suffix: str = suffix) -> bytes:
            found = given.export(file_type=suffix[1:])
            return found.encode() if isinstance(found, str) else found

        if i % BROKEN_EVERY == BROKEN_EVERY - 1:
            fault = FAULTS[i // BROKEN_EVERY % len(FAULTS)]
            file.write_bytes(fault(mesh, content))
            broken.append((file.stem, fault.__name__))
        else:
            file.write_bytes(content(mesh))
        density, friction = random.uniform(300, 2000), random.uniform(0.3, 0.9)
        split = SPLITS[int(random.integers(len(SPLITS)))]
        name = file.relative_to(out)
        rows.append(
            (
                name,
                file.stem,
                f"{density:.0f}",
                f"{friction:.2f}",
                kind,
                "CC0-1.0",
                "benchmarks.object_library",
                split,
            )
        )
    _write(out / "broken.csv", ("id", "fault"), broken)
    columns = ("file", "id", "density", "friction", "category", "licence", "source", "split")
    _write(out / "library.csv", columns, rows)
    return out / "library.csv"


def _write(path: Path, header: tuple[str, ...], rows: list[tuple[object, ...]]) -> None:
    with path.open("w", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(header)
        table.writerows(rows)


def main() -> None:
    parser = argparse.ArgumentParser("python -m benchmarks.object_library", description=__doc__)
    parser.add_argument("out", type=Path, help="a new folder")
    parser.add_argument("--meshes", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    print(make_library(given.out, given.meshes, given.seed))


if __name__ == "__main__":
    main()
