"""The guesses of `qdgrasp gripper new` for public hands: `python -m benchmarks.hand_guesses FOLDER...`.

Each folder holds URDFs at the paths of `HANDS`, such as a checkout of dex-urdf; pybullet_data and the asset
path are searched too. The guess gets no flag. The right values were judged by people from pictures of the
hands, as `--pictures DIR` draws them. `--evaluations 300` also runs the default search for so
many evaluations on the scans of cube and cleanser, in folders of `--runs DIR`; hands with faults are mended
for that, which takes minutes where meshes are split.
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

import qdgrasp
from qdgrasp_assets.asset_paths import asset_folders
from qdgrasp_assets.asset_report import examine_draft, examine_hand, hand_faults
from qdgrasp_assets.gripper_setup.draft import DraftOverrides, GripperDraft, draft_gripper, draft_toml
from qdgrasp_assets.gripper_setup.posture_checks import HandPostures
from qdgrasp_assets.gripper_setup.repaired_copy import repaired_copy
from qdgrasp_assets.grippers.gripper import Gripper
from qdgrasp_assets.grippers.hand_model import read_hand_model
from qdgrasp_assets.grippers.urdf import Urdf, read_urdf
from qdgrasp_coordinator.scheduler.run_plan import RUN_DEFAULTS
from qdgrasp_coordinator.storage.job_folder import JobFolder
from qdgrasp_protocol.errors import QdgraspError
from qdgrasp_protocol.keys import job_name
from qdgrasp_protocol.process import Stop, lifetime
from qdgrasp_protocol.text import join_numbers
from qdgrasp_tools.campaign.campaign_file import make_campaign
from qdgrasp_tools.campaign.campaign_folder import begin_campaign
from qdgrasp_tools.cli.options import cores
from qdgrasp_tools.cli.run_commands import run_job
from qdgrasp_tools.local.progress import progress_display
from qdgrasp_tools.local.supervisor import LocalJobConfig
from qdgrasp_tools.rendering.drawings import draw_gripper


@dataclass(frozen=True)
class KnownHand:
    """The right guess of a public hand."""

    urdf: str
    """Path below one of the folders."""
    source: str
    base: str
    axis: tuple[int, int, int]
    fingers: int
    still: str = ""
    """The joints that follow no others and do not close, between spaces."""
    backward: str = ""
    """The joints that close toward their lower limits."""


DEX, ROS, BULLET, PAPER = "dex-urdf", "ROS package", "pybullet_data", "reference data"
HANDS = {
    "LEAP": KnownHand(
        "leap_hand/leap_hand_right.urdf", DEX, "palm_lower", (0, 0, -1), 4, still="0 4 8 12 13"
    ),
    "DClaw": KnownHand(
        "dclaw_gripper/dclaw_gripper.urdf", DEX, "base_link", (1, 0, 0), 3,
        still="joint_f1_0 joint_f2_0 joint_f3_0", backward="joint_f1_1 joint_f2_2",
    ),
    "Inspire": KnownHand(
        "inspire_hand/inspire_hand_right.urdf", DEX, "hand_base_link", (-1, 0, 0), 5,
        still="thumb_proximal_yaw_joint",
    ),
    "Ability": KnownHand(
        "ability_hand/ability_hand_right.urdf", DEX, "base", (0, 1, 0), 5, still="thumb_q1"
    ),
    "Schunk SVH": KnownHand(
        "schunk_hand/schunk_svh_hand_right.urdf", DEX, "right_hand_base_link", (0, 1, 0), 5,
        still="right_hand_Thumb_Opposition right_hand_Finger_Spread",
    ),
    "Allegro": KnownHand(
        "allegro_hand/allegro_hand_right.urdf", DEX, "base_link", (1, 0, 0), 4,
        still="joint_0.0 joint_4.0 joint_8.0 joint_12.0 joint_13.0",
    ),
    "Shadow": KnownHand(
        "shadow_hand/shadow_hand_right.urdf", DEX, "palm", (0, -1, 0), 5,
        still="FFJ4 MFJ4 RFJ4 LFJ5 LFJ4 THJ5 THJ4 THJ3",
    ),
    "BarrettHand": KnownHand(
        "barrett_hand/bhand_model.urdf", DEX, "base_link", (0, 0, 1), 3,
        still="finger_1_prox_joint finger_2_prox_joint",
        backward="finger_1_med_joint finger_1_dist_joint finger_2_med_joint finger_2_dist_joint "
        "finger_3_med_joint finger_3_dist_joint",
    ),
    "Franka": KnownHand(
        "franka_panda/panda.urdf", BULLET, "panda_hand", (0, 0, 1), 2,
        backward="panda_finger_joint1",
    ),
    "xArm": KnownHand("xarm/xarm6_with_gripper.urdf", BULLET, "xarm_gripper_base_link", (0, 0, 1), 2),
    "PR2": KnownHand(
        "pr2_gripper.urdf", BULLET, "gripper_pole", (1, 0, 0), 2,
        backward="left_gripper_joint right_gripper_joint",
    ),
    "Robotiq 2F-85": KnownHand(
        "robotiq_2f_85_gripper_visualization/urdf/robotiq_2f_85.urdf", ROS, "robotiq_arg2f_base_link",
        (0, 0, 1), 2,
    ),
    "Robotiq 2F-140": KnownHand(
        "robotiq_2f_140_gripper_visualization/urdf/robotiq_2f_140.urdf", ROS, "robotiq_arg2f_base_link",
        (0, 0, 1), 2,
    ),
    "Kinova Jaco": KnownHand(
        "kinova_description/urdf/j2n6s300.urdf", ROS, "j2n6s300_link_6", (0, 0, -1), 3
    ),
    "Robotiq 2F-85 (paper)": KnownHand(
        "robotiq_2f/robotiq_2f.urdf", PAPER, "robotiq_85_base_link", (0, 0, 1), 2,
        backward="right_inner_knuckle_joint",
    ),
    "Allegro (paper)": KnownHand(
        "allegro/allegro.urdf", PAPER, "palm_link", (1, 0, 0), 4,
        still="joint_00 joint_04 joint_08 joint_12 joint_13",
    ),
}  # fmt: skip
OBJECTS = ("ycb_rubiks_cube", "ycb_bleach_cleanser")
HAND = "hand.toml"


def found_urdf(hand: KnownHand, folders: Sequence[Path]) -> Path | None:
    """The URDF of a hand in the first of the folders that has it."""
    return next((path for folder in folders if (path := folder / hand.urdf).is_file()), None)


@dataclass(frozen=True)
class Guess:
    """The guess of a hand, beside the right one."""

    hand: KnownHand
    robot: Urdf
    draft: GripperDraft
    faults: tuple[str, ...]
    """Reasons why the URDF cannot be used as it is."""

    @property
    def postures(self) -> HandPostures:
        return HandPostures(self.draft.file, read_hand_model(self.robot, self.draft.file.base_link))

    def is_closing_right(self, postures: HandPostures) -> bool:
        """Whether the right joints close, and the right way round."""
        leaders = [name for name in postures.body.moving if name not in postures.body.followers]
        tables = self.draft.file.joints
        closed = {name: tables[name].closed for name in leaders if tables[name].closed is not None}
        backward = {name for name, place in closed.items() if (place or 0.0) < tables[name].open}
        return {*leaders} - {*closed} == {*self.hand.still.split()} and backward == {
            *self.hand.backward.split()
        }

    def row(self) -> list[str]:
        """Flags, base, axis, fingers, closing joints, and the notes in words."""
        postures, file = self.postures, self.draft.file
        found = examine_draft(self.robot, self.draft, "") if not self.faults else None
        notes = [*self.draft.warnings, *(found.notes + found.faults if found else ())]
        return [
            "--mend" if self.faults else "none",
            mark(file.base_link == self.hand.base, file.base_link),
            mark(np.allclose(file.approach_axis, self.hand.axis), join_numbers(file.approach_axis)),
            mark(len(postures.closing.fingers) == self.hand.fingers, str(len(postures.closing.fingers))),
            mark(self.is_closing_right(postures), f"{len(postures.closing.closed)} joints"),
            "\n".join(note.partition(":")[0][:70] for note in notes if "rated" not in note) or "none",
        ]


def mark(is_right: bool, words: str) -> str:
    """The words, marked if they are wrong."""
    return words if is_right else f"WRONG: {words}"


def guessed(hand: KnownHand, urdf: Path) -> Guess:
    """Guess a hand from its URDF alone."""
    robot = read_urdf(urdf)
    draft = draft_gripper(robot, str(urdf.resolve()), DraftOverrides())
    return Guess(hand, robot, draft, hand_faults(robot, draft.file.base_link))


def draw(guess: Guess, name: str, folder: Path) -> None:
    """Draw the guessed hand, open and closed."""
    folder.mkdir(parents=True, exist_ok=True)
    gripper = Gripper(name, guess.robot.path.name, guess.draft.file, guess.robot)
    draw_gripper(gripper.on_carrier("paper"), folder / f"{job_name(name)}.png")


def write_usable(guess: Guess, target: Path) -> None:
    """Write the gripper's file, of a mended copy where the URDF cannot be used as it is."""
    base = guess.draft.file.base_link
    if not guess.faults:
        target.write_text(draft_toml(guess.draft, target.name))
        return
    with repaired_copy(guess.robot, base, target, lambda _: None, may_centre=True) as copy:
        draft = draft_gripper(copy.robot, copy.robot.path.name, DraftOverrides(base_link=copy.base))
        if faults := examine_hand(copy.robot, draft.file, "hand").faults:
            raise QdgraspError("; and ".join(faults))
        target.write_text(draft_toml(draft, target.name))


