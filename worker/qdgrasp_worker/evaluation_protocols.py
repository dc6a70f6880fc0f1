"""Evaluation protocols as a table of frozen values, and the trials that disturb a grasp.

Common to all protocols is that there is no gravity. `paper`, `released` and `robust` on `paper` have 240
steps a second, 100 steps of closing, then two shakes with three targets of 68 steps each; figures are those
of the public code of Huber et al. 2024 (commit 0b8f8da). `physical` closes with bounded torques on a fixed
object, lets it go, and pushes it along six directions (`Physics`, docs/protocols.md); `lift` does the same on
a table, and lifts the object instead of pushing it (`Lift`).

In a trial a grasp meets a disturbed object (mixture domain randomisation, Huber et al. 2024, appendix). The
draws of a trial depend on the mixture, the grasp and the trial's number alone: a stored grasp that is scored
again has the same trials, and no other grasp has them. They are rounded for the same reason as poses
(`decoder`).
"""

import hashlib
from dataclasses import dataclass, replace
from math import pi, radians
from typing import Any

import numpy as np
from numpy.random import Generator

from qdgrasp_assets.geometry.rotation import Floats, conjugate, from_euler, multiply, rotate
from qdgrasp_assets.scene import Scene
from qdgrasp_protocol import rows
from qdgrasp_protocol.errors import UnknownName
from qdgrasp_worker.decoder import HandPose

FRICTION_DECIMALS = 6  # Decimals of frictions: rounded so, the ends of an interval stay as in the table


@dataclass(frozen=True)
class TrialSetup:
    """A grasp as it is simulated in one trial."""

    pose: HandPose
    """Pose in the CoM frame of the object as it lies in this trial."""
    frictions: tuple[float, float] | None = None
    """The object's coefficients of rolling and spinning friction; None: its own."""
    grip: float = 1.0
    """Factor of the object's lateral friction."""
    torsion: float = 1.0
    """Factor of the spinning friction in `physical`."""
    load: float = 1.0
    """Factor of the pushes of `physical`: the object's weight."""
    preload: float = 1.0
    """Factor of the force with which fingers grip in `physical`."""
    approaches: bool = False
    """The hand comes along its approach axis, and stops before a link would be inside the object."""
    clear_way: float = 0.0
    """Distance along its approach axis from which the open hand must come clear of the object [m]."""


@dataclass(frozen=True)
class Mixture:
    """Distributions that trials from 1 on are drawn from; trial 0 is the nominal one."""

    position_sigma: float
    """Standard deviation of the object's displacement along each axis [m]."""
    angle_sigma: float
    """Standard deviation of each angle of the object's turn about the fixed axes x, then y, then z [rad]."""
    rolling: tuple[float, float] | None = None
    """The interval of the object's coefficient of rolling friction; None: rolling and spinning stay."""
    spinning: tuple[float, float] | None = None
    """The interval of the object's coefficient of spinning friction."""
    grip: tuple[float, float] | None = None
    """The interval of the factor of the object's lateral friction; None: no change."""
    torsion: float = 1.0
    """Factors of every trial, as in `TrialSetup`."""
    load: float = 1.0
    preload: float = 1.0
    approaches: bool = False
    """The hand comes to its pose along its approach axis; False: it is set there."""
    seed: int = 0

    def trial(self, pose: HandPose, number: int) -> TrialSetup:
        """Draw a trial of a grasp; the object is displaced, then turned about its centre of mass."""
        random = np.random.default_rng([self.seed, *pose_seed(pose), number])
        position = random.normal(0.0, self.position_sigma, 3)
        quaternion = from_euler(random.normal(0.0, self.angle_sigma, (1, 3)))[0]
        frictions = None
        if self.rolling and self.spinning:
            frictions = draw_friction(random, self.rolling), draw_friction(random, self.spinning)
        grip = draw_friction(random, self.grip) if self.grip else 1.0
        seen, factors = pose_seen_from(position, quaternion, pose), (self.torsion, self.load, self.preload)
        return TrialSetup(seen, frictions, grip, *factors, self.approaches)


def pose_seed(pose: HandPose) -> list[int]:
    """The sha256 of a grasp as simulated: pose and initial joints in float32, synergy in int8."""
    numbers = np.array([*pose.position, *pose.quaternion, *pose.joints], dtype="<f4")
    digest = hashlib.sha256(numbers.tobytes() + np.int8(pose.synergy).tobytes()).digest()
    words: list[int] = np.frombuffer(digest, dtype="<u4").tolist()
    return words


