import io
import tarfile
from pathlib import Path

import numpy as np
import pytest
import trimesh
from tests.assets.file_server import claims, cut, fails, served

from qdgrasp_assets import asset_paths, ycb
from qdgrasp_assets.geometry.mesh import Mesh
from qdgrasp_assets.ycb import SCANS
from qdgrasp_protocol.errors import AssetError

NAME = "ycb_rubiks_cube"
ARCHIVE = SCANS[NAME].archive
MEMBER = SCANS[NAME].member


def bar() -> trimesh.Trimesh:
    return trimesh.creation.box((0.06, 0.04, 0.02)).subdivide().apply_translation((0.01, -0.02, 0.03))


def ply(mesh: trimesh.Trimesh) -> bytes:
    return mesh.export(file_type="ply")


def tgz(content: bytes, member: str = MEMBER, *others: tarfile.TarInfo) -> bytes:
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w:gz") as tar:
        for entry in others:
            tar.addfile(entry, io.BytesIO(b"x" * entry.size))
        entry = tarfile.TarInfo(member)
        entry.size = len(content)
        tar.addfile(entry, io.BytesIO(content))
    return packed.getvalue()


def of(mesh: trimesh.Trimesh) -> dict:
    """Entry of the catalog for a mesh."""
    return {
        "extents": tuple(mesh.extents),
        "low": tuple(mesh.bounds[0]),
        "volume": Mesh(mesh.vertices, mesh.faces).volume,
        "faces": len(mesh.faces),
    }


@pytest.fixture
def site(monkeypatch, tmp_path):
    """The home of a scan that is a bar, and a user who has nothing yet."""
    monkeypatch.setenv("no_proxy", "*")
    monkeypatch.setenv("QDGRASP_DATA", str(tmp_path / "data"))
    monkeypatch.setenv("QDGRASP_CACHE", str(tmp_path / "cache"))
    monkeypatch.delenv("QDGRASP_ASSET_PATH", raising=False)
    monkeypatch.setitem(SCANS, NAME, ycb.Scan(archive=ARCHIVE, member=MEMBER, **of(bar())))
    with served() as running:
        running.content = tgz(ply(bar()))
        yield running


def bring(site, name: str = NAME) -> Path:
    return ycb.fetch_scan(name, site.address, lambda _sentence: None)


def assert_refused(site, sentence: str) -> None:
    """A scan is refused, and leaves nothing in the data folder."""
    with pytest.raises(AssetError, match=sentence):
        bring(site)
    assert ycb.scan_source(NAME) == "absent"
    assert not list(archived().glob("*.tgz"))


def archived():
    return asset_paths.data_folder() / "downloads"


def test_a_scan_is_accepted_on_its_geometry(site):
    mesh = bring(site)
    assert site.asked == [f"/{ARCHIVE}"]
    assert mesh.read_bytes() == ply(bar())
    assert "CC BY 4.0" in mesh.with_name("ATTRIBUTION.txt").read_text()
    assert list(archived().iterdir()) == []


def holed() -> trimesh.Trimesh:
    mesh = bar()
    mesh.update_faces(np.arange(len(mesh.faces)) != 3)
    return mesh


OTHERS = (bar().apply_scale((1.01, 1, 1)), bar().subdivide(), trimesh.creation.icosphere(1, 0.03), holed())


@pytest.mark.parametrize("mesh", OTHERS)
def test_a_wrong_geometry_is_refused(site, mesh):
    site.content = tgz(ply(mesh))
    assert_refused(site, f"thrown away: it is not that scan, but .* {len(mesh.faces)} triangles")


def test_names_in_an_archive_are_never_paths(site, tmp_path):
    others = [
        tarfile.TarInfo("../../evil"),
        tarfile.TarInfo(str(tmp_path / "evil")),
        tarfile.TarInfo("other/mesh.ply"),
    ]
    for entry in others:
        entry.size = 10
    site.content = tgz(ply(bar()), MEMBER, *others)
    bring(site)
    written = {path.name for path in tmp_path.rglob("*") if path.is_file()}
    assert written == {"mesh.ply", "ATTRIBUTION.txt"}


def spoilt(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The same surface in millimetres, inside out, elsewhere, corners not shared, and a fold."""
    corners = mesh.vertices[mesh.faces[:, ::-1]].reshape(-1, 3) * 1000 + 25
    faces = np.arange(len(corners)).reshape(-1, 3)
    fold = np.array([faces[0], faces[0][::-1], [0, 0, 1]])
    return trimesh.Trimesh(corners, np.concatenate([faces, fold]), process=False)


def test_units_frame_winding_and_folds_are_put_right(site):
    site.content = tgz(ply(spoilt(bar())))
    bring(site)
    mesh, expected = ycb.read_scan(NAME, "paper").mesh, bar()
    assert np.array(mesh.bounds) == pytest.approx(expected.bounds, abs=1e-8)
    assert mesh.volume == pytest.approx(expected.volume)
    assert (len(mesh.vertices), len(mesh.faces)) == (len(expected.vertices), len(expected.faces))


def test_a_fetched_scan_has_the_constants_of_the_set_and_its_own_parts_but_not_those_of_released(site):
    bring(site)
    target = ycb.read_scan(NAME, "paper")
    assert (target.source, target.collision_source, target.licence) == ("fetched", "own hull", ycb.LICENCE)
    assert target.mass == 0.094
    assert target.com_in_mesh == pytest.approx((-0.016184, -0.000449, 0.028548))
    sentence = r"'released' needs the collision hulls .*'ycb_rubiks_cube' does not have"
    with pytest.raises(AssetError, match=sentence):
        ycb.read_scan(NAME, "released")


@pytest.mark.parametrize("behaviour", [cut(100), fails(404), claims(1 << 40)])
def test_a_download_that_fails_leaves_nothing(site, behaviour):
    site.behaviours = [behaviour]
    assert_refused(site, "cannot be fetched")
    assert list(archived().iterdir()) == []
    assert bring(site).is_file()
