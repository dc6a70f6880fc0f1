"""The ladder of outcomes, climbed in a world whose contacts are written down."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pytest

from qdgrasp_protocol.rows import NO_SYNERGY, Outcome
from qdgrasp_worker.decoder import HandPose
from qdgrasp_worker.episode import EpisodeResult, ShakenEpisode
from qdgrasp_worker.evaluation_protocols import (
    CLOSING_STEPS,
    PAPER,
    PROTOCOLS,
    RELEASED,
    TARGET_STEPS,
    TrialSetup,
)
from qdgrasp_worker.world import Contact

PALM, FINGER, OTHER_FINGER = 5, 6, 7
POSE = HandPose([0.0, 0.0, 0.2], [0.0, 0.0, 0.0, 1.0], [0.04, 0.03], NO_SYNERGY)
FRICTIONS = 0.03, 0.2
SHAKE_STEPS = 3 * TARGET_STEPS
SHAKING = [protocol for protocol in PROTOCOLS.values() if protocol.shakes]
SHAKE_A = CLOSING_STEPS
SHAKE_B = CLOSING_STEPS + SHAKE_STEPS
END = CLOSING_STEPS + 2 * SHAKE_STEPS


@dataclass
class WrittenWorld:
    """A world with given contacts after each number of steps, which records its commands."""

    touching: Callable[[int], list[Contact]]
    steps: int = 0
    told: list[object] = field(default_factory=list)
    finger_links: frozenset[int] = frozenset({FINGER, OTHER_FINGER})
    opened: tuple[float, ...] = (0.04, 0.04)

    def reset(self, trial, posture):
        self.told.append(("reset", list(posture), trial.frictions))

    def set_fingers(self, posture):
        self.told.append(("fingers", list(posture)))

    def steps_of_closing(self, synergy):
        self.told.append(("close", synergy))
        yield from range(CLOSING_STEPS)

    def shake_to(self, target, shake):
        self.told.append((shake.joint, round(target, 3), self.steps))

    def step(self):
        self.steps += 1

    def contacts(self):
        self.told.append("looked")
        return self.touching(self.steps)

    def is_touching(self):
        return bool(self.touching(self.steps))

    def finger_positions(self):
        return [0.01, 0.02]

    def hand_pose(self):
        return np.array(POSE.position), -np.array(POSE.quaternion)

    def contact_forces(self):
        return []


def during(first: int, last: int, *contacts: Contact) -> Callable[[int], list[Contact]]:
    return lambda step: list(contacts) if first <= step <= last else []


def run(world: WrittenWorld, protocol=PAPER) -> EpisodeResult:
    return ShakenEpisode(world, protocol).run(TrialSetup(POSE, FRICTIONS))


GRIP = (Contact(FINGER, -0.002), Contact(OTHER_FINGER, -0.003))
PALM_ALONE = (Contact(PALM, 0.0),)


@pytest.mark.parametrize("protocol", SHAKING, ids=lambda protocol: protocol.name)
class TestEveryProtocolThatShakes:
    def test_a_hand_inside_the_object_overlaps_and_nothing_moves(self, protocol):
        world = WrittenWorld(during(0, END, Contact(PALM, -1e-6)))
        assert run(world, protocol) == EpisodeResult(Outcome.OVERLAP, POSE.joints)
        assert world.steps == 0

    @pytest.mark.parametrize(
        ("touching", "outcome"),
        [
            (during(0, 0, Contact(PALM, 1e-6)), Outcome.MISSED),  # at a distance
            (during(1, END, Contact(PALM, -0.001)), Outcome.MISSED),
            (during(CLOSING_STEPS, CLOSING_STEPS, Contact(FINGER, -0.001)), Outcome.DROPPED),
            (during(20, SHAKE_B, *GRIP), Outcome.SHAKEN),
            (lambda step: during(20, END, *(GRIP if step <= SHAKE_A else PALM_ALONE))(step), Outcome.HELD),
        ],
    )
    def test_what_touches_and_when_says_the_outcome(self, protocol, touching, outcome):
        assert run(WrittenWorld(touching), protocol).outcome == outcome

    @pytest.mark.parametrize("step", [0, 1, 50, CLOSING_STEPS - 1])
    def test_a_finger_that_touches_at_any_step_of_closing_but_not_after_it_brushed(self, protocol, step):
        world = WrittenWorld(during(step, step, Contact(FINGER, 0.001)))
        assert run(world, protocol) == EpisodeResult(Outcome.BRUSHED, POSE.joints, steps=CLOSING_STEPS)

    def test_an_object_held_through_both_shakes_is_held(self, protocol):
        verdict = run(WrittenWorld(during(20, END, *GRIP)), protocol)
        settled = [*POSE.position, *POSE.quaternion]  # the sign is that of the commanded quaternion
        expected = EpisodeResult(Outcome.HELD, [0.01, 0.02], 2, 0.003, 2, settled, [], steps=END)
        assert verdict == expected

    def test_a_finger_link_counts_once_however_many_contacts_it_has(self, protocol):
        world = WrittenWorld(during(20, END, *GRIP, *GRIP, Contact(PALM, -0.01)))
        verdict = run(world, protocol)
        assert (verdict.finger_links, verdict.penetration) == (2, 0.01)


def gap(first: int, last: int) -> Callable[[int], list[Contact]]:
    """A grip that is lost from step `first` to `last`."""
    return lambda step: [] if step < 20 or first <= step <= last else list(GRIP)


class TestPaper:
    def test_contact_lost_for_a_single_step_ends_the_shake_and_spares_the_next(self):
        world = WrittenWorld(gap(SHAKE_A + 5, SHAKE_A + 5))
        assert run(world).outcome == Outcome.DROPPED
        assert world.steps == SHAKE_A + 5


class TestReleased:
    def test_contact_lost_between_the_ends_of_targets_goes_unseen(self):
        world = WrittenWorld(gap(SHAKE_A + 1, SHAKE_A + TARGET_STEPS - 1))
        assert run(world, RELEASED).outcome == Outcome.HELD

    def test_contact_lost_at_the_end_of_a_target_ends_the_shake_but_not_the_next_one(self):
        lost = SHAKE_A + TARGET_STEPS
        world = WrittenWorld(gap(lost, lost))
        assert run(world, RELEASED).outcome == Outcome.SHAKEN
        assert [told for told in world.told if told[0] == "z"] == [("z", 0.2, SHAKE_A)]
        assert ("x", 0.785, lost) in world.told
        assert world.steps == lost + SHAKE_STEPS
