"""The portfolio: what emitters propose, what is worth a try, and who asks how much."""

import hashlib

import numpy as np
import pytest
from tests.coordinator.search import synthetic_scene
from tests.coordinator.search.synthetic_scene import covered, evaluate, play, space

from qdgrasp_assets.geometry.object_surface import ObjectSurface
from qdgrasp_assets.geometry.rotation import dot, rotate
from qdgrasp_coordinator.metrics.cells import cells, orientations
from qdgrasp_coordinator.metrics.contact_niches import contact_niches
from qdgrasp_coordinator.search.emitters import NeighbourEmitter, RotationEmitter, SurfaceEmitter
from qdgrasp_coordinator.search.grasp_map import MOST_TRIES, NOTHING_NEW, Explored, GraspMap, Proposals
from qdgrasp_coordinator.search.portfolio import EmitterBandit, Portfolio
from qdgrasp_coordinator.search.registry import METHODS
from qdgrasp_protocol.rows import Outcome
from qdgrasp_protocol.spec import RunSpec


def spec(**values) -> RunSpec:
    return RunSpec(gripper="hand", object="thing", population=50, aim_for="hold", **values)


def draws(n: int = 50, hand: str = "panda", prior: str = "approach") -> Proposals:
    scene = space(hand).scene
    return SurfaceEmitter(scene, prior, ObjectSurface(scene)).propose(n, np.random.default_rng(1))


def explored(hand: str = "panda", **values) -> tuple[GraspMap, Proposals]:
    """A map that was told the results of some draws, and the grasps that hold."""
    known, drawn = GraspMap(spec(**values), space(hand)), draws(hand=hand)
    rows = evaluate(space(hand), 0, drawn.genomes)
    known.count_tries(drawn)
    known.learn(rows, drawn.middles)
    return known, drawn[np.flatnonzero(rows["outcome"] == Outcome.HELD)]


class TestEmitters:
    @pytest.mark.parametrize(("hand", "prior"), [("panda", "antipodal"), ("barrett", "approach")])
    def test_surface_draws_look_at_the_middle_of_their_contacts(self, hand, prior) -> None:
        drawn, gripper = draws(hand=hand, prior=prior), space(hand).scene.gripper
        approach = rotate(drawn.genomes[:, 3:7].astype(float), np.array([gripper.approach_axis] * len(drawn)))
        ways = drawn.middles - drawn.genomes[:, :3]
        assert np.allclose(dot(ways, approach), np.linalg.norm(ways, axis=1), atol=1e-4)
        assert np.allclose(np.linalg.norm(drawn.genomes[:, 3:7], axis=1), 1.0, atol=1e-5)

    def test_a_turned_grasp_keeps_its_distance_from_its_contacts_and_their_line(self) -> None:
        known, _ = explored()
        turned = RotationEmitter(known).propose(20, np.random.default_rng(2))
        for pose, middle in zip(turned.genomes, turned.middles, strict=True):
            parents = known.genomes[np.abs(known.middles - middle).max(axis=1) < 1e-9]
            ways = np.linalg.norm(parents[:, :3] - middle, axis=1)
            assert np.isclose(ways, np.linalg.norm(pose[:3] - middle), atol=1e-5).any()

    @pytest.mark.parametrize("hand", ["panda", "barrett"])
    def test_a_neighbour_stands_in_an_open_cell_beside_one_that_holds(self, hand) -> None:
        known, held = explored(hand)
        moved = NeighbourEmitter(space(hand).scene, known).propose(30, np.random.default_rng(3))
        assert len(moved)
        of_held, of_moved = cells(held.genomes[:, :3]), cells(moved.genomes[:, :3])
        assert (np.abs(of_held[:, None] - of_moved).max(axis=2).min(axis=0) == 1).all()
        posture = moved.genomes[:, 7:]
        bounds = [sorted((gene.low, gene.high)) for gene in space(hand).layout.genes[7:]]
        assert all(
            low - 1e-6 <= value <= high + 1e-6
            for row in posture
            for value, (low, high) in zip(row, bounds, strict=True)
        )

    def test_nothing_is_proposed_while_nothing_holds(self) -> None:
        known = GraspMap(spec(), space())
        for emitter in (RotationEmitter(known), NeighbourEmitter(space().scene, known)):
            assert not len(emitter.propose(10, np.random.default_rng(0)))