def tried(guess: Guess, name: str, folder: Path, number: int, stop: Stop) -> list[str]:
    """The numbers of grasps that survive all six pushes, of `number` evaluations on each object.

    The runs are a campaign of the default search and protocol; a folder that has them is resumed.
    """
    own = folder / job_name(name)
    own.mkdir(parents=True, exist_ok=True)
    if not (own / HAND).is_file():
        write_usable(guess, own / HAND)
    asked = RUN_DEFAULTS | {"gripper": str(own / HAND), "object": list(OBJECTS), "evaluations": number}
    campaign = make_campaign({"cross": [asked]}, name)
    begin_campaign(own / "runs", campaign)
    with progress_display(name, campaign.evaluations) as shown:
        run_job(JobFolder(own / "runs"), LocalJobConfig(workers=cores()), shown, stop)
    found = {run.spec.object: run.summary.robust for run in qdgrasp.open(own / "runs")}
    return [str(found[target]) for target in OBJECTS]


def main() -> int:
    parser = argparse.ArgumentParser("python -m benchmarks.hand_guesses", description=__doc__)
    parser.add_argument("folders", nargs="*", type=Path, help="where the hands' URDFs are")
    parser.add_argument("--hand", action="append", choices=HANDS, help="this one alone; may be repeated")
    parser.add_argument("--evaluations", type=int, default=0, help="of the default search, on each object")
    parser.add_argument("--runs", type=Path, default=Path("runs/hand-guesses"), help="where these runs go")
    parser.add_argument("--pictures", type=Path, help="a folder for a picture of each hand")
    asked = parser.parse_args()
    import pybullet_data

    reference = [folder / "grippers" for folder in asset_folders()]
    folders = [*asked.folders, Path(pybullet_data.getDataPath()), *reference]
    table = Table("hand", "source", "flags", "base", "approach", "fingers", "closing", "notes")
    for target in OBJECTS if asked.evaluations else ():
        table.add_column(f"hold, of {asked.evaluations} on {target}")
    with lifetime("qdgrasp hand guesses") as stop:
        for name in asked.hand or HANDS:
            urdf = found_urdf(HANDS[name], folders)
            if urdf is None:
                table.add_row(name, HANDS[name].source, "not there")
                continue
            try:
                guess = guessed(HANDS[name], urdf)
                held = tried(guess, name, asked.runs, asked.evaluations, stop) if asked.evaluations else []
                table.add_row(name, HANDS[name].source, *guess.row(), *held)
                if asked.pictures:
                    draw(guess, name, asked.pictures)
            except QdgraspError as error:
                table.add_row(name, HANDS[name].source, "", str(error)[:90])
            if stop.is_set:
                break
    Console(width=200).print(table)
    return stop.exit_code if stop.is_set else 0


if __name__ == "__main__":
    sys.exit(main())
