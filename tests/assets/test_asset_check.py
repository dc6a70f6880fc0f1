import pytest
import trimesh

from qdgrasp_assets import ycb
from qdgrasp_assets.asset_check import AssetSummary, check
from qdgrasp_assets.stand_ins import STAND_INS
from qdgrasp_assets.ycb import SCANS, fetched_mesh
from qdgrasp_protocol.errors import UnknownName


@pytest.fixture
def written(tmp_path, monkeypatch):
    """Write a mesh to a file, after a change of its triangles."""
    monkeypatch.setenv("QDGRASP_CACHE", str(tmp_path / "cache"))

    def write(mesh, faces=slice(None)):
        path = tmp_path / "part.ply"
        trimesh.Trimesh(mesh.vertices, mesh.faces[faces], process=False).export(path)
        return str(path)

    return write


BOX = trimesh.creation.box((0.02, 0.03, 0.04))


@pytest.mark.parametrize("name", STAND_INS)
def test_nothing_is_wrong_with_a_stand_in(name):
    report = check(name)
    assert report.faults == ()
    assert f"{STAND_INS[name].mass:g} kg" in report.facts


def test_nothing_is_wrong_with_a_good_mesh(written):
    facts = ("0.0200 x 0.0300 x 0.0400 m", "12 triangles", "24.00 cm3", "1 convex part")
    assert check(part := written(BOX)) == AssetSummary(part, facts)


def test_all_that_is_wrong_with_a_mesh_is_said(written):
    large = BOX.copy().apply_scale(1000)
    faults = check(written(large, slice(1, None))).faults
    assert len(faults) == 2
    assert (
        "40 m large, larger than what a hand grasps; it looks like millimetres: add --units mm" in faults[0]
    )
    assert "3 edges have only one triangle" in faults[1]


def test_winding_is_put_right_and_told_of(written):
    mixed = BOX.copy()
    mixed.faces[0] = mixed.faces[0][::-1]
    assert "repaired: 1 triangles turned, wound like their neighbours" in check(written(mixed)).facts
    inverted = trimesh.Trimesh(BOX.vertices, BOX.faces[:, ::-1], process=False)
    found = check(written(inverted))
    assert found.faults == ()
    assert "inside out" in " ".join(found.facts)


def test_an_unreadable_file_is_a_fault(tmp_path):
    path = tmp_path / "part.stl"
    path.write_bytes(b"no mesh")
    assert "part.stl" in check(str(path)).faults[0]
    assert "No " in check(str(tmp_path / "hand.toml")).faults[0]


def test_a_gripper_is_checked_by_name_and_by_file(claw):
    assert check("panda").faults == ()
    assert check(str(claw)).faults == ()
    claw.write_text(claw.read_text().replace('"palm"', '"wrist"'))
    assert "wrist" in check(str(claw)).faults[0]


def test_a_scan_that_is_absent_or_was_changed_is_a_fault_with_its_remedy(monkeypatch, tmp_path):
    monkeypatch.setenv("QDGRASP_DATA", str(tmp_path))
    monkeypatch.delenv("QDGRASP_ASSET_PATH", raising=False)
    assert "`qdgrasp asset fetch ycb_mug`" in check("ycb_mug").faults[0]
    fetched_mesh("ycb_mug").parent.mkdir(parents=True)
    BOX.export(fetched_mesh("ycb_mug"))
    ycb.write_pin(SCANS["ycb_mug"].archive, ycb.ArchivePin(mesh_sha256="0" * 64))
    faults = check("ycb_mug").faults
    assert any("m large instead of" in fault for fault in faults)
    assert any("instead of 0000" in fault for fault in faults)


def test_an_unknown_asset_is_an_unknown_name():
    with pytest.raises(UnknownName, match=r"Unknown asset 'mugg'\. Did you mean 'mug'"):
        check("mugg")
