import pytest
import trimesh

from qdgrasp_assets.asset_report import check
from qdgrasp_assets.stand_ins import STAND_INS
from qdgrasp_assets.ycb import fetched_mesh
from qdgrasp_protocol.errors import UnknownName

BOX = trimesh.creation.box((0.02, 0.03, 0.04))


@pytest.mark.parametrize("name", STAND_INS)
def test_nothing_is_wrong_with_a_stand_in(name):
    report = check(name)
    assert report.faults == ()
    assert f"{STAND_INS[name].mass:g} kg" in report.facts


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
    assert any("m large instead of" in fault for fault in check("ycb_mug").faults)


def test_an_unknown_asset_is_an_unknown_name():
    with pytest.raises(UnknownName, match=r"Unknown asset 'mugg'\. Did you mean 'mug'"):
        check("mugg")
