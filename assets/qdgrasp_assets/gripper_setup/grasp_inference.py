"""Inference from the closing motion of a hand: pinches, motors, palm and jaw."""

import numpy as np

from qdgrasp_assets.geometry.mesh import Floats
from qdgrasp_assets.gripper_setup.closing_motion import ClosingMotion
from qdgrasp_assets.grippers.hand_model import Finger, HandModel, finger_root, fixed_limbs, ray_exit

FEWEST_FINGERS = 3  # Least number of fingers of a hand with a thumb
FEWEST_OF_PALM = 4  # Least number of fingers, a thumb with them, of a hand that grasps with its palm


def pinches(closing: ClosingMotion) -> tuple[dict[str, tuple[str, ...]], str]:
    """Return the thumb, which turns unlike all others, with each finger, and all; or empty."""
    fingers, thumb = closing.fingers, thumb_number(closing)
    if thumb is None:
        return {}, ""
    joints = [_closing_joints(closing, finger) for finger in fingers]
    others = [names for number, names in enumerate(joints) if number != thumb]
    synergies = {f"thumb_{number}": joints[thumb] + names for number, names in enumerate(others, 1)}
    synergies["all"] = tuple(name for names in joints for name in names)
    reason = f"the thumb ({fingers[thumb].links[-1]}) with each other finger, and all together"
    return synergies, reason


def thumb_number(closing: ClosingMotion) -> int | None:
    """Return the number of the finger that turns unlike all others, which turn alike; or None."""
    rows = closing.rows()
    lonely = [row for row in rows if len(row) == 1]
    if len(closing.fingers) < FEWEST_FINGERS or len(rows) != 2 or len(lonely) != 1:
        return None
    return next(iter(lonely[0]))


def _closing_joints(closing: ClosingMotion, finger: Finger) -> tuple[str, ...]:
    followers = closing.body.followers
    return tuple(
        name
        for name in finger.joints
        if name in closing.closed or (name in followers and followers[name].leader in closing.closed)
    )


CLOSING_TIME = 100 / 240  # Duration of the closing of the hand in an evaluation [s] (docs/protocols.md)
STRONGEST_EFFORT = {True: 200.0, False: 2000.0}
"""Largest plausible effort: revolute joints (True) [Nm], prismatic joints (False) [N]."""
USUAL_EFFORT = {True: 20.0, False: 100.0}  # Effort of joints whose URDF states 0 or too much [Nm, N]


def joint_motor(
    body: HandModel, name: str, travel: float
) -> tuple[float | None, float | None, tuple[str, ...]]:
    """Return effort, velocity (None: the URDF's) [Nm or N, rad/s or m/s], and the reasons.

    `travel` is from open to closed [rad or m].
    """
    joint, effort, velocity, notes = body.joint(name), None, None, []
    turns = joint.kind != "prismatic"
    if not 0 < joint.effort <= STRONGEST_EFFORT[turns]:
        effort = USUAL_EFFORT[turns]
        notes.append(f"the URDF's effort would be {joint.effort:g} {'Nm' if turns else 'N'}")
    if joint.velocity * CLOSING_TIME < travel or joint.velocity <= 0:
        velocity = round(max(1.25 * travel / CLOSING_TIME, 0.1), 2)
        unit = "rad/s" if turns else "m/s"
        notes.append(f"{joint.velocity:g} {unit}, as in the URDF, would not close it in {CLOSING_TIME:.2f} s")
    return effort, velocity, tuple(notes)


HALF_CLOSED = (0.5, 0.75)  # Shares of the way from open to closed at which fingertips are averaged
CLOSING_SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)
SNAP_COSINE = np.cos(np.radians(25.0))
"""Cosine above which a direction is taken for the nearest axis of the frame."""
SHORT = 5e-3  # Least distance from roots to tips that gives a direction [m]
PAD = 0.35  # Share of the fingers' reach, from the tips on, over which inner sides face each other


def grasp_centre(closing: ClosingMotion) -> Floats:
    """Return the middle of the fingertips of the half closed hand (3,) [m], base link's frame."""
    centre: Floats = np.mean([closing.tips(share).mean(axis=0) for share in HALF_CLOSED], axis=0)
    return centre


def approach_direction(closing: ClosingMotion) -> Floats:
    """Return the unit approach direction (3,) from `closing_way`, snapped to a near axis."""
    return snap_to_axis(closing_way(closing)[0])


def closing_way(closing: ClosingMotion) -> tuple[Floats, str]:
    """Return the vector (3,) [m] along which objects come between the fingers, and its origin.

    For a hand with a thumb, it points to the side to which its other fingers bend; for others, from the
    fingers' roots to the tips of the half closed hand. Where this is too short, because joints lie in the
    middle of the fingers, or one finger is fixed: from the middle of the palm to that of the fingers.
    """
    normal = palm_normal(closing)
    if normal is not None:
        return normal, "the side of the palm to which the fingers beside the thumb bend"
    roots = np.mean([finger_root(closing.body, finger) for finger in closing.fingers], axis=0)
    outward = grasp_centre(closing) - roots
    # the links on which the fingers hang; where these have no shapes, the whole palm
    parents = {closing.body.joint(finger.joints[0]).parent for finger in closing.fingers}
    links = palm_links(closing.body)
    palm = closing.body.corners([link for link in links if link in parents] or links, {})
    if not len(palm) or (np.linalg.norm(outward) >= SHORT and not fixed_limbs(closing.body)):
        return outward, "from the fingers' roots to the fingertips of the half closed hand"
    opened = closing.posture(0.0)
    fingers = [_box_middle(closing.body.corners(finger.links, opened)) for finger in closing.fingers]
    return np.mean(fingers, axis=0) - _box_middle(palm), "from the middle of the palm to that of the fingers"


