import itertools

from qdgrasp_coordinator.search.base import keyed_generator


def test_a_key_always_gives_the_same_numbers() -> None:
    one, other = keyed_generator(7, "parents", 3), keyed_generator(7, "parents", 3)
    assert one.random(8).tolist() == other.random(8).tolist()


def test_seed_purpose_and_generation_all_change_the_numbers() -> None:
    keys = itertools.product((0, 1, 2**32, 2**62 + 1), ("parents", "mutation"), (0, 1, 2, 2**32 - 1))
    firsts = [keyed_generator(*key).random() for key in keys]
    assert len(set(firsts)) == len(firsts)


def test_the_numbers_stay_the_same_from_version_to_version() -> None:
    """Journals hold what was drawn: were this to change, no old run could be resumed."""
    assert keyed_generator(0, "uniform", 0).integers(0, 2**32, 3).tolist() == [
        4054646954,
        1409545429,
        458180423,
    ]
