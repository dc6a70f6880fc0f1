"""The evaluation protocols: one table of frozen values (docs/protocols.md).

Common to all of them: no gravity, 240 steps a second, 100 steps of closing, then two shakes with three
targets of 68 steps each. Figures are those of the public code of Huber et al. 2024 (commit 0b8f8da).
"""

from dataclasses import dataclass, replace
from math import pi, radians

from qdgrasp_protocol import trials
from qdgrasp_worker.grasp import Pose
from qdgrasp_worker.trial import Mixture, Trial

CLOSING_STEPS = 100
TARGET_STEPS = 68
"""How long each target of a shake is pursued."""


@dataclass(frozen=True)
class Shake:
    """A joint of the carrier is sent to +amplitude, to -amplitude and back to zero."""

    joint: str
    """"z" or "x": the carrier joint that is marked with it."""
    amplitude: float
    """[m or rad]. The translation is limited by its force: it goes from 0 to 0.206 m and back to 0."""
    position_gain: float
    """Bullet's kp."""
    velocity_gain: float
    """Bullet's kd."""

    @property
    def targets(self) -> tuple[float, float, float]:
        """Where the joint is sent, one after the other."""
        return self.amplitude, -self.amplitude, 0.0


@dataclass(frozen=True)
class EvaluationProtocol:
    """What an evaluation does where the protocols differ."""

    name: str
    shakes: tuple[Shake, ...]
    look_every: int
    """Steps of a shake between two looks whether the hand still touches the object; divides TARGET_STEPS."""
    ends_when_lost: bool
    """Whether an object that one shake lost is spared the next."""
    free_joints_first: bool
    """Whether the free joints take their places before the test for overlap, or after it."""
    mixture: Mixture | None = None
    """What trials from 1 on are drawn from; None: there are none."""

    @property
    def trials(self) -> int:
        """How many trials there are besides trial 0, the nominal one."""
        return trials.trials(self.name)

    def trial(self, pose: Pose, number: int) -> Trial:
        """A grasp in one of its trials; 0 is the grasp as it was commanded."""
        return self.mixture.trial(pose, number) if self.mixture and number else Trial(pose)


SHAKES = (
    Shake("z", 0.2, position_gain=2.82, velocity_gain=64.0),
    Shake("x", pi / 4, position_gain=0.05, velocity_gain=1.0),
)
RELEASED = EvaluationProtocol(
    "released", SHAKES, look_every=TARGET_STEPS, ends_when_lost=False, free_joints_first=False
)
PAPER = EvaluationProtocol("paper", SHAKES, look_every=1, ends_when_lost=True, free_joints_first=True)
MIXTURE = Mixture(position_sigma=0.005, angle_sigma=radians(30.0), rolling=(0.01, 0.04), spinning=(0.1, 0.4))
ROBUST = replace(PAPER, name="robust", mixture=MIXTURE)
PROTOCOLS = {protocol.name: protocol for protocol in (PAPER, RELEASED, ROBUST)}