class TestWorthATry:
    def test_a_cell_is_closed_once_a_grasp_holds_there(self) -> None:
        known, held = explored()
        assert (known.levels(held) >= 2).all()

    def test_an_orientation_is_open_in_a_cell_that_holds_another(self) -> None:
        known, held = explored(diversity="orientation")
        assert (known.levels(held) == NOTHING_NEW).sum() == len(held)
        poses = held.genomes.copy()
        poses[:, 3:7] = poses[:, [4, 3, 6, 5]] * [1, -1, 1, -1]  # half a turn about an axis
        assert (orientations(poses[:, 3:7]) != orientations(held.genomes[:, 3:7])).any()
        assert (known.levels(Proposals(poses, held.middles)) < NOTHING_NEW).any()

    @pytest.mark.parametrize("diversity", ["position", "orientation", "contact"])
    def test_what_was_tried_often_is_closed(self, diversity) -> None:
        known, drawn = GraspMap(spec(diversity=diversity), space()), draws(5)
        for _ in range(MOST_TRIES):
            assert (known.levels(drawn) < NOTHING_NEW).any()
            known.count_tries(drawn)
        assert (known.levels(drawn) == NOTHING_NEW).all()

    def test_gains_are_those_of_the_first_grasps_of_cells_and_contact_niches(self) -> None:
        known, drawn = GraspMap(spec(), space()), draws()
        rows = evaluate(space(), 0, drawn.genomes)
        gains, again = known.learn(rows, drawn.middles), known.learn(rows, drawn.middles)
        assert (gains[rows["outcome"] < Outcome.HELD] == 0).all()
        held = rows[rows["outcome"] == Outcome.HELD]
        assert np.isclose(
            gains[gains > 0].sum(),
            covered(rows) / max(covered(rows), 50)
            + len(np.unique(contact_niches(held))) / max(len(known.contacts), 20),
        )
        assert len(known) == covered(rows)
        assert not again.any()

    def test_a_grip_that_held_promises_more_than_one_unknown_and_that_than_one_that_failed(self) -> None:
        grips = Explored()
        grips.count_tries(np.array([1, 1, 2, 2]))
        grips.hold(np.array([1]))
        (held, failed, unknown), _ = grips.chances(np.array([1, 2, 3]))
        assert 1.0 > held > unknown > failed > 0.0

    def test_a_grip_whose_grasps_found_nothing_new_promises_less_of_it_than_one_unknown(self) -> None:
        grips = Explored()
        grips.count_tries(np.repeat([1, 3], [60, 40]))
        grips.hold(np.ones(60, np.int64))
        grips.found[1] += 1
        (known, unknown), (known_finds, unknown_finds) = grips.chances(np.array([1, 2]))
        assert known > unknown
        assert known_finds < unknown_finds


class TestBandit:
    def test_what_gains_more_for_its_steps_asks_more_and_all_ask_something(self) -> None:
        bandit, emitters = EmitterBandit(3), np.repeat([0, 1, 2], 100)
        bandit.learn(emitters, np.repeat([1.0, 1.0, 0.0], 100), np.repeat([100.0, 200.0, 50.0], 100))
        shares = bandit.shares()
        assert shares[0] > shares[1] > 0.0
        assert shares[2] > 0.0
        assert np.isclose(shares.sum(), 1.0)

    def test_an_emitter_that_was_hardly_asked_is_tried(self) -> None:
        bandit = EmitterBandit(2)
        assert np.allclose(bandit.shares(), 0.5)
        bandit.learn(np.zeros(500, np.intp), np.ones(500), np.full(500, 100.0))
        hardly_asked = bandit.shares()[1]
        bandit.learn(np.ones(500, np.intp), np.zeros(500), np.full(500, 100.0))
        assert 0.0 < bandit.shares()[1] < hardly_asked < 0.5


def test_it_fills_cells_and_ends_at_those_that_it_can_fill() -> None:
    rows = play(Portfolio(spec(), space()), space(), 40)
    few = play(METHODS["antipodal_cells"].build(spec(), space()), space(), 40)
    assert min(covered(rows), covered(few)) > 500
    held = rows[rows["outcome"] == Outcome.HELD]
    assert covered(rows) > 0.7 * len(held)
    assert len(np.unique(contact_niches(held))) > 20


@pytest.mark.parametrize("diversity", ["orientation", "contact"])
def test_diversity_is_found_where_it_is_asked_for(diversity) -> None:
    def found(rows) -> int:
        held = rows[rows["outcome"] == Outcome.HELD]
        bins = orientations(held["base_to_object"][:, 3:])
        keys = np.column_stack([cells(held["descriptor"][:, :3]), bins])
        return len(np.unique(contact_niches(held) if diversity == "contact" else keys, axis=0))

    asked = play(Portfolio(spec(diversity=diversity), space()), space(), 30)
    usual = play(Portfolio(spec(), space()), space(), 30)
    assert found(asked) >= 0.95 * found(usual)


def digest() -> str:
    """Of what is asked in a few generations, also in a fresh process."""
    rows = play(Portfolio(spec(), synthetic_scene.space()), synthetic_scene.space(), 6)
    return hashlib.sha256(rows["genome"].tobytes()).hexdigest()
