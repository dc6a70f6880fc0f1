import json

import pytest

from qdgrasp_assets.ycb import SCAN_NAMES, read_scan, scan_source
from qdgrasp_protocol.errors import AssetError


def test_the_centre_of_mass_is_the_tabled_inertial_origin(asset_path):
    table = json.loads((asset_path / "objects/objects.json").read_text())
    for name in SCAN_NAMES:
        expected = table[name.removeprefix("ycb_")]["inertial_origin_xyz"]
        assert read_scan(name, "paper").com_in_mesh == pytest.approx(expected)


def test_a_scan_that_is_not_there_says_what_it_is_and_where_it_was_looked_for(monkeypatch, tmp_path):
    monkeypatch.setenv("QDGRASP_ASSET_PATH", f"{tmp_path}/a:{tmp_path}/b")
    assert scan_source("ycb_mug") == "absent"
    with pytest.raises(AssetError, match=rf"'ycb_mug' is a scan .*QDGRASP_ASSET_PATH is '{tmp_path}/a:"):
        read_scan("ycb_mug", "paper")
