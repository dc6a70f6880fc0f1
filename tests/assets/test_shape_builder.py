"""The process that builds a shape: its file, its exit codes and its limits."""

import subprocess
import sys
from pathlib import Path

import msgspec
import pytest
from tests.assets.test_object_shape import folder_of, mesh_spec

from qdgrasp_assets.object_shape import build_shape, pack_shape, shape_task
from qdgrasp_assets.shape_builder import FAILED, UNUSABLE
from qdgrasp_protocol.build_messages import ShapeTask

GREEDY = "bytearray(1 << 30)"
READER = "(_ for _ in ()).throw(builder.AssetError('it cannot be read: MemoryError'))"
SCARCE = "(_ for _ in ()).throw(MemoryError())\nbuilder.limit_memory = lambda _: False"
LACKING = "(_ for _ in ()).throw(builder.UnreadableHere('a package is lacking'))"
REPLACED = """
import sys, qdgrasp_assets.shape_builder as builder
builder.MOST_MEMORY = 1 << 29
builder.build_shape = lambda *_: {}
sys.exit(builder.main())
"""
"""The process with another way to build."""
STARTER = """
import subprocess, sys
print(subprocess.Popen(sys.argv[1:], stdout=subprocess.PIPE).stdout.readline())
"""
"""Starts a process, and ends when it has said something."""


class ShapeBuild:
    """The task of a mesh, its files in a folder, and the command that builds it."""

    def __init__(self, folder: Path, mesh: str) -> None:
        spec = mesh_spec(folder, mesh)
        task = shape_task(spec)
        assert task is not None
        self.task: ShapeTask = task
        self.files, self.out = folder_of(task, spec, folder / "files"), folder / "out"
        (folder / "task").write_bytes(msgspec.msgpack.encode(self.task))
        self._names = [str(folder / "task"), str(self.files), str(self.out)]

    def command(self, build: str = "") -> list[str]:
        """The command, or one of a process that does something else in place of building."""
        program = ["-c", REPLACED.format(build)] if build else ["-m", "qdgrasp_assets.shape_builder"]
        return [sys.executable, *program, *self._names]

    def ended(self, build: str = "") -> tuple[int, str, str]:
        """Its exit code, standard output and standard error."""
        done = subprocess.run(self.command(build), capture_output=True, text=True, check=False)
        return done.returncode, done.stdout, done.stderr


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("QDGRASP_CACHE", str(tmp_path / "cache"))


def test_it_writes_the_shape(tmp_path):
    block = ShapeBuild(tmp_path, "split")
    assert block.ended() == (0, "", "")
    assert block.out.read_bytes() == pack_shape(build_shape(block.task, block.files))


def test_a_mesh_that_cannot_be_used_is_said_in_a_sentence(tmp_path):
    opened = ShapeBuild(tmp_path, "open")
    code, said, faults = opened.ended()
    assert (code, said) == (UNUSABLE, "")
    assert faults.startswith("The mesh 'mesh.stl' cannot be used: it is not closed")
    assert faults.count("\n") == 1
    assert not opened.out.exists()


TOO_MUCH = "The mesh takes more than 0.5 GB of memory; simplify it, for example with --mesh simplify=20000."
TOO_MUCH_HERE = TOO_MUCH.replace("0.5 GB of memory", "this worker's memory")


@pytest.mark.parametrize(
    ("build", "exit_code", "sentence"),
    [
        (GREEDY, UNUSABLE, TOO_MUCH),
        (READER, UNUSABLE, TOO_MUCH),
        (SCARCE, FAILED, TOO_MUCH_HERE),
        (LACKING, FAILED, "a package is lacking"),
    ],
)
def test_what_no_machine_can_build_and_what_this_one_cannot_are_told_apart(
    tmp_path, build, exit_code, sentence
):
    assert ShapeBuild(tmp_path, "block").ended(build) == (exit_code, "", f"{sentence}\n")


def test_it_ends_with_the_process_that_started_it(tmp_path):
    endless = "(print('it has begun', flush=True), __import__('time').sleep(3600))"
    command = [sys.executable, "-c", STARTER, *ShapeBuild(tmp_path, "block").command(endless)]
    done = subprocess.run(command, capture_output=True, check=True)  # comes back when both have ended
    assert b"it has begun" in done.stdout
