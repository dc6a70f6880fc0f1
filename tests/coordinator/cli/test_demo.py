"""The demo replaces its own folder, and nobody else's."""

import pytest

from qdgrasp_coordinator.cli.demo import MARKER, clear
from qdgrasp_protocol.errors import FolderError


def test_an_earlier_demo_is_replaced(tmp_path):
    out = tmp_path / "demo"
    out.mkdir()
    (out / MARKER).touch()
    (out / "run.sqlite").touch()
    clear(out)
    assert not out.exists()


def test_a_folder_without_the_marker_is_left_alone(tmp_path):
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(FolderError, match=MARKER):
        clear(tmp_path)
    assert (tmp_path / "thesis.tex").exists()


def test_nothing_and_an_empty_folder_need_no_clearing(tmp_path):
    clear(tmp_path / "demo")
    clear(tmp_path)
    assert tmp_path.is_dir()