def pose_seen_from(position: Floats, quaternion: Floats, pose: HandPose) -> HandPose:
    """A pose in the frame of an object at `position` (3,) [m], turned by `quaternion` (4,).

    Only hand and object are in the world, so that displacing either is the same. The object stays at the
    origin: there Bullet keeps its pose to the bit, while it rounds other rotations at every step.
    """
    back = conjugate(quaternion)
    offset = rotate(back, np.array(pose.position) - position)
    return replace(
        pose,
        position=offset.astype(np.float32).tolist(),
        quaternion=multiply(back, np.array(pose.quaternion)).astype(np.float32).tolist(),
    )


def draw_friction(random: Generator, interval: tuple[float, float]) -> float:
    """Draw a coefficient of friction."""
    return round(random.uniform(*interval), FRICTION_DECIMALS)


CLOSING_STEPS = 100
TARGET_STEPS = 68  # Duration of each target of a shake


@dataclass(frozen=True)
class Shake:
    """A motion of one carrier joint: to +amplitude, to -amplitude and back to zero."""

    joint: str
    """"z" or "x": the carrier joint that is marked with it."""
    amplitude: float
    """Amplitude [m or rad]. The translation is limited by its force: from 0 to 0.206 m and back to 0."""
    position_gain: float
    """Bullet's kp."""
    velocity_gain: float
    """Bullet's kd."""

    @property
    def targets(self) -> tuple[float, float, float]:
        """The positions that the joint is driven to, in order."""
        return self.amplitude, -self.amplitude, 0.0


PUSHES = (
    (1.0, 0.0, 0.0),
    (-1.0, 0.0, 0.0),
    (0.0, 1.0, 0.0),
    (0.0, -1.0, 0.0),
    (0.0, 0.0, 1.0),
    (0.0, 0.0, -1.0),
)
"""Directions of the pushes, hand frame."""


@dataclass(frozen=True)
class Physics:
    """The settings of `physical`."""

    time_step: float = 1 / 480
    """Length of a step [s]."""
    iterations: int = 50
    """Iterations of the solver in each step."""
    jaw_iterations: int = 150
    """Iterations for a jaw: with fewer its object turns slowly between two fingers that press hard."""
    recovery: float = 0.2
    """Share of a penetration that the solver corrects in a step."""
    breaking_threshold: float = 0.002
    """Distance at which contacts begin, as a share of a shape's size; a tenth of Bullet's, and cheaper."""
    rolling: float = 1e-4
    """The pair's coefficient of rolling friction [m]."""
    spinning: float = 0.005
    """The pair's coefficient of spinning friction [m]: the radius of a fingertip's patch."""
    haste: float = 2.0
    """Factor of all closing speeds; with a fixed object it saves steps and changes little."""
    slack: float = 0.3
    """Time to close beyond what the joints' ranges take at closing speed [s]."""
    settling: float = 0.3
    """The most time in which a released object comes to rest [s]."""
    damping: float = 100.0
    """Rate at which the velocity of the released object decays meanwhile [1/s]."""
    weight: float = 9.81
    """Force of a push for each kilogram of the object [m/s2]: its own weight."""
    push_time: float = 0.15
    """Duration of each push [s]; an object that is not held moves 11 cm."""
    lost_distance: float = 0.05
    """Distance beyond which an object that is pushed is lost [m]."""
    lost_angle: float = radians(15.0)
    """Angle beyond which an object that is pushed is lost [rad]."""
    look_every: int = 8
    """Steps between two checks whether all rests, or the object is lost."""

    def steps(self, seconds: float) -> int:
        """The number of steps in a time [s]."""
        return round(seconds / self.time_step)


COARSE: dict[str, Any] = {"time_step": 1 / 300, "look_every": 5}
"""Settings with which MuJoCo has the same verdicts in two thirds of the time (docs/engines.md)."""


