import socket

import pytest
from tests.assets.file_server import (
    another_range,
    claims,
    cut,
    fails,
    served,
    stall,
    trickle,
    whole,
    without_length,
    without_ranges,
)

from qdgrasp_assets import scan_download as module
from qdgrasp_assets.scan_download import ATTEMPTS, download
from qdgrasp_protocol.errors import AssetError

CONTENT = bytes(range(256)) * 1000


@pytest.fixture
def site(monkeypatch):
    monkeypatch.setenv("no_proxy", "*")
    with served() as running:
        running.content = CONTENT
        yield running


@pytest.fixture
def bring(site, tmp_path):
    def call(**options):
        download(f"{site.address}/thing", tmp_path / "thing", **options)
        return (tmp_path / "thing").read_bytes()

    return call


@pytest.mark.parametrize(
    "behaviours",
    [
        [whole],
        [trickle],
        [without_length],
        pytest.param([cut(1000), without_ranges], id="a server without ranges is asked for all again"),
        pytest.param([cut(1000), another_range], id="a range that was not asked for is not taken"),
        pytest.param([fails(503), fails(500)], id="a passing fault of the server passes"),
    ],
)
def test_a_file_arrives_whole_and_nothing_else_is_left(site, bring, tmp_path, behaviours):
    site.behaviours = behaviours
    assert bring() == CONTENT
    assert [path.name for path in tmp_path.iterdir()] == ["thing"]


def test_progress_ends_at_the_whole(bring):
    told = []
    bring(progress=lambda here, total: told.append((here, total)))
    assert told[-1] == (len(CONTENT), len(CONTENT))
    assert told == sorted(told)


def test_an_interrupted_download_goes_on_where_it_broke_off(site, bring):
    site.behaviours = [cut(1000), cut(50_000)]
    assert bring() == CONTENT
    assert site.ranges == [None, "bytes=1000-", "bytes=51000-"]


def test_a_later_command_goes_on_with_what_an_earlier_one_left(site, bring, tmp_path):
    site.behaviours = [cut(1000), *[cut(0)] * ATTEMPTS]
    sentence = r"ended after 1000 of 256000 bytes.*1000 bytes are kept; the same command"
    with pytest.raises(AssetError, match=sentence):
        bring()
    assert not (tmp_path / "thing").exists()
    assert bring() == CONTENT
    assert site.ranges[-1] == "bytes=1000-"


def test_a_part_of_another_version_is_not_gone_on_with(site, bring):
    site.behaviours = [cut(1000), *[cut(0)] * ATTEMPTS]
    with pytest.raises(AssetError):
        bring()
    site.content, site.etag = CONTENT[::-1], '"two"'
    assert bring() == CONTENT[::-1]


def test_a_part_that_is_whole_already_needs_no_more_bytes(site, bring, tmp_path):
    (tmp_path / "thing.part").write_bytes(CONTENT)
    assert bring() == CONTENT
    assert site.ranges == [f"bytes={len(CONTENT)}-"]


def test_a_part_that_is_too_long_is_thrown_away(site, bring, tmp_path):
    (tmp_path / "thing.part").write_bytes(CONTENT + b"more")
    assert bring() == CONTENT


def test_a_server_that_stalls_is_left_and_asked_again(site, bring):
    site.behaviours = [stall(5000)]
    assert bring(patience=1.0) == CONTENT
    assert site.ranges == [None, "bytes=5000-"]


def test_a_server_that_always_stalls_is_given_up(site, bring):
    site.behaviours = [stall(0)] * ATTEMPTS
    with pytest.raises(AssetError, match=r"cannot be fetched: .*timed out"):
        bring(patience=0.1)
    assert len(site.asked) == ATTEMPTS


def test_a_file_that_is_not_there_is_asked_for_once(site, bring):
    site.behaviours = [fails(404)]
    with pytest.raises(AssetError, match="the server answers 404"):
        bring()
    assert len(site.asked) == 1


def test_a_file_that_is_too_large_is_refused_before_it_comes(site, bring, tmp_path):
    site.behaviours = [claims(1 << 40)]
    with pytest.raises(AssetError, match="more than the"):
        bring()
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_grows_too_large_is_cut_off(site, bring, monkeypatch):
    monkeypatch.setattr(module, "LARGEST_DOWNLOAD", 100_000)
    site.behaviours = [without_length]
    with pytest.raises(AssetError, match="more bytes than the 100000 expected"):
        bring()


def test_without_a_network_one_sentence_says_so(monkeypatch, tmp_path):
    monkeypatch.setenv("no_proxy", "*")
    with socket.socket() as closed:
        closed.bind(("127.0.0.1", 0))
        address = f"http://127.0.0.1:{closed.getsockname()[1]}/thing"
        with pytest.raises(AssetError, match="Connection refused; is there a network"):
            download(address, tmp_path / "thing")


def test_only_web_addresses_are_fetched(tmp_path):
    with pytest.raises(AssetError, match="http or https address, got 'file:///etc/passwd'"):
        download("file:///etc/passwd", tmp_path / "thing")
