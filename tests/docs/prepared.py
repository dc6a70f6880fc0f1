"""Files and folders of small real runs that pages assume, made when they are first needed."""

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import trimesh
from tests.assets import example_hands, example_mjcf
from tests.docs.pages import ROOT, blocks
from tests.system.commands import Commands

import qdgrasp
from qdgrasp_coordinator.metrics.cells import cells
from qdgrasp_coordinator.storage.job_folder import new_job
from qdgrasp_coordinator.storage.outputs import LOGS
from qdgrasp_coordinator.storage.run_folder import RunFolder

RUNS = """
[defaults]
gripper = "panda"
protocol = "physical"
evaluations = 60
population = 20

[[cross]]
object = "mug"
method = "portfolio"
seed = [0, 1]

[[cross]]
object = "rubiks_cube"
method = "portfolio"
seed = 0

[[cross]]
object = "part.stl"
mass = 0.3
method = "portfolio"
seed = [0, 1, 2]
"""
"""All runs that are assumed: of one campaign, for one worker is started sooner than six."""
SPEC = 'gripper = "panda"\nobject = "mug"\nmethod = "portfolio"\nevaluations = 150\n'
MANY = """
[defaults]
gripper = "panda"
object = "mug"
evaluations = 40
population = 20

[[cross]]
method = ["contact_rand", "approach_rand"]
seed = [0]
"""


class Prepared:
    """A folder in which files that pages assume are made once; pages get copies."""

    def __init__(self, home: Path) -> None:
        self.home = home
        self.commands = Commands(home)

    def give(self, name: str, to: Path) -> None:
        """Have a file or folder in another home too."""
        target = to / name
        if target.exists():
            return
        target.parent.mkdir(parents=True, exist_ok=True)
        source = self.make(name)
        if source.is_dir():
            shutil.copytree(source, target)
        else:
            shutil.copy(source, target)
        for other in NEEDED.get(name, ()):
            self.give(other, to)

    def make(self, name: str) -> Path:
        """Make a file or folder unless it is there."""
        path = self.home / name
        if not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            MAKERS[name](self, path)
        return path

    def __call__(self, *arguments: object) -> None:
        self.commands.succeed(*arguments, QDGRASP_ASSET_PATH="")


Maker = Callable[[Prepared, Path], None]


def part(_: Prepared, path: Path) -> None:
    trimesh.creation.box((0.04, 0.06, 0.12)).export(path)


def bracket(_: Prepared, path: Path) -> None:
    """An L of 60 x 60 x 20, drawn in millimetres."""
    profile = [(0, 0), (60, 0), (60, 20), (20, 20), (20, 60), (0, 60)]
    corners = [(x, y, z) for z in (0.0, 20.0) for x, y in profile]
    caps = [(0, 2, 1), (0, 3, 2), (0, 4, 3), (0, 5, 4), (6, 7, 8), (6, 8, 9), (6, 9, 10), (6, 10, 11)]
    sides = [(i, (i + 1) % 6, 6 + (i + 1) % 6) for i in range(6)]
    sides += [(i, 6 + (i + 1) % 6, 6 + i) for i in range(6)]
    trimesh.Trimesh(corners, caps + sides).export(path)


def scan(_: Prepared, path: Path, radius: float = 0.03) -> None:
    """A ball with two holes."""
    ball = trimesh.creation.icosphere(subdivisions=3, radius=radius)
    trimesh.Trimesh(ball.vertices, np.delete(ball.faces, [5, 100], axis=0), process=False).export(path)


def parts(_: Prepared, path: Path) -> None:
    """A folder of meshes in millimetres."""
    path.mkdir()
    trimesh.creation.box((20, 20, 80)).export(path / "lever.stl")
    trimesh.creation.icosphere(subdivisions=2, radius=25).export(path / "knob.ply")


def library(_: Prepared, path: Path) -> None:
    """A manifest of a mesh in the folder of meshes, and of one that is not there."""
    path.write_text("file,id,unit,density\nparts/lever.stl,acme-lever,mm,1200\nlost.stl,lost,mm,1200\n")


def shelf(prepared: Prepared, path: Path) -> None:
    """A folder of meshes in millimetres, two of them open, with the table that the page has."""
    (path / "cups").mkdir(parents=True)
    trimesh.creation.box((20, 20, 80)).export(path / "lever.stl")
    trimesh.creation.icosphere(subdivisions=2, radius=25).export(path / "knob.ply")
    scan(prepared, path / "ball.ply", radius=30)
    trimesh.creation.annulus(30, 35, 80, sections=16).export(path / "cups" / "ring.stl")
    pot = trimesh.creation.cylinder(radius=30, height=60)
    is_lid = pot.face_normals[:, 2] > 0.9
    trimesh.Trimesh(pot.vertices, pot.faces[~is_lid], process=False).export(path / "cups" / "pot.stl")
    table, _ = blocks(ROOT / "docs" / "shelf-of-meshes.md", "csv")
    (path / "shelf.csv").write_text(table.text)


def shelf_runs(prepared: Prepared, path: Path) -> None:
    asked = ("--gripper", "panda", "--protocol", "physical", "--evaluations", 20, "--skip-unusable")
    prepared("campaign", prepared.make("shelf") / "shelf.csv", *asked, "--workers", 2, "--out", path)


def my_hand(prepared: Prepared, path: Path) -> None:
    path.write_text(example_hands.JAW_TOML.replace("jaw.urdf", "my_hand.urdf"))
    prepared.make("my_hand.urdf")


