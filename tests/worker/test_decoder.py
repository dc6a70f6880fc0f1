"""Laws of decoding: the cone, postures, and rounding, for every prior."""

import numpy as np
import pytest
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation
from tests.common import with_gripper
from tests.worker.genomes import draw

from qdgrasp_assets.geometry.object_surface import ObjectSurface
from qdgrasp_assets.priors import PRIORS
from qdgrasp_assets.scene import FreeJoint, Synergy
from qdgrasp_protocol.errors import UnknownName
from qdgrasp_protocol.rows import NO_SYNERGY
from qdgrasp_worker.decoder import Decoder

CONES = ("approach", "contact")
ROUNDING = 2e-7
"""Effect of float32 on a length of half a metre and on a unit vector."""
FINGERS = ("panda_finger_joint1", "panda_finger_joint2")


def decoder_of(scene, prior):
    return Decoder(scene, prior, ObjectSurface(scene))


def values_of(decoder, genomes):
    return dict(zip(decoder.layout.names, decoder.layout.values(genomes).T, strict=True))


@pytest.mark.parametrize("prior", PRIORS)
class TestEveryPrior:
    """The contract of a prior: each genome stands for one pose."""

    @pytest.fixture
    def genomes(self, prior, cube):
        decoder = decoder_of(cube, prior)
        genomes = draw(3000, len(decoder.layout))
        return genomes[~decoder(genomes).dead_ends][:200]

    def test_gives_rounded_poses_and_postures_one_for_each_genome(self, prior, cube, genomes):
        grasps = decoder_of(cube, prior)(genomes)
        assert len(grasps) == len(genomes) == 200
        for name, width in {"positions": 3, "quaternions": 4, "joints": 2, "surface_points": 3}.items():
            column = getattr(grasps, name)
            assert column.dtype == np.float32
            assert column.shape == (len(genomes), width)
        assert grasps.nu.dtype == np.float32
        assert grasps.are_finite.all()

    def test_gives_unit_quaternions(self, prior, cube, genomes):
        quaternions = decoder_of(cube, prior)(genomes).quaternions.astype(np.float64)
        np.testing.assert_allclose(np.linalg.norm(quaternions, axis=1), 1.0, atol=ROUNDING)

    def test_decodes_a_genome_alone_as_it_does_among_others(self, prior, cube, genomes):
        decoder = decoder_of(cube, prior)
        together, reversed_ = decoder(genomes), decoder(genomes[::-1])
        alone = [decoder(genomes[i : i + 1]) for i in range(20)]
        for name in ("positions", "quaternions", "joints", "surface_points", "nu"):
            assert getattr(together, name).tobytes() == getattr(reversed_, name)[::-1].tobytes()
            parts = b"".join(getattr(one, name).tobytes() for one in alone)
            assert parts == getattr(together, name)[:20].tobytes()

    def test_opens_the_fingers(self, prior, cube, genomes):
        grasps = decoder_of(cube, prior)(genomes)
        opened = [joint.opened for joint in cube.gripper.joints]
        np.testing.assert_array_equal(grasps.joints, np.tile(np.float32(opened), (len(genomes), 1)))
        assert set(grasps.synergies) == {NO_SYNERGY}

    def test_passes_numbers_that_are_not_finite_on_without_an_error(self, prior, cube, genomes):
        for gene in range(genomes.shape[1]):
            broken = genomes[:3].copy()
            broken[1, gene] = np.nan
            assert len(decoder_of(cube, prior)(broken)) == 3


