"""Mended copies of hands on disk: a URDF and a folder of meshes beside the gripper's file."""

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory

from qdgrasp_assets.files import amiss
from qdgrasp_assets.hands.centring import centred
from qdgrasp_assets.hands.mending import mend
from qdgrasp_assets.hands.splitting import Tell
from qdgrasp_assets.urdf import Urdf, read_urdf
from qdgrasp_protocol.errors import AssetError

HEAD = (
    "<!-- A mended copy, written by `qdgrasp gripper new`, which writes it again where it is told to. -->\n"
)
"""How each copy begins: what begins otherwise is somebody's own."""


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


def check_replaceable(robot: Urdf, toml: Path) -> None:
    """Check that nothing but an older copy lies where a copy of `robot` would, and not what it is made of.

    Raises
    ------
    AssetError
        It does.
    """
    urdf, folder = mended_urdf(toml), mended_meshes(toml)
    if urdf.exists() and not _is_ours(urdf):
        raise AssetError(_kept(urdf, "was not written by --mend"))
    if folder.exists() and not _holds_copies(folder, urdf):
        raise AssetError(_kept(folder, "holds what was not written by --mend"))
    if urdf.exists() and urdf.samefile(robot.path):
        raise AssetError(_kept(urdf, "is the URDF itself"))
    if folder.exists() and any(_is_in(folder, robot, name) for name in _mesh_names(robot.element)):
        raise AssetError(_kept(folder, f"holds the meshes of '{robot.path}'"))


@contextmanager
def mended_copy(robot: Urdf, base: str, toml: Path, tell: Tell, *, may_centre: bool) -> Iterator[Copy]:
    """A mended copy of the hand from link `base` on, beside the gripper's file `toml`.

    It replaces an older copy at once. Where the with-block fails, what was there before is there again.

    Parameters
    ----------
    tell
        Hears what takes long.
    may_centre
        Whether another base link is put before `base` where the fingers close beside its line of approach.

    Raises
    ------
    AssetError
        A mesh is missing or cannot be read, CoACD failed, or the copy cannot be written; or something else
        than an older copy is there.
    """
    check_replaceable(robot, toml)
    urdf, names = mended_urdf(toml), (mended_urdf(toml).name, mended_meshes(toml).name)
    with _writing(urdf):
        room = TemporaryDirectory(prefix=f".{toml.stem}.", dir=toml.parent)
    with room as workshop:
        new, old, failed = (_folder(Path(workshop) / name) for name in ("new", "old", "failed"))
        with _writing(urdf):
            copy = _made(robot, base, new / urdf.name, names[1], tell, may_centre=may_centre)
        try:
            with _writing(urdf):
                _move(names, toml.parent, old)
                _move(names, new, toml.parent)
            yield replace(copy, robot=read_urdf(urdf))
        except BaseException:
            _move(names, toml.parent, failed)
            _move(names, old, toml.parent)
            raise


def write_copy(robot: Urdf, base: str, toml: Path, tell: Tell, *, may_centre: bool) -> Copy:
    """Write a mended copy that stays; parameters and errors as of `mended_copy`."""
    with mended_copy(robot, base, toml, tell, may_centre=may_centre) as copy:
        return copy


def _made(robot: Urdf, base: str, urdf: Path, folder: str, tell: Tell, *, may_centre: bool) -> Copy:
    """The copy, its URDF at `urdf` and its meshes in a `folder` beside it."""
    mended = mend(robot, base, folder, tell)
    for name, content in mended.meshes.items():
        (urdf.parent / name).parent.mkdir(parents=True, exist_ok=True)
        (urdf.parent / name).write_bytes(content)
    _write(mended.element, urdf)
    copied = read_urdf(urdf)
    found = centred(copied, base) if may_centre else None
    if found is None:
        return Copy(copied, base, mended.changes)
    _write(found.robot.element, urdf)
    return Copy(found.robot, found.base, (*mended.changes, found.change))


def _write(element: ET.Element, path: Path) -> None:
    ET.indent(element)
    path.write_text(HEAD + ET.tostring(element, encoding="unicode") + "\n", encoding="utf-8")


def _folder(path: Path) -> Path:
    path.mkdir()
    return path


def _move(names: tuple[str, ...], source: Path, target: Path) -> None:
    """Move what there is of some files and folders."""
    for name in names:
        if (source / name).exists():
            (source / name).rename(target / name)


@contextmanager
def _writing(urdf: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise AssetError(
            f"The mended hand cannot be written to '{urdf}': {error.strerror or error}."
        ) from None


def _is_ours(urdf: Path) -> bool:
    if amiss(urdf):
        return False
    with urdf.open("rb") as stream:
        return stream.read(len(HEAD.encode())) == HEAD.encode()


def _holds_copies(folder: Path, urdf: Path) -> bool:
    """Whether all in a folder are meshes of the copy at `urdf`."""
    if folder.is_symlink() or not folder.is_dir():
        return False
    names = set(_mesh_names(read_urdf(urdf).element)) if urdf.is_file() else set()
    return all(each.is_file() and f"{folder.name}/{each.name}" in names for each in folder.iterdir())


def _mesh_names(element: ET.Element) -> Iterator[str]:
    return (mesh.get("filename", "") for mesh in element.iter("mesh"))


def _is_in(folder: Path, robot: Urdf, name: str) -> bool:
    """Whether a mesh that a URDF names lies in a folder; of a package, where its path has such a folder."""
    if name.startswith("package://"):
        return folder.name in PurePosixPath(name).parts
    return (robot.path.parent / name.removeprefix("file://")).resolve().is_relative_to(folder.resolve())


def _kept(path: Path, why: str) -> str:
    return (
        f"'{path}' {why}, and is not replaced, not even with --force: name another path with --out, beside "
        "which the mended copy is written."
    )
