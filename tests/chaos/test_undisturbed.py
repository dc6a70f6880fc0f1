"""What a run is compared with is computed anew whenever anything may have changed it."""

from pathlib import Path

import pytest
from tests.chaos import undisturbed

from qdgrasp_protocol.spec import RunSpec

SPEC = RunSpec(gripper="panda", object="mug")
FILES = (
    "worker/a/episode.py",
    "assets/a/grippers/panda.toml",
    "assets/a/objects/mug.obj",
    "assets/a/hand.urdf",
)


@pytest.fixture
def key(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setattr(undisturbed, "ROOT", tmp_path)
    for name in FILES:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(name)
    return undisturbed._key(SPEC)


@pytest.mark.parametrize("name", FILES)
def test_it_depends_on_every_file_of_the_packages(tmp_path: Path, key: str, name: str) -> None:
    (tmp_path / name).write_text("something else")
    assert undisturbed._key(SPEC) != key


def test_it_depends_on_where_a_file_is_and_not_on_what_python_writes(tmp_path: Path, key: str) -> None:
    (tmp_path / "worker" / "__pycache__").mkdir()
    (tmp_path / "worker" / "__pycache__" / "episode.pyc").touch()
    assert undisturbed._key(SPEC) == key
    (tmp_path / FILES[0]).rename(tmp_path / "worker" / "episode.py")
    assert undisturbed._key(SPEC) != key


def test_the_built_in_hands_and_objects_are_among_these_files() -> None:
    kinds = {file.suffix for file in undisturbed.package_files(undisturbed.ROOT)}
    assert {".py", ".toml", ".urdf"} <= kinds
