import msgspec
import numpy as np
import pytest
from tests.coordinator.scenes import jaw, made_scene

from qdgrasp.genomes import check_given, checked, layout_of
from qdgrasp_assets.scene import Synergy
from qdgrasp_protocol.errors import ImpossibleValue, InputError, UnknownName
from qdgrasp_protocol.genome import Gene, Layout

TWO = Layout("contact", (Gene("nu", 0.0, 1.0), Gene("d", 0.0, 0.1)))
POSE = Layout("given", (Gene("x", -1.0, 1.0), Gene("y", -1.0, 1.0)))


def test_genomes_become_single_floats_of_their_own() -> None:
    given = np.array([[1, -1], [0, 1]], order="F")
    genomes = checked(given, TWO)
    assert genomes.dtype == np.float32
    assert genomes.flags.c_contiguous
    assert genomes.tolist() == given.tolist()
    genomes[:] = 0
    assert given.any()


@pytest.mark.parametrize("given", [[0.0, 0.0], [[0.0]], np.zeros((2, 3))])
def test_genomes_of_another_shape_are_answered_with_the_genes(given: object) -> None:
    with pytest.raises(ImpossibleValue, match=r"shape \(n, 2\): nu, d, got \("):
        checked(given, TWO)  # type: ignore[arg-type]


def test_what_is_no_array_of_numbers_is_no_genome() -> None:
    with pytest.raises(InputError, match="nu, d"):
        checked([["a", "b"]], TWO)  # type: ignore[list-item]


def test_a_gene_outside_its_interval_is_named() -> None:
    with pytest.raises(ImpossibleValue, match=r"in \[-1, 1\] \(1 numbers are not\), got 1.5"):
        checked([[0.0, 1.5], [0.0, 0.0]], TWO)


def test_poses_may_lie_anywhere_but_nowhere() -> None:
    assert checked([[0.0, 2.5]], POSE).tolist() == [[0.0, 2.5]]
    with pytest.raises(ImpossibleValue, match="finite"):
        checked([[0.0, np.nan]], POSE)


@pytest.mark.parametrize(
    ("pose", "wanted"),
    [
        ([0, 0, 0, 0, 0, 0, 0], "length zero"),
        ([1e9, 0, 0, 0, 0, 0, 1], "x y z"),
        ([0, 0, 0, 0, 0, 0, 1, 2], "synergy.* 0 to 1 for this hand, got 2"),
        ([0, 0, 0, 0, 0, 0, 1, 0.5], "synergy"),
    ],
)
def test_what_no_hand_can_take_is_no_pose(pose: list[float], wanted: str) -> None:
    synergies = tuple(Synergy(name=name, joints=("finger",)) for name in "ab")
    hand = msgspec.structs.replace(jaw("jaw"), synergies=synergies if len(pose) > 7 else ())
    with pytest.raises(InputError, match=wanted):
        check_given(np.array([pose], np.float32), hand)


def test_no_genomes_are_genomes() -> None:
    assert checked(np.zeros((0, 2)), TWO).shape == (0, 2)


def test_a_prior_that_is_unknown_is_answered_with_those_that_are() -> None:
    with pytest.raises(UnknownName, match="Did you mean 'approach'"):
        layout_of(made_scene(), "aproach")
