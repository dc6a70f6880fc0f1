"""Scenes on their way from the bus to the simulator."""

from qdgrasp_protocol.errors import NoReply
from qdgrasp_worker.serving.errands import Fetched
from qdgrasp_worker.serving.scenes import MOST, Scenes


class Questions:
    """Errands that are noted only."""

    def __init__(self) -> None:
        self.sought: list[str] = []

    def fetch(self, job: str, scene: str) -> None:
        self.sought.append(scene)


def test_a_scene_is_looked_for_once_and_again_only_where_it_was_not_found():
    questions = Questions()
    scenes = Scenes(questions)
    assert not any(scenes.has("job", "a") for _ in range(2))
    scenes.came(Fetched("job", "a", NoReply("nobody")))
    assert not scenes.has("job", "a")
    assert questions.sought == ["a", "a"]
    scenes.came(Fetched("job", "a", b"a scene"))
    assert scenes.has("job", "a")
    assert scenes.take("a") == b"a scene"


def test_of_scenes_that_nobody_takes_the_last_are_kept_and_the_others_looked_for_again():
    questions = Questions()
    scenes = Scenes(questions)
    names = [str(number) for number in range(100)]
    for name in names:
        scenes.has("job", name)
        scenes.came(Fetched("job", name, b"a scene"))
    assert [name for name in names if scenes.has("job", name)] == names[-MOST:]
    assert questions.sought[100:] == names[:-MOST]