def runs(prepared: Prepared, path: Path) -> None:
    prepared.make("part.stl")
    (prepared.home / "runs.toml").write_text(RUNS)
    prepared("campaign", "runs.toml", "--workers", 2, "--out", path)


def run_of(target: str, seed: int = 0) -> Maker:
    """One of these runs, as a job of its own."""

    def make(prepared: Prepared, path: Path) -> None:
        found = (prepared.make("all") / "runs").glob(f"panda-{target}-portfolio-s{seed}-*")
        shutil.copytree(next(found), path)
        for name, content in new_job(path).items():
            (path / name).write_bytes(content)
        (path / LOGS).mkdir()

    return make


def copy_of(name: str) -> Maker:
    return lambda prepared, path: shutil.copytree(prepared.make(name), path) and None


def reference(prepared: Prepared, path: Path) -> None:
    """A reference set of the cells that a run found on the cube."""
    rows = RunFolder.open(prepared.make("runs/cube")).successes().rows
    found = np.unique(cells(rows["base_to_object"][:, :3]), axis=0)
    np.savez(
        path,
        **{"rubiks_cube.cm": found.astype(np.int16), "rubiks_cube.fitness": np.full(len(found), 2, np.uint8)},
    )


def poses(prepared: Prepared, path: Path) -> None:
    poses = qdgrasp.open(prepared.make("runs/mug-s0")).grasps(min_fitness=0).poses("com")
    np.savez(path, base_position=poses[:, :3], base_quaternion_xyzw=poses[:, 3:])


def grasps_file(prepared: Prepared, path: Path) -> None:
    prepared("export", prepared.make("runs/mug-s0"), "--format", "isaac", "-o", path)


def campaigns(_: Prepared, path: Path) -> None:
    """The campaigns of deploy/, with budgets and seeds cut."""
    shutil.copytree(ROOT / "deploy", path)
    for file in (path / "campaigns").glob("*.toml"):
        text = re.sub(r"evaluations = [\d_]+", "evaluations = 20", file.read_text())
        text = re.sub(r"object = \[[^\]]*\]", 'object = ["mug"]', text)
        file.write_text(re.sub(r"seed = \[[^\]]*\]", "seed = [0]", text))


def campaign(prepared: Prepared, path: Path) -> None:
    file = prepared.make("deploy") / "campaigns" / "paper-small.toml"
    prepared("campaign", file, "--workers", 2, "--out", path)


def certificates(prepared: Prepared, path: Path) -> None:
    prepared("security", "init", path, "--host", "127.0.0.1")
    prepared("security", "add", path, "worker", "lab-7", "--host", "127.0.0.1")


NEEDED = {"library.csv": ("parts",)}
"""Files and folders that one of these names."""
MAKERS: dict[str, Maker] = {
    "all": runs,
    "S_G_panda_2f.npz": reference,
    "bracket.stl": bracket,
    "cup.stl": lambda _, path: trimesh.creation.annulus(30, 35, 80, sections=16).export(path) and None,
    "deploy": campaigns,
    "examples": lambda _, path: shutil.copytree(ROOT / "examples", path) and None,
    "gripper.xml": lambda _, path: path.write_text(example_mjcf.LINKAGE) and None,
    "grasps.yaml": grasps_file,
    "in.npz": poses,
    "library.csv": library,
    "lab-7": lambda prepared, path: shutil.copytree(prepared.make("security") / "lab-7", path) and None,
    "many.toml": lambda _, path: path.write_text(MANY) and None,
    "mugs.toml": lambda _, path: path.write_text(SPEC) and None,
    "my_hand.toml": my_hand,
    "my_hand.urdf": lambda _, path: path.write_text(example_hands.JAW_URDF) and None,
    "part.stl": part,
    "parts": parts,
    "poses.npz": poses,
    "runs/cube": run_of("rubiks_cube"),
    **dict.fromkeys(("runs/demo", "runs/mug", "runs/mugs"), copy_of("runs/mug-s0")),
    **{f"runs/mug-s{seed}": run_of("mug", seed) for seed in range(2)},
    "runs/paper-small": campaign,
    "runs/part": run_of("part"),
    "runs/shelf": shelf_runs,
    **{f"runs/part-s{seed}": run_of("part", seed) for seed in range(3)},
    "scan.ply": scan,
    "security": certificates,
    "shelf": shelf,
    "spec.toml": lambda _, path: path.write_text(SPEC) and None,
}
"""Makers of files and folders, by their names on the pages."""
BESIDE = {"my_hand.toml": ("my_hand.urdf",), "runs/part": ("part.stl",)}
"""Files that come with another one."""


def mentions(text: str, name: str) -> bool:
    """True if a line, or a script, names a file or folder."""
    return bool(re.search(rf"(?<![\w./-]){re.escape(name)}(?=$|[\s/,:\"'])", text))


def makes(text: str, name: str) -> bool:
    """True if a line writes it."""
    return bool(re.search(rf"(--out|-o|init|cp -r \S+|--picture|>>?) {re.escape(name)}(?=$|[\s/])", text))


def assumed(texts: list[str]) -> list[str]:
    """The files that lines, in their order, name before one of them has made them."""
    found = []
    for name in MAKERS.keys() - {"all"}:
        first = next((text for text in texts if mentions(text, name)), None)
        if first is not None and not makes(first, name):
            found += [name, *BESIDE.get(name, ())]
    return sorted(found)
