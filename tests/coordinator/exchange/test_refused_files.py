"""Files that are damaged, of none of the formats, or no files."""

import os
from pathlib import Path

import numpy as np
import pytest
from tests.coordinator.exchange.foreign import (
    COM,
    check_refusal,
)

from qdgrasp_coordinator.exchange import importing
from qdgrasp_coordinator.exchange.exporting import export
from qdgrasp_coordinator.exchange.things import Thing
from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_protocol.errors import InputError


@pytest.mark.parametrize("name", ["acronym", "parquet"])
@pytest.mark.parametrize("share", [0.1, 0.5, 0.9, 0.99])
def test_what_was_cut_off_is_refused(run: RunFolder, panda, tmp_path: Path, name: str, share: float) -> None:
    export(run, tmp_path / "whole", name)
    whole = (tmp_path / "whole").read_bytes()
    (tmp_path / "cut").write_bytes(whole[: int(len(whole) * share)])
    check_refusal(panda, tmp_path / "cut", "it is a damaged")


@pytest.mark.parametrize("name", ["acronym", "parquet", "isaac", "graspgen"])
def test_what_was_damaged_anywhere_is_read_or_refused(run: RunFolder, tmp_path: Path, name: str) -> None:
    export(run, tmp_path / "whole", name)
    file = tmp_path / "whole" / "grasp_data" / "block.json" if name == "graspgen" else tmp_path / "whole"
    hand, random = run.scene().gripper, np.random.default_rng(0)
    sentences = []
    for _ in range(60):
        (tmp_path / "damaged").write_bytes(damaged(file.read_bytes(), random))
        try:
            importing.read_grasps(tmp_path / "damaged", hand, Thing(COM, 1.0))
        except InputError as error:
            sentences.append(str(error))
    assert len(sentences) > 5
    assert "\n" not in "".join(sentences)


def damaged(content: bytes, random: np.random.Generator) -> bytes:
    """With a byte or some that are others, gone, or too many."""
    first = int(random.integers(len(content)))
    gone, come = random.integers(0, 30, 2)
    return content[:first] + random.bytes(int(come)) + content[first + int(gone) :]


BAD_FILES = {
    "empty": (b"", "it is empty"),
    "blank": (b" \n", "it is empty"),
    "binary": (b"\0\1\2\3", "it is of none of the formats that are read: ACRONYM"),
    "no JSON": (b"{", "it is not JSON with grasps"),
    "another JSON": (b'{"a": 1}', "it is not JSON with grasps"),
    "a ragged list": (b'{"transforms": [[[1, 0], [0]]]}', "its transforms must be of shape (n, 4, 4)"),
    "no transforms": (b'{"transforms": []}', "there is none in it"),
    "too few bits": (
        b'{"transforms": [[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]], "quality_flex_object_in_gripper": []}',
        "its quality must be of shape (1)",
    ),
    "a scale of zero": (
        b'{"transforms": [[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]], "object_scale": 0}',
        "the object's scale in it must be a number greater than 0, and is 0",
    ),
    "deep JSON": (b'{"grasps": ' + b"[" * 100_000, "it is not JSON with grasps"),
    "a picture": (b"\x89PNG\r\n\x1a\n\0\0", "it is of none of the formats"),
}


@pytest.mark.parametrize(("content", "why"), BAD_FILES.values(), ids=BAD_FILES)
def test_a_file_of_none_of_the_formats_is_refused(panda, tmp_path: Path, content: bytes, why: str) -> None:
    (tmp_path / "f").write_bytes(content)
    check_refusal(panda, tmp_path / "f", why)


def test_a_file_that_is_not_there_is_refused(panda, tmp_path: Path) -> None:
    check_refusal(panda, tmp_path / "none", "no such file or directory")
    check_refusal(panda, tmp_path, "it is a folder; of one that is for GraspGen name the JSON in grasp_data")


def test_a_pipe_is_refused_and_not_waited_for(panda, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "f")
    check_refusal(panda, tmp_path / "f", "it is no ordinary file")


@pytest.mark.parametrize("name", ["csv", "moveit"])
def test_what_is_only_written_is_told_by_its_name(run: RunFolder, panda, tmp_path: Path, name: str) -> None:
    export(run, tmp_path / "f", name)
    check_refusal(panda, tmp_path / "f", "which is not read back; export parquet instead")
