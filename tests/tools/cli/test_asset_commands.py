import json

import pytest
from tests.assets.file_server import fails, served
from typer.testing import CliRunner

from qdgrasp_assets.ycb import SCANS
from qdgrasp_protocol.errors import AssetError
from qdgrasp_tools.cli.asset_commands import asset_app


@pytest.fixture
def asset(monkeypatch, tmp_path):
    """`qdgrasp asset` for a user who has nothing yet."""
    monkeypatch.setenv("QDGRASP_DATA", str(tmp_path))
    monkeypatch.setenv("no_proxy", "*")
    monkeypatch.delenv("QDGRASP_ASSET_PATH", raising=False)
    return lambda *words: CliRunner().invoke(asset_app, words)


def test_list_names_everything_with_source_and_licence(asset):
    listed = json.loads(asset("list", "--json").stdout)
    names = {entry["name"]: entry for kind in ("grippers", "objects") for entry in listed[kind]}
    assert names["panda"]["source"] == names["bowl"]["source"] == "built in"
    assert names["ref_shadow"]["source"] == names["ycb_bowl"]["source"] == "absent"
    assert all(entry["licence"] for entry in names.values())
    said = asset("list").stdout
    assert all(name in said for name in names)


def test_fetch_states_the_licence_and_asks_the_address_it_is_given(asset, monkeypatch):
    with served() as site:
        site.behaviours = [fails(404), fails(404)]
        done = asset("fetch", "ycb_bowl", "--from", site.address)
        assert isinstance(done.exception, AssetError)
        assert "CC BY 4.0" in done.stderr
        monkeypatch.setenv("QDGRASP_YCB_URL", site.address + "/mirror/")
        asset("fetch", "ycb_bowl")
        archive = SCANS["ycb_bowl"].archive
        assert site.asked == [f"/{archive}", f"/mirror/{archive}"]
