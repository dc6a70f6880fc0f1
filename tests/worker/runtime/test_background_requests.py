"""Scenes that a worker keeps on disk and in memory."""

import hashlib
import os
from collections.abc import Iterator
from pathlib import Path
from unittest.mock import Mock, call

import pytest
from tests.fakes.coordinator import LeasingCoordinator

from qdgrasp_assets.asset_paths import UNFINISHED
from qdgrasp_protocol.errors import NoReply
from qdgrasp_protocol.memory_bus import MemoryNetwork
from qdgrasp_worker.runtime import background_requests
from qdgrasp_worker.runtime.background_requests import SceneAnswered, SceneCache, SceneStore

SCENE = b"a scene"


@pytest.fixture
def office() -> Iterator[LeasingCoordinator]:
    with LeasingCoordinator(MemoryNetwork(), scene=SCENE) as office:
        yield office


def keep(folder: Path, payload: bytes, used: int) -> str:
    """Have a scene on disk that was used then [ns]; gives its digest."""
    digest = hashlib.sha256(payload).hexdigest()
    (folder / digest).write_bytes(payload)
    os.utime(folder / digest, ns=(used, used))
    return digest


def test_scenes_that_were_used_long_ago_make_room_for_others(office, tmp_path, monkeypatch):
    monkeypatch.setattr(background_requests, "MAX_STORE_SIZE", 3 * len(SCENE))
    old, recent, reused = (keep(tmp_path, SCENE[:6] + end, 1 + i) for i, end in enumerate((b"1", b"2", b"3")))
    os.utime(tmp_path / reused, ns=(0, 0))
    abandoned = tmp_path / f"{UNFINISHED}of a worker that was killed"
    abandoned.mkdir()
    os.utime(abandoned, (0, 0))
    cache = SceneStore(tmp_path)
    cache.bundle(office.bus, "job", reused)
    cache.bundle(office.bus, "job", office.digest)
    assert {path.name for path in tmp_path.iterdir()} == {recent, reused, office.digest}
    assert old != recent


def test_a_scene_is_looked_for_once_and_again_only_where_it_was_not_found():
    requests = Mock()
    scenes = SceneCache(requests)
    assert not any(scenes.has_or_request("job", "a") for _ in range(2))
    scenes.on_answer(SceneAnswered("job", "a", NoReply("nobody")))
    assert not scenes.has_or_request("job", "a")
    assert requests.fetch.call_args_list == [call("job", "a")] * 2
    scenes.on_answer(SceneAnswered("job", "a", b"a scene"))
    assert scenes.has_or_request("job", "a")
    assert scenes.pop("a") == b"a scene"