def palm_normal(closing: ClosingMotion) -> Floats | None:
    """Return the unit normal (3,) of the palm, as the fingers bend; None without a thumb.

    None also of a gripper whose two fingers oppose a third, as they stand on the rim of the palm. The normal
    is at right angles to the axes about which the fingers beside the thumb close, and to the open fingers.
    """
    thumb = thumb_number(closing)
    if thumb is None or len(closing.fingers) < FEWEST_OF_PALM:
        return None
    tips, frames = closing.tips(0.0), closing.body.robot.forward(closing.posture(0.0))
    others = [number for number in range(len(closing.fingers)) if number != thumb]
    turn = np.mean([closing.turning_axis(closing.fingers[number]) for number in others], axis=0)
    joints = [closing.body.joint(closing.fingers[number].joints[0]) for number in others]
    roots = [(frames[joint.parent] @ joint.origin)[:3, 3] for joint in joints]
    outward = np.mean([tips[number] - root for number, root in zip(others, roots, strict=True)], axis=0)
    normal = np.cross(turn, outward)
    return np.asarray(normal / np.linalg.norm(normal)) if np.linalg.norm(normal) > 0 else None


def _box_middle(corners: Floats) -> Floats:
    """Return the middle (3,) of the box around corners (n, 3)."""
    middle: Floats = (corners.min(axis=0) + corners.max(axis=0)) / 2
    return middle


def snap_to_axis(direction: Floats) -> Floats:
    """Return the unit vector of a direction (3,), or the axis next to it."""
    length = np.linalg.norm(direction)
    unit = direction / length if length else np.array([0.0, 0.0, 1.0])
    largest = int(np.abs(unit).argmax())
    axis = np.zeros(3)
    axis[largest] = np.sign(unit[largest])
    return axis if abs(unit[largest]) >= SNAP_COSINE else unit.round(3)


def palm_links(body: HandModel) -> tuple[str, ...]:
    """Return the base link and links fixed to it, those with shapes that are not fingers."""
    fixed = [body.robot.subtree(body.joint(name).child).links for name in fixed_limbs(body)]
    return tuple(
        link
        for link in body.parts
        if body.rigid_piece[link] == body.robot.root and not any(link in links for links in fixed)
    )


def palm_surface(body: HandModel, axis: Floats) -> tuple[float, bool]:
    """Return the palm's distance along the approach axis [m], and whether the axis meets it.

    Where the axis does not meet the palm, the palm's farthest point counts.
    """
    links = palm_links(body)
    found = ray_exit([part for parts in body.parts_at({}, links).values() for part in parts], axis)
    if found is not None:
        return max(found, 0.0), True
    return float((body.corners(links, {}) @ axis).max(initial=0.0)), False


def finger_reach(closing: ClosingMotion, axis: Floats) -> float:
    """Return the fingers' largest extent along the approach axis while they close [m]."""
    links = [link for finger in closing.fingers for link in finger.links]
    corners = [closing.body.corners(links, closing.posture(share)) for share in CLOSING_SHARES]
    return float((np.concatenate(corners) @ axis).max(initial=0.0))


def axis_offset(closing: ClosingMotion, axis: Floats) -> float:
    """Return the distance of the grasp centre from the approach line through the base link [m]."""
    centre = grasp_centre(closing)
    return float(np.linalg.norm(centre - (centre @ axis) * axis))


def jaw_axis(closing: ClosingMotion, axis: Floats) -> Floats | None:
    """Return the unit vector (3,) between two fingers that close, normal to the axis; else None."""
    if len(closing.fingers) != 2:
        return None
    opened, closed = closing.tips(0.0), closing.tips(0.5)
    moved = (closed - opened) - ((closed - opened) @ axis)[:, None] * axis
    if not moved[0] @ moved[1] < 0:
        return None
    between = moved[1] - moved[0]
    direction = snap_to_axis(between)
    direction = direction if abs(direction @ axis) < 1e-6 else between / np.linalg.norm(between)
    return np.abs(direction) if np.count_nonzero(direction) == 1 else direction


def jaw_opening(closing: ClosingMotion, axis: Floats, across: Floats) -> float:
    """Return the distance between the inner sides of two open fingers along `across` [m]."""
    reach = finger_reach(closing, axis)
    low = reach - PAD * (reach - palm_surface(closing.body, axis)[0])
    sides = []
    for finger in closing.fingers:
        corners = closing.body.corners(finger.links, closing.posture(0.0))
        heights = corners @ axis
        sides.append(corners[heights >= min(low, heights.max())] @ across)
    one, other = sorted(sides, key=np.mean)
    return float(max(other.min() - one.max(), 0.0))
