"""Mended copies of hands on disk: a URDF and a folder of meshes beside the gripper's file."""

import shutil
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path

from qdgrasp_assets.hands.centring import centred
from qdgrasp_assets.hands.mending import mend
from qdgrasp_assets.hands.splitting import Tell
from qdgrasp_assets.urdf import Urdf, read_urdf
from qdgrasp_protocol.errors import AssetError


@dataclass(frozen=True)
class Copy:
    """A mended copy of a hand."""

    robot: Urdf
    base: str
    changes: tuple[str, ...]
    """What was done to it, one sentence each."""


def mended_urdf(toml: Path) -> Path:
    """Where the mended URDF of a gripper's file lies."""
    return toml.with_name(f"{toml.stem}_mended.urdf")


def mended_meshes(toml: Path) -> Path:
    """Where its meshes lie."""
    return toml.with_name(f"{toml.stem}_meshes")


def write_copy(robot: Urdf, base: str, toml: Path, tell: Tell, *, may_centre: bool) -> Copy:
    """Write a mended copy of the hand from link `base` on, beside the gripper's file `toml`.

    An older copy is replaced.

    Parameters
    ----------
    tell
        Hears what takes long.
    may_centre
        Whether another base link is put before `base` where the fingers close beside its line of approach.

    Raises
    ------
    AssetError
        A mesh is missing or cannot be read, CoACD failed, or the copy cannot be written.
    """
    folder, path = mended_meshes(toml), mended_urdf(toml)
    mended = mend(robot, base, folder.name, tell)
    try:
        shutil.rmtree(folder, ignore_errors=True)
        for name, content in mended.meshes.items():
            folder.mkdir(parents=True, exist_ok=True)
            (path.parent / name).write_bytes(content)
        _write(mended.element, path)
        copied = read_urdf(path)
        found = centred(copied, base) if may_centre else None
        if found is None:
            return Copy(copied, base, mended.changes)
        _write(found.robot.element, path)
        return Copy(read_urdf(path), found.base, (*mended.changes, found.change))
    except OSError as error:
        raise AssetError(
            f"The mended hand cannot be written to '{path}': {error.strerror or error}."
        ) from None


def _write(element: ET.Element, path: Path) -> None:
    ET.indent(element)
    path.write_text(ET.tostring(element, encoding="unicode") + "\n", encoding="utf-8")