@dataclass(frozen=True)
class Lift:
    """The settings of `lift`, which takes an object off a table."""

    height: float = 0.1
    """Height of the lift [m]; an object that stays behind is lost by then (`Physics.lost_distance`)."""
    speed: float = 0.2
    """Speed of the lift [m/s]: that of an arm with a load in its hand."""
    acceleration: float = 2.0
    """Acceleration up to that speed [m/s2]; it adds a fifth to the object's weight meanwhile."""
    hold: float = 0.5
    """Time for which it holds the object at that height [s]."""

    @property
    def rise(self) -> float:
        """Time of acceleration [s]."""
        return self.speed / self.acceleration

    @property
    def seconds(self) -> float:
        """Time of the whole lift [s]."""
        return self.rise / 2 + self.height / self.speed + self.hold

    def way(self, seconds: float) -> float:
        """Height of the hand above its first place, after `seconds` [m]."""
        if seconds < self.rise:
            return self.acceleration * seconds**2 / 2
        return min(self.height, self.speed * (seconds - self.rise / 2))


@dataclass(frozen=True)
class EvaluationProtocol:
    """The settings in which the protocols differ."""

    name: str
    shakes: tuple[Shake, ...]
    contact_check_steps: int
    """Steps of a shake between two checks of contact with the object; divides TARGET_STEPS."""
    ends_when_lost: bool
    """The shakes end when one of them loses the object."""
    free_joints_first: bool
    """Free joints take their places before the test for overlap, not after it."""
    mixture: Mixture | None = None
    """Distributions that trials from 1 on are drawn from; None: there are no trials."""
    hard: Mixture | None = None
    """Distributions of the trials after the hundredth; None: there are none."""
    physics: Physics | None = None
    """The settings of `physical`, in which nothing is shaken; None: the hand closes and shakes as above."""
    lift: Lift | None = None
    """Lift of the object off a table, instead of all other disturbances; None: there is none."""
    approach_distance: float = 0.0
    """Distance from which the open hand must come to its nominal pose clear of the object [m]."""

    @property
    def trials(self) -> int:
        """Number of trials besides trial 0, the nominal one."""
        return rows.trial_count(self.name) + (rows.HARD_TRIALS if self.hard else 0)

    @property
    def disturbances(self) -> int:
        """Number of disturbances that a grasp meets: shakes, pushes or one lift."""
        return len(self.shakes) or (1 if self.lift else len(PUSHES))

    def trial(self, pose: HandPose, number: int) -> TrialSetup:
        """A grasp in one of its trials; 0 is the grasp as it was commanded."""
        mixture = self.hard if number > rows.TRIALS else self.mixture
        if mixture and number:
            return mixture.trial(pose, number)
        return TrialSetup(pose, clear_way=self.approach_distance)


SHAKES = (
    Shake("z", 0.2, position_gain=2.82, velocity_gain=64.0),
    Shake("x", pi / 4, position_gain=0.05, velocity_gain=1.0),
)
RELEASED = EvaluationProtocol(
    "released", SHAKES, contact_check_steps=TARGET_STEPS, ends_when_lost=False, free_joints_first=False
)
PAPER = EvaluationProtocol(
    "paper", SHAKES, contact_check_steps=1, ends_when_lost=True, free_joints_first=True
)
MIXTURE = Mixture(position_sigma=0.005, angle_sigma=radians(30.0), rolling=(0.01, 0.04), spinning=(0.1, 0.4))
ROBUST = replace(PAPER, name="robust", mixture=MIXTURE)
PHYSICAL = EvaluationProtocol(
    "physical", (), contact_check_steps=1, ends_when_lost=True, free_joints_first=True, physics=Physics()
)
LIFT = replace(PHYSICAL, name=rows.LIFT, lift=Lift())
SMALL_MIXTURE = Mixture(position_sigma=0.003, angle_sigma=radians(3.0), grip=(0.6, 1.4), approaches=True)
HARD_MIXTURE = replace(SMALL_MIXTURE, grip=(0.3, 0.7), torsion=0.5, load=2.0, preload=0.7)
PROTOCOLS = {protocol.name: protocol for protocol in (PAPER, RELEASED, ROBUST, PHYSICAL, LIFT)}
ROBUST_BY_BASE = {"physical": replace(PHYSICAL, name=ROBUST.name, mixture=SMALL_MIXTURE, hard=HARD_MIXTURE)}


def scene_protocol(scene: Scene) -> EvaluationProtocol:
    """The protocol of a scene, with its approach; UnknownName if it does not exist."""
    kind, name, known = "protocol", scene.protocol, PROTOCOLS
    if name == ROBUST.name:
        kind, name, known = "base", scene.base, {PAPER.name: ROBUST} | ROBUST_BY_BASE
    if name not in known:
        raise UnknownName(kind, name, known)
    return replace(known[name], approach_distance=scene.approach_distance)
