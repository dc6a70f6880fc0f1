"""Outputs: paths that may be written, and that they appear whole or not at all."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from qdgrasp_coordinator.storage.job_folder import hold_lock
from qdgrasp_coordinator.storage.outputs import JOB, LOCK, OutFile, OutFolder, Output, replace
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.errors import OutputError
from qdgrasp_protocol.spec import run_spec

KINDS: list[Callable[[Path], Output]] = [OutFile, OutFolder]
ADVICE = "name another path with --out"
NEITHER = {"pipe": "a device or pipe", "link": "a link"}
each_kind = pytest.mark.parametrize("kind", KINDS)


def refused(output: Output) -> str:
    with pytest.raises(OutputError) as error:
        output.check()
    assert error.value.exit_code == 2
    return str(error.value)


def there(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


def fill(made: Path, kind: Callable[[Path], Output]) -> None:
    """Write the output: a file, or a folder with one."""
    if kind is OutFolder:
        made.mkdir()
        made /= "inside"
    made.write_text("new")


def fail(output: Output, error: BaseException) -> None:
    """Write it, and fail when it is nearly done."""
    with output.writing() as made:
        fill(made, type(output))
        raise error


@each_kind
def test_folders_on_the_way_are_made_for_what_is_written(kind, tmp_path) -> None:
    with kind(tmp_path / "a" / "b" / "out").writing() as made:
        assert made.name == "out"
        fill(made, kind)
    assert [path for path in there(tmp_path) if path != "a/b/out/inside"] == ["a", "a/b", "a/b/out"]


@each_kind
def test_what_fails_leaves_nothing_but_the_folders_on_the_way(kind, tmp_path) -> None:
    with pytest.raises(KeyboardInterrupt):
        fail(kind(tmp_path / "a" / "b" / "out"), KeyboardInterrupt())
    assert there(tmp_path) == ["a", "a/b"]


@each_kind
def test_what_lies_below_a_file_is_refused(kind: Callable[[Path], Output], tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    out = tmp_path / "file" / "a" / "out"
    assert refused(kind(out)) == f"{out} lies below {tmp_path / 'file'}, which is a file; {ADVICE}."


@pytest.mark.parametrize("force", [False, True, None])
@pytest.mark.parametrize(
    ("kind", "wanted", "name", "what"),
    [
        (OutFile, "a file", "", "a folder"),
        (OutFolder, "a folder", "file", "a file"),
        *((OutFile, "a file", name, what) for name, what in NEITHER.items()),
        *((OutFolder, "a folder", name, what) for name, what in NEITHER.items()),
    ],
)
def test_a_file_takes_the_place_of_a_file_alone_and_a_folder_of_none(
    tmp_path, force, kind, wanted, name, what
) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "file").touch()
    (tmp_path / "link").symlink_to(tmp_path if kind is OutFolder else tmp_path / "file")
    said = refused(kind(tmp_path / name, force=force, is_kind=lambda _: True))
    assert said == f"{tmp_path / name} is {what}, where {wanted} is to be written; {ADVICE}."


@pytest.mark.parametrize(
    ("force", "words"),
    [
        (False, f"is there already; {ADVICE}, or replace it with --force."),
        (None, f"is there already; {ADVICE}."),
    ],
)
def test_a_file_that_is_there_stays_unless_it_is_forced(tmp_path, force, words) -> None:
    out = tmp_path / "out"
    out.write_text("old")
    with pytest.raises(OutputError) as error:
        OutFile(out, force=force).write(b"new")
    assert str(error.value) == f"{out} {words}"
    assert out.read_text() == "old"
    OutFile(out, force=True).write(b"new")
    assert (out.read_text(), there(tmp_path)) == ("new", ["out"])


@pytest.mark.parametrize("force", [False, True, None])
@each_kind
def test_nothing_takes_the_place_of_a_part_of_a_run(kind, tmp_path, force) -> None:
    run = RunFolder.create(tmp_path / "run", run_spec({"gripper": "panda", "object": "mug"}), None).path
    for name in (*there(run), "scene.bundle", "run.sqlite", "run.sqlite-wal", "lock", "ranking.csv"):
        said = refused(kind(run / name, force=force))
        assert said == f"{run / name} is part of a run or of a campaign; {ADVICE}."
    kind(run / "grasps.csv", force=force).check()
    kind(tmp_path / "spec.toml", force=force).check()


@pytest.mark.parametrize("force", [False, True, None])
def test_a_file_takes_the_place_of_none_that_is_read(tmp_path: Path, force: bool | None) -> None:
    (tmp_path / "read").write_text("mine")
    (tmp_path / "again").hardlink_to(tmp_path / "read")
    for name in ("read", "again"):
        output = OutFile(tmp_path / name, force=force, inputs=(tmp_path / "nowhere", tmp_path / "read"))
        assert refused(output) == f"{tmp_path / name} is a file that is read here; {ADVICE}."
    OutFile(tmp_path / "new", inputs=(tmp_path / "nowhere", tmp_path / "read")).check()


def test_a_folder_with_other_files_stays_whatever_is_forced(tmp_path: Path) -> None:
    for name in "dcba":
        (tmp_path / name).touch()
    for force in (None, False, True):
        assert refused(OutFolder(tmp_path, force=force)) == (
            f"{tmp_path} holds other files (a, b, c and 1 more); {ADVICE}."
        )


def test_a_folder_of_the_kind_is_replaced_by_force_alone_and_as_a_whole(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "old").touch()
    assert "or replace it with --force" in refused(
        OutFolder(tmp_path / "out", force=False, is_kind=lambda _: True)
    )
    forced = OutFolder(tmp_path / "out", force=True, is_kind=lambda _: True)
    with pytest.raises(KeyboardInterrupt):
        fail(forced, KeyboardInterrupt())
    assert there(tmp_path) == ["out", "out/old"]
    with forced.writing() as made:
        fill(made, OutFolder)
    assert there(tmp_path) == ["out", "out/inside"]


def test_no_link_in_a_folder_leads_to_a_file_that_is_written(tmp_path: Path) -> None:
    (mine := tmp_path / "mine").write_text("precious")
    for name in (LOCK, f"{JOB}.part"):
        (tmp_path / name).symlink_to(mine)
    replace(tmp_path / JOB, b"{}")
    with pytest.raises(OutputError), hold_lock(tmp_path):
        pass
    assert mine.read_text() == "precious"
    assert {path.name for path in tmp_path.iterdir()} == {"mine", LOCK, JOB, f"{JOB}.part"}
