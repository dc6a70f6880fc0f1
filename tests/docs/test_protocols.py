"""docs/protocols.md: its numbers of `paper` are those of the code."""

import re
import tomllib
from math import degrees, pi

import pybullet
import pytest
from tests.docs.pages import ROOT
from tests.worker.test_world import TABLE

from qdgrasp_assets.catalog import ROLLING_FRICTION, SPINNING_FRICTION, find_gripper
from qdgrasp_assets.geometry.surface_points import POINTS_PER_METRE
from qdgrasp_assets.grippers.gripper import CARRIED_MASS, ROTATION_X, SHAKE_FORCES, TRANSLATION_Z, TWO_AXES
from qdgrasp_assets.object_model import LATERAL_FRICTION
from qdgrasp_assets.stand_ins import STAND_INS
from qdgrasp_protocol.rows import SHAKES as NUMBER_OF_SHAKES
from qdgrasp_protocol.rows import TRIALS, Outcome
from qdgrasp_worker.engines.bullet import Bullet
from qdgrasp_worker.engines.bullet_world import Motor
from qdgrasp_worker.evaluation_protocols import CLOSING_STEPS, MIXTURE, PAPER, ROBUST, SHAKES, TARGET_STEPS
from qdgrasp_worker.world import HAND_FRICTION

PAGE = (ROOT / "docs/protocols.md").read_text(encoding="utf-8")
SECTION = PAGE.partition("## Where `paper` is not the text of the paper")[2].partition("\n## ")[0]
ROWS = {place.strip(): rest for place, rest in re.findall(r"^\| ([^|]+) \|(.*)\|$", SECTION, re.MULTILINE)}
Z, X = SHAKES
HANDS = ROOT / "assets/qdgrasp_assets/grippers"
ALLEGRO, SHADOW = (tomllib.loads((HANDS / f"{name}.toml").read_text()) for name in ("allegro", "shadow"))
THUMB = SHADOW["joints"]
BARRETT = find_gripper("barrett").file.free_joints


def metres(targets: tuple[float, ...]) -> str:
    first, second, last = targets
    return f"targets {first:+g}, {second:+g} and {last:g}"


def angles(targets: tuple[float, ...]) -> str:
    return metres(tuple(map(degrees, targets))).replace("45", "45\u00b0")


def limits_of_allegro() -> list[float]:
    robot = (HANDS / "allegro.urdf").read_text()
    return sorted(-float(low) for low in re.findall(r'<limit lower="(-[\d.]+)"', robot))


QUOTED = [
    ("axes of the shakes", f"translation along {Z.joint} and a rotation about {X.joint}"),
    ("retrials", f"{TRIALS} for a grasp"),
    ("noise of retrials", f"{1e3 * MIXTURE.position_sigma:g} mm along each axis"),
    ("noise of retrials", f"{degrees(MIXTURE.angle_sigma):.0f}\u00b0 for each of three angles"),
    ("fingers at first", "{:g} to {:g} rad".format(*limits_of_allegro()[:: len(limits_of_allegro()) - 1])),
    ("thumb", "fixed at 1.396 rad"),
    ("thumb", f"THJ4 begins at {THUMB['THJ4']['open']:g} rad and goes to {THUMB['THJ4']['closed']:g} rad"),
    ("thumb", f"THJ5 closes from {THUMB['THJ5']['open']:g} to {THUMB['THJ5']['closed']:g} rad"),
    ("object", f"the banana {STAND_INS['banana'].mass:g} kg"),
    ("friction of a pair", f"lateral {LATERAL_FRICTION} of the object times {HAND_FRICTION} of the hand"),
    ("friction of a pair", f"{LATERAL_FRICTION * HAND_FRICTION:g}. Rolling {ROLLING_FRICTION}"),
    ("friction of a pair", f"spinning {SPINNING_FRICTION}"),
    ("friction of a pair", f"{ROLLING_FRICTION * HAND_FRICTION:g} and {SPINNING_FRICTION * HAND_FRICTION:g}"),
    ("closing", f"{CLOSING_STEPS} steps"),
    ("closing", f"gain {Motor(1.0, 1.0).position_gain:g}"),
    ("synergies", f"each 0 to {BARRETT['bh_j11_joint'].low:g} rad"),
    ("translation", f"{metres(Z.targets)} m, {TARGET_STEPS} steps each, {SHAKE_FORCES['z']:g} N"),
    ("translation", f"from 0 to {max(TABLE['z']):g} m"),
    ("rotation", f"{angles(X.targets)}, {TARGET_STEPS} steps each"),
    ("rotation", f"{max(TABLE['x']):g} and to {min(TABLE['x']):g} rad"),
    ("carrier", f"{CARRIED_MASS:g} kg between world and hand"),
    ("friction of retrials", "rolling U({:g}, {:g})".format(*MIXTURE.rolling or ())),
    ("friction of retrials", "spinning U({:g}, {:g})".format(*MIXTURE.spinning or ())),
    ("surface points", f"{POINTS_PER_METRE} for each metre"),
]


@pytest.mark.parametrize(("place", "words"), QUOTED)
def test_a_number_of_the_page_is_the_code_s(place: str, words: str) -> None:
    assert words in ROWS[place]


def test_steps_solver_and_friction_of_a_hand_are_bullet_s_own() -> None:
    bullet = Bullet()
    values = pybullet.getPhysicsEngineParameters(physicsClientId=bullet.client)
    body = pybullet.createMultiBody(physicsClientId=bullet.client)
    friction = pybullet.getDynamicsInfo(body, -1, physicsClientId=bullet.client)[1]
    bullet.close()
    steps = f"steps of 1/{1 / values['fixedTimeStep']:.0f} s, {values['numSolverIterations']} iterations"
    assert steps in ROWS["engine"]
    assert {values[f"gravityAcceleration{axis}"] for axis in "XYZ"} == {0.0}
    assert friction == HAND_FRICTION


def test_shakes_go_along_and_about_the_hand_s_own_axes() -> None:
    assert TWO_AXES == (TRANSLATION_Z, ROTATION_X)
    assert (TRANSLATION_Z.axis, ROTATION_X.axis) == ("0 0 1", "1 0 0")
    approach = {name: find_gripper(name).file.approach_axis for name in ("panda", "barrett", "robotiq_2f")}
    assert {tuple(axis) for axis in approach.values()} == {(0, 0, 1)}
    assert all(hand["approach_axis"][2] == 0 for hand in (ALLEGRO, SHADOW))


def test_shakes_end_with_a_lost_object_and_contact_is_looked_for_at_every_step() -> None:
    assert PAPER.ends_when_lost
    assert PAPER.contact_check_steps == 1
    assert PAPER.free_joints_first
    assert (len(PAPER.shakes), ROBUST.shakes) == (NUMBER_OF_SHAKES, PAPER.shakes)
    assert Outcome.DROPPED.is_success


def test_the_thumb_of_the_shadow_closes_as_the_page_says() -> None:
    synergies = {synergy["name"]: set(synergy["joints"]) for synergy in SHADOW["synergies"]}
    assert all("THJ5" in joints for joints in synergies.values())
    assert [name for name, joints in synergies.items() if "THJ4" in joints] == ["all"]
    assert {joint["open"] for joint in ALLEGRO["joints"].values()} == {0.0}
    assert "at opposition 1.396" in (HANDS / "allegro.urdf").read_text()
    assert X.amplitude == pi / 4