@pytest.mark.parametrize("prior", CONES)
class TestCone:
    """The geometry of contact and approach (Huber et al. 2024, section III-A)."""

    @pytest.fixture
    def decoder(self, prior, cube):
        return decoder_of(cube, prior)

    @pytest.fixture
    def genomes(self):
        return draw(500)

    @pytest.fixture
    def grasps(self, decoder, genomes):
        return decoder(genomes)

    @pytest.fixture
    def normals(self, grasps, cube):
        return cube.surface_normals[KDTree(cube.surface_points).query(grasps.surface_points)[1]]

    def test_aims_at_the_surface_point_nearest_to_the_finder(self, decoder, genomes, grasps, cube):
        values = values_of(decoder, genomes)
        finders = np.stack([values["x_r"], values["y_r"], values["z_r"]], axis=1)
        distances = np.linalg.norm(finders[:, None] - cube.surface_points[None], axis=2)
        nearest = cube.surface_points[distances.argmin(axis=1)]
        np.testing.assert_array_equal(grasps.surface_points, nearest)

    def test_leans_from_the_normal_by_nu(self, decoder, genomes, grasps, normals):
        outward = grasps.positions.astype(float) - grasps.surface_points
        cosines = (outward * normals).sum(axis=1) / np.linalg.norm(outward, axis=1)
        nu = values_of(decoder, genomes)["nu"]
        np.testing.assert_allclose(cosines, np.cos(nu), atol=1e-5)
        np.testing.assert_array_equal(grasps.nu, nu.astype(np.float32))

    def test_stands_at_the_distance_d_and_the_palm_offset(self, decoder, genomes, grasps, cube):
        distances = np.linalg.norm(grasps.positions.astype(float) - grasps.surface_points, axis=1)
        expected = values_of(decoder, genomes)["d"] + cube.gripper.palm_offset
        np.testing.assert_allclose(distances, expected, atol=ROUNDING)

    def test_points_any_approach_axis_at_the_surface_point(self, prior, cube, genomes):
        others = ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0), (0.6, 0.0, 0.8))
        for axis in (cube.gripper.approach_axis, *others):
            grasps = decoder_of(with_gripper(cube, approach_axis=axis), prior)(genomes)
            pointed = Rotation.from_quat(grasps.quaternions).apply(axis)
            inward = grasps.surface_points - grasps.positions.astype(float)
            inward /= np.linalg.norm(inward, axis=1, keepdims=True)
            np.testing.assert_allclose(pointed, inward, atol=5e-6)


def test_a_given_pose_that_was_stored_is_decoded_to_its_own_bits(cube):
    stored = decoder_of(cube, "contact")(draw(300))
    again = decoder_of(cube, "given")(np.concatenate([stored.positions, stored.quaternions], axis=1))
    assert again.positions.tobytes() == stored.positions.tobytes()
    assert again.quaternions.tobytes() == stored.quaternions.tobytes()
    assert not again.surface_points.any()
    assert not again.nu.any()


def test_the_synergy_gene_is_rounded_to_a_label_with_half_the_room_for_the_outer_ones(cube):
    names = ("one", "two", "three", "four")
    hand = with_gripper(cube, synergies=tuple(Synergy(name=name, joints=FINGERS) for name in names))
    decoder = decoder_of(hand, "contact")
    assert decoder.layout.names[7:] == ("synergy",)
    labels = decoder(draw(6000, 8)).synergies
    shares = np.bincount(labels, minlength=4) / len(labels)
    np.testing.assert_allclose(shares, [1 / 6, 1 / 3, 1 / 3, 1 / 6], atol=0.02)


def test_free_joints_stand_at_their_genes_and_the_others_stay_open(cube):
    free = FreeJoint(name=FINGERS[1], low=0.03, high=0.01)
    decoder = decoder_of(with_gripper(cube, free_joints=(free,)), "contact")
    genomes = draw(50, 8)
    genomes[0, 7], genomes[1, 7] = -1.0, 1.0
    joints = decoder(genomes).joints
    assert joints[:2, 1].tolist() == np.float32([0.03, 0.01]).tolist()
    np.testing.assert_allclose(joints[:, 1], 0.02 - 0.01 * genomes[:, 7], atol=1e-8)
    assert set(joints[:, 0].tolist()) == {float(np.float32(0.04))}


def test_an_unknown_prior_is_named_with_the_known_ones(cube):
    with pytest.raises(UnknownName, match=r"Unknown prior 'antipodel'.*approach, contact, given"):
        decoder_of(cube, "antipodel")
