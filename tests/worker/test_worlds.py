"""The worlds that a worker keeps."""

import pytest

from qdgrasp_worker.worlds import MOST, Worlds


class Stub:
    """An evaluator that only knows whether it was closed."""

    def __init__(self):
        self.closed = 0

    def close(self):
        self.closed += 1


@pytest.fixture
def loaded():
    return {}


@pytest.fixture
def get(loaded):
    def get(worlds, digest):
        return worlds.get(digest, lambda: loaded.setdefault(digest, Stub()))

    return get


def test_a_scene_is_loaded_once_and_kept(get):
    worlds = Worlds()
    first = get(worlds, "a")
    assert worlds.get("a", lambda: pytest.fail("loaded again")) is first


def test_at_most_eight_are_kept_and_the_one_longest_unused_is_closed_first(get, loaded):
    worlds = Worlds()
    names = [str(i) for i in range(MOST)]
    for name in names:
        get(worlds, name)
    get(worlds, "0")
    get(worlds, "new")
    assert MOST == 8
    assert len(worlds) == 8
    assert "1" not in worlds
    assert "0" in worlds
    assert [name for name, stub in loaded.items() if stub.closed] == ["1"]


def test_room_is_made_before_the_next_is_loaded(get, loaded):
    worlds = Worlds(most=1)
    get(worlds, "a")
    worlds.get("b", lambda: Stub() if loaded["a"].closed else pytest.fail("two worlds at once"))


def test_a_scene_that_cannot_be_loaded_leaves_no_trace(get):
    worlds = Worlds()

    def fail():
        raise ValueError

    with pytest.raises(ValueError):  # noqa: PT011
        worlds.get("a", fail)
    assert "a" not in worlds


def test_leaving_closes_all_of_them_once(get, loaded):
    with Worlds() as worlds:
        for name in "abc":
            get(worlds, name)
    assert [stub.closed for stub in loaded.values()] == [1, 1, 1]
    worlds.close()
    assert [stub.closed for stub in loaded.values()] == [1, 1, 1]
