"""What version 0.1.0 recorded, written to files that other tools read."""

import shutil
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.golden.runs import RECORDED, command

import qdgrasp


def csv_text() -> str:
    """The grasps of the recorded run as CSV."""
    return _exported("csv")


def isaac_text() -> str:
    """The same as a file of Isaac."""
    return _exported("isaac")


def _exported(name: str) -> str:
    """What `qdgrasp export` writes, without the version of the package that writes it."""
    with TemporaryDirectory() as folder:
        home = Path(folder)
        shutil.copytree(RECORDED / "finished", home / "finished")
        command(home, "export", "finished", "--format", name, "--out", "grasps")
        return (home / "grasps").read_text().replace(f"qdgrasp: {qdgrasp.__version__}", "qdgrasp: VERSION", 1)
