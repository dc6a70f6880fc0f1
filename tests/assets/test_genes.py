"""Genes of priors, and the boxes to which they bring the hand."""

import pytest
from tests.common import with_gripper

from qdgrasp_assets.catalog import build_scene
from qdgrasp_assets.genes import PRIOR_GENES, layout, spherical_radius
from qdgrasp_assets.scene import FreeJoint, Scene, Synergy
from qdgrasp_protocol.errors import JawNeeded
from qdgrasp_protocol.spec import RunSpec


@pytest.fixture(scope="module")
def cube() -> Scene:
    return build_scene(RunSpec(gripper="panda", object="rubiks_cube"))


NAMES = {
    "antipodal": ("x_r", "y_r", "z_r", "Omega"),
    "approach": ("x_r", "y_r", "z_r", "nu", "d", "xi", "omega"),
    "contact": ("x_r", "y_r", "z_r", "nu", "d", "xi", "omega"),
    "given": ("x", "y", "z", "qx", "qy", "qz", "qw"),
    "spherical": ("r", "longitude", "colatitude", "alpha", "beta", "gamma"),
}


@pytest.mark.parametrize("prior", PRIOR_GENES)
def test_synergy_and_free_joints_come_after_the_genes_of_the_prior(prior, cube) -> None:
    assert layout(cube, prior).names == NAMES[prior]
    pair = tuple(Synergy(name=name, joints=("panda_finger_joint1",)) for name in ("one", "two"))
    free = FreeJoint(name="panda_finger_joint2", low=0.03, high=0.0)
    genes = layout(with_gripper(cube, synergies=pair, free_joints=(free,)), prior).genes[-2:]
    assert [(gene.name, gene.low, gene.high) for gene in genes] == [
        ("synergy", 0.0, 1.0),
        ("panda_finger_joint2", 0.03, 0.0),
    ]


def test_the_search_radius_is_that_of_the_released_code_but_for_the_margins_of_bullet(asset_path) -> None:
    """Figures: L_robot + L_object as read from the released code of Huber et al. 2024."""
    released = {
        "ref_panda_2f": 0.2931,
        "ref_robotiq_2f": 0.2528,
        "ref_allegro": 0.3345,
        "ref_bh280": 0.4240,
        "ref_shadow": 0.6262,
    }
    for gripper, expected in released.items():
        radius = spherical_radius(build_scene(RunSpec(gripper=gripper, object="ycb_rubiks_cube")))
        assert expected - 0.018 < radius < expected, (gripper, radius)


def test_a_hand_without_a_jaw_has_no_antipodal_genes(cube) -> None:
    with pytest.raises(JawNeeded):
        layout(with_gripper(cube, jaw=None), "antipodal")
